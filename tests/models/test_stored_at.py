"""Maps that are stored smaller, or in another depth: sizes, bytes, and what comes back of them."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tests.models.examples import CASES, directions, make, per_image
from tests.support import assert_close

from torchmat.errors import RangeError
from torchmat.models import Distribution, Texture, blend
from torchmat.models.edit import VECTORS, drop_part, neutral_part, replace_map, resized, without_idle_parts
from torchmat.models.resample import shrunk
from torchmat.models.storage import MapSpec, StoredAs

LIGHT, VIEW = (per_image(directions(4, torch.float32, seed)) for seed in (1, 2))
EVERYTHING = {"lobes": 2, "parts": ["normal", "specular_mask", "fresnel", "rotation"]}
every_model = pytest.mark.parametrize(("name", "options"), CASES)


def per_texel(material):
    return [spec for spec in material.specs() if spec.per_texel and not spec.constant]


def smooth(channels, rows, columns, tiles=True):
    """Return a map [C, H, W] in 0.1..0.9 of one wave across, exact for float64."""
    u = (torch.arange(columns, dtype=torch.float64) + 0.5) / columns
    v = (torch.arange(rows, dtype=torch.float64) + 0.5) / rows
    turn = 2 * torch.pi if tiles else torch.pi
    phase = torch.arange(channels, dtype=torch.float64)[:, None, None]
    return 0.5 + 0.2 * torch.cos(turn * u + phase) + 0.2 * torch.cos(turn * v[:, None] + 2 * phase)


def bilinear_weights(long, short, tiles):
    """Return what each of `short` texels counts at the centres of `long` ones, by the definition of the filter."""
    weights = np.zeros((long, short))
    for place in range(long):
        at = (place + 0.5) / long * short - 0.5
        left = int(np.floor(at))
        for texel, share in ((left, 1 - (at - left)), (left + 1, at - left)):
            weights[place, texel % short if tiles else min(max(texel, 0), short - 1)] += share
    return weights


@pytest.mark.parametrize("tiles", [True, False])
@pytest.mark.parametrize(
    ("size", "small"), [((8, 12), (4, 3)), ((7, 5), (3, 2)), ((6, 6), (1, 1)), ((9, 1), (4, 1)), ((5, 8), (5, 2))]
)
def test_the_small_texture_is_the_least_squares_one(tiles, size, small):
    spec, value = MapSpec("any", "", layer_channels=2), torch.rand(2, *size, dtype=torch.float64)
    rows, columns = (bilinear_weights(long, short, tiles) for long, short in zip(size, small, strict=True))
    brought_back = np.kron(rows, columns)
    expected = np.linalg.lstsq(brought_back, value.flatten(1).T.numpy(), rcond=None)[0].T.reshape(2, *small)
    assert_close(shrunk(spec, value, small, tiles), torch.from_numpy(expected), 1e-11)
    bounded = MapSpec("any", "", layer_channels=2, low=0.4, high=0.6)
    assert_close(shrunk(bounded, value, small, tiles), torch.from_numpy(expected).clamp(0.4, 0.6), 1e-11)
    other = Texture({"albedo": smooth(3, *size)}, tiles=tiles, storage="float").stored_at({"albedo": StoredAs(small)})
    texture = other.textures()[0][2] if small != (1, 1) else other.numbers()[0][1][:, None, None].double()
    again = torch.from_numpy(np.einsum("ri,kij,cj->krc", rows, texture.numpy(), columns))
    assert_close(other.as_exported().maps["albedo"], again.float(), 1e-6)


@every_model
@pytest.mark.parametrize("size", [(1, 1), (2, 3), (5, 2), (5, 7)])
def test_bytes_and_textures_follow_the_size(name, options, size):
    material = make(name, options, 5, 7, torch.float32, storage="png16")
    names = [spec.name for spec in per_texel(material)]
    small = material.stored_at(dict.fromkeys(names, StoredAs(size)))
    assert small.size == (5, 7) and all(torch.equal(small.maps[key], material.maps[key]) for key in material.maps)
    channels = sum(spec.channels for spec in per_texel(material))
    written = [(spec, value) for spec, _, value, *_ in small.textures() if spec.name in names]
    if size == (1, 1):
        assert not written and small.bytes_per_texel == 0
        assert small.shared_bytes == material.shared_bytes + 4 * channels
        assert {spec.name for spec, _ in small.numbers()} >= set(names)
    else:
        assert all(tuple(value.shape[-2:]) == size for _, value in written)
        assert small.bytes_per_texel == pytest.approx(material.bytes_per_texel * size[0] * size[1] / 35)
        assert small.shared_bytes == material.shared_bytes
    exported = small.as_exported()
    assert exported.size == (5, 7) and exported.stored == small.stored
    assert bool(torch.isfinite(exported.shade(LIGHT, VIEW)).all())


@every_model
@pytest.mark.parametrize("storage", ["half", "png8"])
def test_exporting_what_was_exported_changes_nothing_more(name, options, storage):
    material = make(name, options, 6, 8, torch.float32, storage=storage, tiles=False)
    sizes = [(3, 4), (1, 1), (2, 8)]
    specs = [spec for spec in per_texel(material) if spec.name not in VECTORS]
    plan = {spec.name: StoredAs(sizes[place % 3]) for place, spec in enumerate(specs)}
    once = material.stored_at(plan).as_exported()
    twice = once.as_exported()
    for key in plan:
        # The way back and forth rounds in single precision (worst measured 3e-7), whatever the depth of the codes.
        assert_close(twice.maps[key], once.maps[key], 2e-6)


@every_model
def test_the_full_size_is_what_is_usual(name, options):
    material = make(name, options, 5, 7, torch.float32)
    full = material.stored_at({spec.name: StoredAs((5, 7)) for spec in per_texel(material)})
    expected = material.as_exported()
    assert all(torch.equal(value, expected.maps[key]) for key, value in full.as_exported().maps.items())
    assert full.stored_at(dict.fromkeys(full.stored)).stored == {}
    assert material.stored_at({per_texel(material)[0].name: StoredAs()}).stored == {}


def test_a_smooth_map_loses_little_and_a_constant_one_nothing():
    material = Texture({"albedo": smooth(3, 32, 32)}, storage="float")
    for size, bound in (((16, 16), 3e-3), ((8, 8), 1.2e-2)):  # measured 0.0024 and 0.0098 of the largest value
        found = material.stored_at({"albedo": StoredAs(size)}).as_exported().maps["albedo"]
        assert_close(found, material.maps["albedo"].float(), bound)
    constant = Texture({"albedo": torch.full((3, 32, 32), 0.3)}, storage="png8").stored_at({"albedo": StoredAs((1, 1))})
    assert torch.equal(constant.as_exported().maps["albedo"], constant.maps["albedo"])
    assert (constant.bytes_per_texel, constant.shared_bytes) == (0, 12)


def test_a_depth_of_its_own():
    material = Texture({"albedo": smooth(3, 8, 8).float()}, storage="png8")
    deep = material.stored_at({"albedo": StoredAs(storage="png16")})
    assert (material.bytes_per_texel, deep.bytes_per_texel) == (3, 6)
    exact = material.maps["albedo"].detach()
    errors = [float((one.as_exported().maps["albedo"].detach() - exact).abs().max()) for one in (material, deep)]
    assert errors[1] < errors[0] / 100
    relief = material.on_relief(0.1 * smooth(1, 8, 8).float()).stored_at({"height": StoredAs(storage="png8")})
    assert relief.bytes_per_texel == 4 and relief.stored_at({"height": None}).bytes_per_texel == 5


def test_directions_stay_unit_vectors_and_numbers_too():
    material = make("distribution", EVERYTHING, 8, 8, torch.float32, storage="png16")
    for size in ((4, 4), (1, 1)):
        small = material.stored_at({name: StoredAs(size) for name in VECTORS}).as_exported()
        for name in VECTORS:
            length = small.maps[name].detach().norm(dim=0)
            # 16-bit codes of -1..1 shorten a number by 2e-5 at most; what is filtered is a unit vector after decoding.
            assert float((length - 1).abs().max()) < 1e-4, (name, size)


def test_indices_take_the_nearest():
    material = make("local_pca", {"clusters": 3, "components": 2}, 6, 9, torch.float32)
    small = material.stored_at({"cluster": StoredAs((2, 3))}).as_exported().maps["cluster"]
    centre = material.maps["cluster"][:, 1::3, 1::3]
    assert torch.equal(small, centre.repeat_interleave(3, 1).repeat_interleave(3, 2))


def test_specular_maps_change_their_side_at_once():
    material = make("distribution", EVERYTHING, 4, 4, torch.float32)
    small = material.stored_at({"specular": StoredAs((3, 3)), "fresnel": StoredAs((1, 1))})
    assert small.maps["specular"].shape == (6, 3, 3)
    assert small.shared_bytes == 6 * 9 * 2 + 4
    assert set(small.stored) == {"fresnel"}
    assert small.stored_at({"specular": StoredAs((2, 2), "png8")}).shared_bytes == 6 * 4 + 4


def test_what_follows_a_material_that_is_stored_small():
    material = make("distribution", EVERYTHING, 8, 8, torch.float32)
    plan = {"diffuse": StoredAs((4, 4)), "fresnel": StoredAs((1, 1), "png8"), "rotation": StoredAs((2, 2))}
    small = material.stored_at(plan)
    for other in (small.repeating(False), small.stored_as("png8"), small.with_maps(diffuse=small.maps["diffuse"] / 2)):
        assert other.stored == small.stored
    assert set(drop_part(small, "rotation").stored) == {"diffuse", "fresnel"}
    assert small.on_relief(torch.rand(1, 8, 8) / 10).stored == small.stored
    assert small.surface().stored == {} and small.at(torch.rand(2, 3, 3)).stored == {}
    assert resized(small, (3, 16)).stored["diffuse"] == StoredAs((3, 4))
    painted = replace_map(small, "fresnel", torch.rand(1, 8, 8))
    assert painted.stored["fresnel"] == StoredAs(None, "png8") and painted.stored["diffuse"] == StoredAs((4, 4))
    assert replace_map(small, "diffuse", torch.rand(3, 8, 8)).stored.keys() == {"fresnel", "rotation"}


def test_a_blend_is_stored_small_where_both_are():
    one, other = (make("distribution", EVERYTHING, 8, 8, torch.float32, seed=seed) for seed in (1, 2))
    one = one.stored_at({"diffuse": StoredAs((4, 4)), "fresnel": StoredAs((1, 1))})
    other = other.stored_at({"diffuse": StoredAs((4, 4)), "fresnel": StoredAs((2, 2))})
    assert blend(one, other, 0.3).stored == {"diffuse": StoredAs((4, 4))}
    assert blend(one, other, 0.0).stored == one.stored
    assert blend(one, other, torch.rand(1, 8, 8)).stored == {}


def test_parts_that_are_one_number_can_be_done_without():
    material = make("distribution", EVERYTHING, 6, 6, torch.float32, storage="float")
    numbers = dict.fromkeys(("specular_mask", "index", "fresnel"), StoredAs((1, 1)))
    small = material.stored_at(numbers)
    bare = without_idle_parts(small)
    assert (bare.options["lobes"], bare.options["parts"]) == (1, ["normal", "fresnel", "rotation"])
    assert set(bare.stored) == {"fresnel"} and bare.bytes_per_texel == small.bytes_per_texel
    assert_close(bare.as_exported().shade(LIGHT, VIEW), small.as_exported().shade(LIGHT, VIEW), 1e-5)
    options = {"lobes": 2, "parts": ["specular_mask"], "mask_channels": 3}
    coloured = make("distribution", options, 6, 6, torch.float32, storage="float")
    coloured = coloured.stored_at({"specular_mask": StoredAs((1, 1))})
    bare = without_idle_parts(coloured)
    assert_close(bare.as_exported().shade(LIGHT, VIEW), coloured.as_exported().shade(LIGHT, VIEW), 1e-5)
    level = material.with_maps(normal=neutral_part(material, "normal")).stored_at({"normal": StoredAs((1, 1))})
    assert "normal" not in without_idle_parts(level).maps
    assert_close(without_idle_parts(level).shade(LIGHT, VIEW), level.shade(LIGHT, VIEW), 1e-5)
    assert without_idle_parts(material).maps.keys() == material.maps.keys()


@pytest.mark.parametrize(("plan", "said"), [
    ({"diffus": StoredAs((2, 2))}, "key 'diffus' .*Did you mean 'diffuse'"),
    ({"diffuse": StoredAs((9, 2))}, r"the size of diffuse must lie in \(1, 1\) to \(8, 6\); it is \(9, 2\)"),
    ({"diffuse": StoredAs((0, 2))}, "the size of diffuse must lie in"),
    ({"diffuse": StoredAs((2, 2, 2))}, "the size of diffuse must lie in"),
    ({"diffuse": StoredAs((2.0, 2.0))}, "the size of diffuse must lie in"),
    ({"diffuse": StoredAs(storage="png9")}, "the storage of diffuse must be one of .*Did you mean 'png8'"),
    ({"diffuse": (2, 2)}, "stored diffuse must be a StoredAs of a map that has textures; it is tuple"),
])
def test_what_cannot_be_stored_so(plan, said):
    material = make("distribution", {"lobes": 1, "parts": []}, 8, 6, torch.float32)
    with pytest.raises(RangeError, match=said):
        material.stored_at(plan)


def test_tables_and_constants_keep_their_size():
    with pytest.raises(RangeError, match="the size of weight must be its own; all texels share it"):
        make("pca", {"components": 3}, 4, 4).stored_at({"weight": StoredAs((1, 1))})
    with pytest.raises(RangeError, match="stored lobe must be a StoredAs of a map that has textures; it is numbers"):
        make("phong_srf", {"residual": "half"}, 4, 4).stored_at({"lobe": StoredAs((1, 1))})
    with pytest.raises(RangeError, match="the size of specular must be its own"):
        Distribution(make("distribution", EVERYTHING, 4, 4).maps, **EVERYTHING, stored={"specular": StoredAs((2, 2))})
