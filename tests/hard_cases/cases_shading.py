"""Hard cases of materials: what every registered model must keep at hard directions and at the ends of its maps."""

from __future__ import annotations

import math

import pytest
import torch
from tests.fitting.reference_scene import waves
from tests.brdf.directions import HARD_PAIRS, POLE, graze
from tests.hard_cases.components import Room
from tests.hard_cases.hard_directions import half_pairs, hard_grid, rows_of
from tests.hard_cases.sweep_models import twin
from tests.models import test_contract as contract
from tests.models.examples import directions, make, make_maps, per_image, specs_of
from tests.support import TOLERANCE, assert_close
from torch import Tensor

from torchmat import Material, RangeError, save_material
from torchmat.models import MATERIALS
from torchmat.models.storage import STORAGES

DTYPES = (torch.float32, torch.float64)
FULL = 7.2  # digits of float32
Variant = tuple[str, dict]


def shaded(material: Material, light: Tensor, view: Tensor) -> tuple[Tensor, list[Tensor]]:
    """Shade; assert that value and gradient are finite; return the value and the directions that hold gradients."""
    leaves = [given.clone().requires_grad_() for given in (light, view)]
    value = material.shade(*leaves)
    assert bool(torch.isfinite(value).all()), "a value is not finite"
    assert bool((value >= 0).all()), "a value is negative"
    value.sum().backward()
    for label, leaf in (("light", leaves[0]), ("view", leaves[1]), *material.maps.items()):
        assert leaf.grad is None or bool(torch.isfinite(leaf.grad).all()), f"the gradient of {label} is not finite"
    return value.detach(), leaves


def digits_right(found: Tensor, wanted: Tensor) -> float:
    """Return the decimal digits of `found` that are right, at most those of float32, where it is worst.

    Values are measured by the largest of their picture [..., 3, H, W], small ones by what is typical of all.
    """
    found, wanted = found.detach().double(), wanted.detach().double()
    scale = wanted.abs().amax(dim=(-3, -2, -1), keepdim=True).clamp(min=max(1e-2 * float(wanted.abs().max()), 1e-30))
    worst = float(((found - wanted).abs() / scale).max())
    return FULL if worst == 0 else min(FULL, -math.log10(worst))


def single_and_double(given: Variant, light: Tensor, view: Tensor) -> float:
    """Return the digits that float32 keeps of float64 with the same numbers, after asking that both be finite."""
    single, double = twin(*given, torch.float32, 2)
    light, view = light.float(), view.float()
    return digits_right(shaded(single, light, view)[0], shaded(double, light.double(), view.double())[0])


def bumps(rows: int, columns: int, depth: float = 0.1, dtype: torch.dtype = torch.float64) -> Tensor:
    """Return a smooth tileable height [1, H, W]."""
    return torch.from_numpy(depth * waves(rows, columns, 5, 4, 2)[0]).to(dtype)[None]


def on_bumps(given: Variant, dtype: torch.dtype) -> Material:
    """Return a material on a relief with ambient light."""
    ambient = torch.full((3, 6, 7), 0.02, dtype=dtype)
    return make(*given, 6, 7, dtype).on_relief(bumps(6, 7, dtype=dtype), ambient)


def equal_and_opposite(given: Variant, room: Room) -> float:
    """Case 1, flat and on a relief; returns the digits that float32 keeps there."""
    for dtype in DTYPES:
        light, view = rows_of(HARD_PAIRS.values(), dtype)
        dark = torch.tensor([POLE, (1.0, 0.0, 0.0), graze(0.4, 0.5), graze(0.4, -1e-6)], dtype=dtype)[:, :, None, None]
        for made in (lambda: make(*given, 2, 2, dtype), lambda: on_bumps(given, dtype)):
            shaded(made(), light, view)
            material = made()
            value, leaves = shaded(material, dark, -dark)  # one of the two is not above the surface
            assert not bool(value.any()), "light opposite to the view is not dark"
            slopes = [leaf.grad for leaf in (*leaves, *material.maps.values()) if leaf.grad is not None]
            assert not any(bool(slope.any()) for slope in slopes), "a gradient below the surface is not 0"
    for pair in ("both_at_horizon_same_side", "both_a_rounding_error_above_the_horizon"):
        texels = (torch.tensor(one)[:, None, None].expand(3, 6, 7) for one in HARD_PAIRS[pair])
        shaded(on_bumps(given, torch.float32), *texels)
    return single_and_double(given, *rows_of(HARD_PAIRS.values()))


def one_dark_light(given: Variant, room: Room) -> None:
    """A light below the surface is dark and leaves those beside it as they are."""
    lights = torch.tensor([graze(0, 0.86), graze(0, -0.86), graze(1.5, 0.94)], dtype=torch.float64)[:, :, None, None]
    value, _ = shaded(on_bumps(given, torch.float64), lights, torch.tensor(graze(0.2, 0.77)).double()[:, None, None])
    assert not bool(value[1].any()) and float(value[0].max()) > 0 and float(value[2].max()) > 0


def into_the_horizon(given: Variant, room: Room) -> float:
    """Case 2: light and view sink side by side, and values change ever less; returns the last change."""
    worst = 0.0
    for dtype in DTYPES:
        one_dark_light(given, room)
        for azimuth in (0.0, 1.3, 3.0):
            pairs = [(graze(azimuth, 10.0**-k), graze(azimuth + 0.5, 10.0**-k)) for k in range(2, 9)]
            values, _ = shaded(make(*given, 2, 2, dtype), *rows_of(pairs, dtype))
            steps = (values[1:] - values[:-1]).abs().flatten(1).amax(dim=1)
            assert float(steps[-1]) < 1e-3 and float(steps[-1]) <= float(steps[0]) + torch.finfo(dtype).eps
            worst = max(worst, float(steps[-1]))
    return worst


def steep(given: Variant, room: Room) -> None:
    """Case 3: a flank of 80 and of 89.9 degrees in the relief, and a normal at the rim in a map of normals."""
    dtype = torch.float32
    light, view = rows_of([(graze(0.3, 1.0), graze(3.5, 0.64)), (graze(0.3, 0.5), graze(3.5, 0.64))], dtype)
    for polar in (80.0, 89.9):
        # One texel that rises over its width of 1/8 at that angle, as far as heights may reach.
        height = torch.zeros(1, 8, 8, dtype=dtype)
        height[0, 4, 3] = min(math.tan(math.radians(polar)) / 8, 9.9)
        shaded(make(*given, 8, 8, dtype).on_relief(height), light, view)
    for dtype in DTYPES:
        material = make(*given, 2, 2, dtype)
        if "normal" in material.maps:
            rim = torch.tensor(graze(0.7, math.cos(math.radians(89.9))), dtype=dtype)[:, None, None].expand(3, 2, 2)
            shaded(material.with_maps(normal=rim.clone()), *rows_of(HARD_PAIRS.values(), dtype))


def half_vectors(given: Variant, room: Room) -> float:
    """Case 4; returns the digits that float32 keeps. At the centre a rotation must not matter."""
    material = make(*given, 2, 2)
    if "rotation" in material.maps:
        upright = torch.tensor(POLE, dtype=torch.float64)[:, None, None].expand(3, 2, 2).clone()
        flat = {"normal": upright} if "normal" in material.maps else {}
        # Masking that differs along and across turns with the texel, whatever the half vector: here it is alike.
        for name in ("masking", "roughness"):
            if name in material.maps:
                flat[name] = material.maps[name].detach().mean(dim=0, keepdim=True).expand_as(material.maps[name]).clone()
        light, view = rows_of(half_pairs()[:4])
        angles = [torch.rand(1, 2, 2, dtype=torch.float64) * 2 * math.pi for _ in range(2)]
        one, other = (
            material.with_maps(rotation=torch.cat((a.cos(), a.sin())), **flat).shade(light, view) for a in angles
        )
        assert_close(one, other.detach(), 1e-9)
    shaded(make(*given, 2, 2), *rows_of(half_pairs()))
    return single_and_double(given, *rows_of(half_pairs()))


def full_turn(given: Variant, room: Room) -> float:
    """Case 5: azimuths 0, 2 pi and next to them give one value; returns the largest difference."""
    worst = 0.0
    for dtype in DTYPES:
        pairs = [(graze(a, 0.5), graze(1.0, 0.7)) for a in (0.0, 2 * math.pi, -1e-7, 1e-7)]
        value, _ = shaded(make(*given, 2, 2, dtype), *rows_of(pairs, dtype))
        worst = max(worst, float((value - value[:1]).abs().max()))
    assert worst < 1e-5
    material = make(*given, 1, 2)
    if "rotation" in material.maps:
        from torchmat.models.edit import resized

        angle = torch.deg2rad(torch.tensor([[[359.0, 1.0]]], dtype=torch.float64))
        mean = resized(material.with_maps(rotation=torch.cat((angle.cos(), angle.sin()))), (1, 1)).maps["rotation"].detach()
        assert abs(math.degrees(math.atan2(float(mean[1]), float(mean[0])))) < 1e-6, "359 and 1 degrees do not average to 0"
    return worst


def ulp_from_unit(given: Variant, room: Room) -> float:
    """Case 6: directions one ulp too long or too short, where a cosine leaves -1..1; returns the digits that are kept."""
    least = FULL
    pairs = [HARD_PAIRS["light_and_view_are_the_normal"], HARD_PAIRS["light_is_view"], HARD_PAIRS["mirror_pair"], (POLE, graze(0.3, 0.6))]
    for dtype in DTYPES:
        light, view = rows_of(pairs, dtype)
        wanted, _ = shaded(make(*given, 2, 2, dtype), light, view)
        for longer in (1 + torch.finfo(dtype).eps, 1 - torch.finfo(dtype).eps):
            found, _ = shaded(make(*given, 2, 2, dtype), light * longer, view * longer)
            if dtype == torch.float32:
                least = min(least, digits_right(found, wanted))
    assert least > 2  # a square root at the end of its range makes 1e-7 to 3e-4
    return least


def ends_of_maps(given: Variant, room: Room) -> None:
    """Case 7: maps at their bounds, which come back from every storage, and maps of 0, 1e-8 and 1e4."""
    name, options = given
    for dtype in DTYPES:
        for end in ("low", "high"):
            maps, bound = make_maps(name, options, 2, 2, dtype), {s.name: getattr(s, end) for s in specs_of(name, options)}
            maps |= {key: torch.full_like(maps[key], value) for key, value in bound.items() if value is not None}
            material = MATERIALS[name](maps, **options)
            shaded(material, *hard_grid(dtype))
            for storage in STORAGES:
                exported = material.stored_as(storage).as_exported()
                for key, value in bound.items():
                    found = exported.maps[key]
                    if key == "rotation" and STORAGES[storage].natural:  # a hue has an angle and no length
                        assert_close(found, torch.nn.functional.normalize(maps[key], dim=0).float(), 5e-3)
                    else:
                        assert value is None or torch.equal(found, maps[key].float()), f"{key} as {storage}"
        for value in (0.0, 1e-8, 1e4):
            maps = make_maps(name, options, 2, 2, dtype)
            maps |= {s.name: torch.full_like(maps[s.name], value) for s in _unbounded(given)}
            shaded(MATERIALS[name](maps, **options), *hard_grid(dtype))


def _unbounded(given: Variant) -> list:
    return [spec for spec in specs_of(*given) if spec.per_texel and not spec.constant and spec.high is None]


def dark_beside_bright(given: Variant, room: Room) -> float:
    """Case 8: texels of 1e-8 beside one of 1e4 shade as they do alone; returns the digits that agree."""
    name, options = given
    maps = make_maps(name, options, 1, 3, torch.float32)
    for spec in _unbounded(given):
        maps[spec.name][..., :2] *= 1e-8
        maps[spec.name][..., 2] = 1e4
    alone = {
        s.name: maps[s.name] if s.constant or not s.per_texel else maps[s.name][..., :2].clone()
        for s in specs_of(name, options)
    }
    light, view = (per_image(directions(12, torch.float32, seed)) for seed in (1, 2))
    both, _ = shaded(MATERIALS[name](maps, **options), light, view)
    dark, _ = shaded(MATERIALS[name](alone, **options), light, view)
    figure = digits_right(both[..., :2], dark)
    assert figure > 4
    return figure


def sizes(given: Variant, room: Room) -> None:
    """Case 10: maps of all shapes, the last texel by itself, and 25,000 directions as each of them."""
    for size in ((1, 1), (1, 7), (7, 1), (3, 5), (1, 4096)):
        contract.check_size(*given, *size)
    light, view = (per_image(directions(25_000, torch.float32, seed)) for seed in (1, 2))
    material = make(*given, 1, 1, torch.float32)
    with torch.no_grad():
        assert_close(material.shade(light, view)[-3:], material.shade(light[-3:], view[-3:]), 1e-5)


def refused(given: Variant, room: Room) -> None:
    """Case 11: maps that are not finite, out of range, missing, of another size, precision or kind."""
    contract.check_rejects_maps_that_do_not_fit(*given)
    contract.check_rejects_maps_of_different_sizes_or_precisions(*given)
    contract.check_rejects_directions_that_do_not_fit(*given)


def deep_relief(given: Variant, room: Room) -> None:
    """Case 12: at 75 degrees rays leave the tile and come in on the other side: a shifted relief, a shifted picture."""
    plain = make(*given, 12, 16).on_relief(bumps(12, 16, 0.4), torch.rand(3, 12, 16, dtype=torch.float64))
    light, view = per_image(torch.tensor([graze(2.27, 0.342)], dtype=torch.float64))[0], torch.tensor(
        [graze(0.0, 0.2588), graze(3.75, 0.2588)], dtype=torch.float64
    )[:, :, None, None]
    for shift in ((0, 5), (4, 7)):
        maps = {
            spec.name: value.roll(shift, (-2, -1)) if spec.per_texel and not spec.constant else value
            for spec, value in ((spec, plain.maps[spec.name].detach()) for spec in plain.specs())
        }
        with torch.no_grad():
            expected = plain.shade(light, view).roll(shift, (-2, -1))
            assert_close(plain.with_maps(**maps).shade(light, view), expected, 1e-9)
            flat = plain.surface().shade(light, view).roll(shift, (-2, -1))
        assert float((flat - expected).abs().max()) > 0.01, "the relief does nothing"


def precision(given: Variant, room: Room) -> float:
    """Case 13: returns the digits that float32 keeps at random directions."""
    contract.check_float32_agrees_with_float64(*given)
    least = single_and_double(given, *(per_image(directions(200, seed=seed)) for seed in (1, 2)))
    assert least > -math.log10(TOLERANCE[torch.float32]) - 2  # each picture by its own largest value, however dark
    return least


def same_bits(given: Variant, room: Room) -> None:
    """Case 15: the same bits again, and with one thread as with two."""
    for dtype in DTYPES:
        contract.check_deterministic(*given, dtype)
    material = make(*given, 40, 37, torch.float32)
    light, view = (per_image(directions(9, torch.float32, seed)) for seed in (1, 2))
    before, found = torch.get_num_threads(), []
    try:
        for threads in (1, 2):
            torch.set_num_threads(threads)
            with torch.no_grad():
                found.append(material.shade(light, view))
    finally:
        torch.set_num_threads(before)
    assert torch.equal(*found), "another number of threads, other bits"


def export_ranges(given: Variant, room: Room) -> float:
    """Case 17: never clipped, within the quantum of each storage; returns the relative error of shading after 8 bits."""
    name, options = given
    for storage in STORAGES:
        contract.check_export(name, options, storage, torch.float32)
    for spec in specs_of(name, options):
        if spec.low is None and spec.high is None:
            continue
        broken = make(name, options, 4, 5, dtype=torch.float32, storage="png8")
        broken.maps[spec.name].data.view(-1)[0] = spec.low - 1 if spec.low is not None else spec.high + 1
        for act in (broken.as_exported, lambda broken=broken: save_material(broken, room.folder / "out")):
            with pytest.raises(RangeError, match=spec.name):
                act()
    assert not list(room.folder.iterdir()), "a refused material left files"
    material = make(name, options, 5, 3, torch.float32, storage="png8")
    light, view = (per_image(directions(20, torch.float32, seed)) for seed in (1, 2))
    with torch.no_grad():
        wanted, found = material.shade(light, view), material.as_exported().shade(light, view)
    return float((found - wanted).square().sum() / wanted.square().sum())
