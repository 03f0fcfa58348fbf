"""What every material keeps, over every registered model.

What is named `check_` the table of hard cases runs on each of these models: cases 10, 11, 13, 15 and, in float32, 17.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from tests.models.examples import CASES, EXAMPLE_OPTIONS, assert_same, directions, make, make_maps, per_image, per_texel, specs_of
from tests.reference import materials as oracle
from tests.reference.gradient import central
from tests.support import TOLERANCE

from torchmat.errors import RangeError, ShapeError
from torchmat.models import MATERIALS, Material
from torchmat.models.storage import STORAGES

every_model = pytest.mark.parametrize("name, options", CASES)



def test_every_model_has_examples_and_an_oracle():
    assert set(EXAMPLE_OPTIONS) == set(MATERIALS) == set(oracle.VALUES)
    assert all(model.name == name for name, model in MATERIALS.items())


def _numpy(material: Material) -> dict:
    return {key: value.detach().double().numpy() for key, value in material.maps.items()}


@every_model
def test_values_match_the_oracle(name, options, dtype):
    material = make(name, options, 3, 2, dtype)
    light, view = per_texel(3, 2, dtype, seed=3), per_texel(3, 2, dtype, seed=4)
    arrays = light.double().numpy(), view.double().numpy()
    expected = oracle.shade(name, _numpy(material), options, *arrays, 3, 2)
    assert (expected > 0).mean() > 0.3, "the example is clamped nearly everywhere and tests little"
    bound = 1e-10 if name in ("pca", "local_pca") and dtype == torch.float64 else None  # a linear solve of condition 20
    assert_same(material.shade(light, view), torch.from_numpy(expected).to(dtype), bound)


@every_model
def test_gradients_match_the_oracles_differences(name, options):
    material = make(name, options, 2, 2)
    light, view = per_texel(2, 2, seed=5, lowest=0.3), per_texel(2, 2, seed=6, lowest=0.3)
    light.requires_grad_()
    view.requires_grad_()
    probe = torch.rand(3, 2, 2, dtype=torch.float64)
    (material.shade(light, view) * probe).sum().backward()
    maps = _numpy(material)

    def total(maps, light, view):
        return float((oracle.shade(name, maps, options, light, view, 2, 2) * probe.numpy()).sum())

    arrays = light.detach().numpy(), view.detach().numpy()
    wanted = central(lambda x: total(maps, x, arrays[1]), arrays[0]), central(lambda x: total(maps, arrays[0], x), arrays[1])
    for direction, expected in zip((light, view), wanted, strict=True):
        found = torch.zeros_like(view) if direction.grad is None else direction.grad
        # Only the part along the sphere is defined: formulas that agree on unit vectors differ off them.
        apart = found - torch.from_numpy(expected)
        along = apart - direction.detach() * (apart * direction.detach()).sum(dim=0)
        assert float(along.abs().max()) < 1e-6 * max(1.0, float(np.abs(expected).max()))
    for spec in material.specs():
        if not spec.index:
            expected = central(lambda x, key=spec.name: total({**maps, key: x}, *arrays), maps[spec.name])
            assert_same(material.maps[spec.name].grad, torch.from_numpy(expected), 1e-6)


@every_model
def test_gradcheck(name, options):
    maps = make_maps(name, options, 1, 2)
    free = [spec.name for spec in specs_of(name, options) if not spec.index]
    light, view = per_texel(1, 2, seed=7, lowest=0.3), per_texel(1, 2, seed=8, lowest=0.3)
    material = make(name, options, 1, 2)

    def shaded(light, view, *values):
        # The maps are parameters, so they are swapped in for one call.
        swapped = {f"maps.{key}": value for key, value in zip(free, values, strict=True)}
        return torch.func.functional_call(_Shader(material), {f"material.{k}": v for k, v in swapped.items()}, (light, view))

    inputs = [x.detach().clone().requires_grad_() for x in (light, view, *(maps[key] for key in free))]
    # Every model's first example entry by entry; large tables of the others along random directions.
    large = options != EXAMPLE_OPTIONS[name][0] and sum(x.numel() for x in inputs) > 100
    assert torch.autograd.gradcheck(shaded, inputs, eps=1e-6, atol=1e-7, rtol=1e-5, fast_mode=large)


class _Shader(torch.nn.Module):
    def __init__(self, material):
        super().__init__()
        self.material = material

    def forward(self, light, view):
        return self.material.shade(light, view)


@every_model
def test_shapes_broadcast(name, options):
    material = make(name, options, 2, 3)
    image, texel = per_image(directions(4)), per_texel(2, 3)
    one = image[0]
    assert material.shade(one, one).shape == (3, 2, 3)
    assert material.shade(image, image.flip(0)).shape == (4, 3, 2, 3)
    assert material.shade(texel, texel).shape == (3, 2, 3)
    assert material.shade(image, texel).shape == material.shade(texel, image).shape == (4, 3, 2, 3)
    batch = torch.stack((texel, texel.flip(-1)))
    assert material.shade(batch, texel).shape == (2, 3, 2, 3)
    assert material.shade(image[None], image[:, None]).shape == (4, 4, 3, 2, 3)


@every_model
def test_a_broadcast_is_what_each_pair_gives(name, options):
    material = make(name, options, 2, 3)
    image, texel = per_image(directions(3)), per_texel(2, 3, seed=9)
    mixed = material.shade(image, texel)
    for index in range(3):
        assert_same(mixed[index], material.shade(image[index], texel), 1e-10)
    grid = material.shade(image[None], image[:, None])
    for i in range(3):
        for j in range(3):
            assert_same(grid[i, j], material.shade(image[j], image[i]), 1e-10)


@every_model
def test_per_image_equals_per_texel(name, options, dtype):
    material = make(name, options, 2, 3, dtype)
    light, view = per_image(directions(5, dtype)), per_image(directions(5, dtype, seed=2))
    spread = [d.expand(5, 3, 2, 3).contiguous() for d in (light, view)]
    assert_same(material.shade(*spread), material.shade(light, view), 1e-5 if dtype == torch.float32 else 1e-12)


@every_model
@pytest.mark.parametrize("which", ["light", "view"])
def test_below_the_horizon_is_exactly_zero(name, options, dtype, which):
    material = make(name, options, 2, 3, dtype)
    rows = [((1 - z * z) ** 0.5, 0.0, z) for z in (0.0, -0.0, -1e-30, -0.5)]
    low = torch.tensor(rows, dtype=dtype)[:, :, None, None].requires_grad_()
    high = per_image(directions(1, dtype))[0].requires_grad_()
    value = material.shade(low, high) if which == "light" else material.shade(high, low)
    assert value.shape == (4, 3, 2, 3) and bool((value == 0).all())
    (value * torch.rand_like(value)).sum().backward()  # random weights: what two of them leave cannot cancel
    for leaf in (low, high, *material.maps.values()):
        assert leaf.grad is None or bool((leaf.grad == 0).all())


@every_model
def test_one_texel_below_leaves_the_others(name, options):
    material = make(name, options, 2, 3)
    light, view = per_texel(2, 3), per_texel(2, 3, seed=2)
    expected = material.shade(light, view)
    light[:, 1, 2] = torch.tensor([0.6, 0.0, -0.8], dtype=torch.float64)
    expected[:, 1, 2] = 0
    assert_same(material.shade(light, view), expected)


@every_model
def test_never_negative(name, options, dtype):
    maps = make_maps(name, options, 3, 3, dtype)
    for spec in specs_of(name, options):
        if spec.low is None and not spec.constant:
            maps[spec.name] = torch.randn_like(maps[spec.name])
    material = MATERIALS[name](maps, **options)
    value = material.shade(per_image(directions(20, dtype)), per_image(directions(20, dtype, seed=2)))
    assert bool((value >= 0).all())
    assert bool(torch.isfinite(value).all())


@every_model
def test_linear_in_the_maps_marked_linear(name, options):
    light, view = per_image(directions(6)), per_image(directions(6, seed=2))
    first, second = make_maps(name, options, 2, 3, seed=1), make_maps(name, options, 2, 3, seed=2)
    for spec in specs_of(name, options):
        if not spec.linear:
            continue
        values = []
        for share in (1.0, 0.0, 0.3):
            mixed = {**first, spec.name: share * first[spec.name] + (1 - share) * second[spec.name]}
            values.append(MATERIALS[name](mixed, **options).value(light, view))
        assert_same(values[2], 0.3 * values[0] + 0.7 * values[1], 1e-12)


@every_model
def test_declared_symmetries(name, options):
    material = make(name, options, 2, 2)
    light, view = per_image(directions(6)), per_image(directions(6, seed=2))
    if material.isotropic:
        cosine, sine = np.cos(0.7), np.sin(0.7)
        turn = torch.tensor([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])
        turned = [torch.einsum("ij,njhw->nihw", turn, d) for d in (light, view)]
        assert_same(material.shade(*turned), material.shade(light, view), 1e-10)
    if material.reciprocal:
        one, other = material.shade(light, view), material.shade(view, light)
        assert_same(one / light[:, 2:3], other / view[:, 2:3], 1e-10)


def check_deterministic(name, options, dtype):
    light, view = per_texel(2, 3, dtype), per_texel(2, 3, dtype, seed=2)
    one, other = (make(name, options, 2, 3, dtype) for _ in range(2))
    assert torch.equal(one.shade(light, view), one.shade(light, view))
    assert torch.equal(one.shade(light, view), other.shade(light, view))


def check_float32_agrees_with_float64(name, options):
    light, view = directions(50, torch.float32).double(), directions(50, torch.float32, seed=2).double()
    wide = make(name, options, 4, 4).shade(per_image(light), per_image(view))
    narrow = make(name, options, 4, 4, torch.float32).shade(per_image(light.float()), per_image(view.float()))
    assert_same(narrow, wide.float(), TOLERANCE[torch.float32])


def check_size(name, options, height, width):
    material = make(name, options, height, width, torch.float32)
    assert material.size == (height, width)
    assert material.texels == height * width
    light, view = (per_image(directions(1, torch.float32, seed))[0] for seed in (1, 2))
    value = material.shade(light, view)
    assert value.shape == (3, height, width)
    # The last texel alone gives the same.
    last = {
        s.name: material.maps[s.name] if s.constant or not s.per_texel else material.maps[s.name][:, -1:, -1:]
        for s in material.specs()
    }
    assert_same(MATERIALS[name](last, **options).shade(light, view), value[:, -1:, -1:], 1e-5)


def _quantum(spec, part: torch.Tensor, storage: str) -> torch.Tensor:
    """Return how far each stored value may lie from the true one."""
    levels = STORAGES[storage].levels
    if spec.index:
        return torch.zeros_like(part)
    if levels is None:
        digits, smallest = (2.0**-11, 2.0**-25) if storage == "half" else (2.0**-24, 1e-45)
        return part.abs() * digits + smallest
    low, high = part.amin(dim=(1, 2), keepdim=True), part.amax(dim=(1, 2), keepdim=True)
    natural = STORAGES[storage].natural
    if natural and spec.kind == "rotation":
        return torch.full_like(part, math.pi / 3 / levels / 2 + 2e-7)  # each sixth of the circle has all codes
    if spec.fixed_range or (natural and None not in (spec.low, spec.high)):
        low, high = torch.full_like(low, spec.low), torch.full_like(high, spec.high)
    elif natural and spec.low == 0:
        low, high = torch.zeros_like(low), high.amax().clamp(min=1).expand_as(high)
    elif natural and spec.low is None:
        high = part.abs().amax().expand_as(high)
        low = -high
    step = (high - low) / levels / 2
    coloured = spec.colour or (natural and spec.layer_channels == 3 and spec.low == 0)
    if coloured and (levels == 255 or natural):
        # Half a code of sRGB, times its steepest slope (2.4 / 1.055 at the bright end).
        step = high.amax() / levels / 2 * 2.4 / 1.055
    return (step + 2e-7 * torch.maximum(low.abs(), high.abs())).expand_as(part)


def check_export(name, options, storage, dtype):
    """Nothing is off by more than the quantum, and exporting again changes nothing."""
    material = make(name, options, 5, 3, dtype, storage=storage)
    exported = material.as_exported()
    assert exported.storage == storage
    assert exported.options == material.options
    assert all(value.dtype == torch.float32 for value in exported.maps.values())
    for spec, texture, part, kind, _ in material.textures():
        channels = len(part)
        first = 0 if channels == len(material.maps[spec.name]) else spec.textures.index(texture) * channels
        if STORAGES[kind].natural and spec.kind == "rotation":
            part = torch.nn.functional.normalize(part, dim=0)
        found = exported.maps[spec.name][first : first + channels]
        excess = (found.detach().double() - part.double()).abs() - _quantum(spec, part.double(), kind)
        assert float(excess.max()) <= 0, f"{texture} stored as {kind} is off by {float(excess.max()):.3g} too much"
    again = exported.as_exported()
    assert all(torch.equal(again.maps[key], exported.maps[key]) for key in exported.maps)
    light, view = (per_image(directions(3, torch.float32, seed)) for seed in (1, 2))
    assert bool(torch.isfinite(exported.shade(light, view)).all())


@every_model
@pytest.mark.parametrize("storage", sorted(STORAGES))
def test_export_stays_within_the_quantum_and_is_idempotent(name, options, storage):
    check_export(name, options, storage, torch.float64)


@every_model
@pytest.mark.parametrize("storage", sorted(STORAGES))
def test_bytes_are_those_of_the_textures(name, options, storage):
    material = make(name, options, 5, 3, torch.float32, storage=storage)
    per_texel_bytes = shared = 0
    bytes_of = {"half": 2, "float": 4, "png8": 1, "png16": 2, "tiff8": 1, "tiff16": 2, "paint8": 1, "paint16": 2}
    for texture in material.textures():
        spec, size = texture.spec, 1 if texture.spec.index else bytes_of[texture.storage]
        values = texture.codes().pixels.size if bytes_of[texture.storage] < 4 else texture.values.numel()
        if spec.per_texel:
            per_texel_bytes += values * size
        else:
            shared += values * size
    shared += sum(4 * material.maps[s.name].numel() for s in material.specs() if s.constant)
    assert material.bytes_per_texel == per_texel_bytes / 15
    assert material.shared_bytes == shared
    covered = {spec.name for spec, *_ in material.textures()} | {s.name for s in material.specs() if s.constant}
    assert covered == set(material.maps)


def _centres(height: int, width: int, dtype=torch.float64) -> torch.Tensor:
    u = ((torch.arange(width, dtype=dtype) + 0.5) / width).expand(height, width)
    v = (1 - (torch.arange(height, dtype=dtype) + 0.5) / height)[:, None].expand(height, width)
    return torch.stack((u, v))


def _per_texel_maps(material: Material) -> dict:
    return {s.name: material.maps[s.name].detach() for s in material.specs() if s.per_texel and not s.constant}


@every_model
@pytest.mark.parametrize("tiles", [True, False])
def test_at_texel_centres_returns_the_texels(name, options, dtype, tiles):
    material = make(name, options, 3, 5, dtype, tiles=tiles)
    seen = material.at(_centres(3, 5, dtype))
    assert seen.tiles is tiles
    assert seen.size == (3, 5)
    for key, value in _per_texel_maps(material).items():
        assert_same(seen.maps[key].detach(), value, 1e-5 if dtype == torch.float32 else 1e-12)


@every_model
def test_at_wraps_when_tiling_and_keeps_the_border_when_not(name, options):
    uv = _centres(3, 5)
    tiling, bounded = (make(name, options, 3, 5, tiles=tiles) for tiles in (True, False))
    for key, value in _per_texel_maps(tiling).items():
        for shift in ((1.0, 0.0), (-2.0, 3.0)):
            moved = uv + torch.tensor(shift, dtype=torch.float64)[:, None, None]
            assert_same(tiling.at(moved).maps[key].detach(), value, 1e-12)
        far = bounded.at(uv + torch.tensor([5.0, 5.0], dtype=torch.float64)[:, None, None]).maps[key].detach()
        assert_same(far, value[:, :1, -1:].expand_as(far), 1e-12)  # v up: the top row is the far one


@every_model
def test_at_filters_maps_and_takes_the_nearest_index(name, options):
    material = make(name, options, 1, 4)
    # A third of the way from texel 1 to texel 2, and from texel 3 over the border to texel 0.
    uv = torch.tensor([[[(1.5 + 1 / 3) / 4, (3.5 + 1 / 3) / 4]], [[0.5, 0.5]]], dtype=torch.float64)
    seen = material.at(uv)
    for spec in material.specs():
        if spec.constant or not spec.per_texel:
            assert torch.equal(seen.maps[spec.name], material.maps[spec.name])
            continue
        value, found = material.maps[spec.name], seen.maps[spec.name]
        for place, (one, other) in enumerate(((1, 2), (3, 0))):
            expected = value[:, 0, one] if spec.index else value[:, 0, one] * 2 / 3 + value[:, 0, other] / 3
            assert_same(found[:, 0, place].detach(), expected.detach(), 1e-12)


@every_model
def test_copies_keep_settings_and_replace_maps(name, options):
    material = make(name, options, 2, 3, storage="png16", tiles=False)
    spec = next(s for s in material.specs() if s.per_texel and not s.constant and not s.index)
    changed = material.with_maps(**{spec.name: material.maps[spec.name].detach() / 2})
    assert (changed.storage, changed.tiles, changed.options) == ("png16", False, material.options)
    assert torch.equal(changed.maps[spec.name], material.maps[spec.name] / 2)
    assert material.stored_as("half").storage == "half"


def check_rejects_directions_that_do_not_fit(name, options):
    material = make(name, options, 2, 3)
    good = per_image(directions(1))[0]
    wrong_sizes = torch.zeros(3, 3, 2, dtype=torch.float64), torch.zeros(2, 2, 3, dtype=torch.float64)
    for bad in (good[:, 0, 0], directions(4), *wrong_sizes):
        with pytest.raises(ShapeError, match=r"shade: light must be \[\.\.\., 3, 1, 1\] or \[\.\.\., 3, 2, 3\]"):
            material.shade(bad, good)
        with pytest.raises(ShapeError, match="shade: view must be"):
            material.shade(good, bad)
    with pytest.raises(RangeError, match=r"light must be torch\.float64 as the maps are; it is torch\.float32"):
        material.shade(good.float(), good)


def check_rejects_maps_that_do_not_fit(name, options):
    maps, model = make_maps(name, options, 2, 3), MATERIALS[name]
    for spec in specs_of(name, options):
        value = maps[spec.name]
        with pytest.raises(ShapeError, match=f"{spec.name} is missing"):
            model({k: v for k, v in maps.items() if k != spec.name}, **options)
        with pytest.raises(ShapeError, match=f"{spec.name} must be"):
            model({**maps, spec.name: value[:-1]}, **options)
        with pytest.raises(ShapeError, match=f"{spec.name} must be"):
            model({**maps, spec.name: value[None]}, **options)
        with pytest.raises(RangeError, match=f"{spec.name} must be a floating-point tensor; it is torch.int64"):
            model({**maps, spec.name: value.long()}, **options)
        for poison in (float("nan"), float("inf")):
            bad = value.clone()
            bad[-1] = poison
            with pytest.raises(RangeError, match=rf"{spec.name} must be finite; \d+ of {bad.numel()} values"):
                model({**maps, spec.name: bad}, **options)
        for bound, step in ((spec.low, -1.0), (spec.high, 1.0)):
            if bound is not None:
                bad = value.clone()
                bad.view(-1)[0] = bound + step
                with pytest.raises(RangeError, match=rf"{spec.name} must lie in .*never clipped"):
                    model({**maps, spec.name: bad}, **options)
    with pytest.raises(RangeError, match="key 'shininess' must be one of"):
        model({**maps, "shininess": torch.ones(1, 2, 3)}, **options)


def check_rejects_maps_of_different_sizes_or_precisions(name, options):
    maps, model = make_maps(name, options, 2, 3), MATERIALS[name]
    sized = [s.name for s in specs_of(name, options) if s.per_texel and not s.constant]
    if len(sized) > 1:
        with pytest.raises(ShapeError, match="size of the other maps"):
            model({**maps, sized[1]: maps[sized[1]][:, :, :-1]}, **options)
    if len(maps) > 1:
        with pytest.raises(RangeError, match="as the maps are"):
            model({**maps, sized[0]: maps[sized[0]].float()}, **options)


@every_model
def test_rejects_unknown_options_and_suggests_the_nearest(name, options):
    maps = make_maps(name, options)
    with pytest.raises(RangeError, match=r"storage must be one of .*Did you mean 'png16'\?"):
        MATERIALS[name](maps, storage="png61", **options)
    with pytest.raises(RangeError, match=r"key 'storge' .*Did you mean 'storage'\?"):
        MATERIALS[name](maps, storge="half", **options)
    for key in options:
        with pytest.raises(RangeError, match=rf"key '{key}x' .*Did you mean '{key}'\?"):
            MATERIALS[name](maps, **options, **{f"{key}x": 1})


@every_model
def test_rejects_coordinates_of_the_wrong_shape(name, options):
    with pytest.raises(ShapeError, match=r"at: uv must be \[2, H, W\]"):
        make(name, options).at(torch.zeros(3, 4, 4))
