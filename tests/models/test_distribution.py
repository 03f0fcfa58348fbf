"""The distribution material: values by hand, parts that are absent, and where its formulas break."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from tests.models.examples import assert_same, directions, make_maps, per_image
from tests.reference import materials as oracle

from torchmat import RangeError, ShapeError, load_material, save_material
from torchmat.models import Distribution, Lambert
from torchmat.models.distribution import DISTRIBUTION_PARTS, default_tilt

PRINTED = [part for part in DISTRIBUTION_PARTS if part != "masking"]
FULL = {"lobes": 2, "parts": PRINTED, "mask_channels": 3}
COLOUR = (0.5, 0.3, 0.2)
POLE = (0.0, 0.0, 1.0)


def unit(direction, dtype=torch.float64) -> torch.Tensor:
    vector = torch.as_tensor(direction, dtype=torch.float64)
    return (vector / vector.norm()).to(dtype)[:, None, None]


def polar(angle_deg: float, azimuth_deg: float = 0.0, dtype=torch.float64) -> torch.Tensor:
    angle, azimuth = math.radians(angle_deg), math.radians(azimuth_deg)
    sine = math.sin(angle)
    return unit((sine * math.cos(azimuth), sine * math.sin(azimuth), math.cos(angle)), dtype)


def plane(*values: float, dtype=torch.float64) -> torch.Tensor:
    """One texel [C, 1, 1]."""
    return torch.tensor(values, dtype=dtype)[:, None, None]


def build(dtype=torch.float64, lobes: int = 1, **given) -> Distribution:
    """Return a material whose parts are the maps given; black diffuse and a specular map of COLOUR unless given."""
    options = {key: given.pop(key) for key in ("fresnel_exponent", "storage", "tiles") if key in given}
    maps = {name: value.to(dtype) for name, value in given.items()}
    size = next((maps[part].shape[-2:] for part in ("diffuse", *DISTRIBUTION_PARTS[:4], "index") if part in maps), (1, 1))
    maps.setdefault("diffuse", torch.zeros(3, *size, dtype=dtype))
    if lobes:
        maps.setdefault("specular", plane(*COLOUR, dtype=dtype).expand(3, 4, 4).repeat(lobes, 1, 1))
    mask = maps.get("specular_mask")
    parts = [part for part in DISTRIBUTION_PARTS if part in maps]
    return Distribution(maps, lobes=lobes, parts=parts, mask_channels=1 if mask is None else len(mask), **options)


def colour_of(material: Distribution, light: torch.Tensor, view: torch.Tensor) -> torch.Tensor:
    return material.shade(light, view).detach()[:, 0, 0]


def differentiated(material: Distribution, light: torch.Tensor, view: torch.Tensor) -> torch.Tensor:
    """Shade; assert that value and every gradient are finite; return the value."""
    leaves = [d.detach().clone().requires_grad_() for d in (light, view)]
    value = material.shade(*leaves)
    value.sum().backward()
    assert bool(torch.isfinite(value).all()) and bool((value >= 0).all())
    for label, leaf in (("light", leaves[0]), ("view", leaves[1]), *material.maps.items()):
        assert leaf.grad is None or bool(torch.isfinite(leaf.grad).all()), f"the gradient of {label} is not finite"
    return value.detach()


def random_table(size: int = 5, lobes: int = 1, seed: int = 0) -> torch.Tensor:
    return torch.from_numpy(np.random.default_rng(seed).uniform(0, 0.5, (3 * lobes, size, size)))


def test_without_lobes_it_is_lambert(dtype):
    maps = make_maps("lambert", {}, 3, 4, dtype)
    light, view = per_image(directions(7, dtype)), per_image(directions(7, dtype, 2))
    flat = build(dtype, lobes=0, diffuse=maps["albedo"])
    assert torch.equal(flat.shade(light, view), maps["albedo"] * light[:, 2:])
    bumpy = build(dtype, lobes=0, diffuse=maps["albedo"], normal=maps["normal"])
    assert_same(bumpy.shade(light, view), Lambert(maps).shade(light, view))


@pytest.mark.parametrize("mask", [(0.7,), (0.7, 0.5, 0.2)])
def test_value_by_hand_along_the_normal(mask, dtype):
    # N.L = N.V = L.H = 1: D is 1, and Fresnel's term is r0.
    material = build(dtype, diffuse=plane(0.1, 0.2, 0.3), specular_mask=plane(*mask), fresnel=plane(0.04))
    found = colour_of(material, unit(POLE, dtype), unit(POLE, dtype))
    masks = mask * (3 // len(mask))
    expected = [d + math.pi * m * c * 0.04 / 1.0001 for d, m, c in zip((0.1, 0.2, 0.3), masks, COLOUR, strict=True)]
    assert_same(found, torch.tensor(expected, dtype=dtype))


@pytest.mark.parametrize(("exponent", "power"), [(5.0, 1 / 32), (1.0, 1 / 2), (1, 1 / 2)])
def test_values_by_hand_at_60_degrees(exponent, power, dtype):
    material = build(dtype, diffuse=plane(0.1, 0.2, 0.3), fresnel=plane(0.2), fresnel_exponent=exponent)
    # D is 1/2 + 1/2 - 1/4. Back along the light L.H is 1; across the normal H = N and L.H is 1/2.
    for view, fresnel in ((polar(60, 0, dtype), 0.2), (polar(60, 180, dtype), 0.2 + 0.8 * power)):
        expected = [d / 2 + math.pi / 2 * c * fresnel / 0.7501 for d, c in zip((0.1, 0.2, 0.3), COLOUR, strict=True)]
        assert_same(colour_of(material, polar(60, 0, dtype), view), torch.tensor(expected, dtype=dtype))


@pytest.mark.parametrize(("across", "up", "row", "column"), [(1, 1, 0, 1), (-1, 1, 0, 0), (1, -1, 1, 1), (-1, -1, 1, 0)])
def test_the_specular_map_has_its_first_row_at_the_top(across, up, row, column, dtype):
    # Half vectors at (+-1/2, +-1/2) of the parabolic map are (+-2, +-2, 1) / 3: the centres of the texels of a 2 x 2 map.
    table = torch.tensor([[0.1, 0.2], [0.3, 0.4]], dtype=torch.float64).expand(3, 2, 2)
    half = unit((2 * across, 2 * up, 1), dtype)
    value = colour_of(build(dtype, specular=table), half, half)
    share = math.pi / 3 / (2 / 3 - 1 / 9 + 1e-4)
    assert_same(value, torch.full((3,), float(table[0, row, column]) * share, dtype=dtype))


def _neutral(part: str, size: tuple[int, int]) -> torch.Tensor:
    values = {"normal": (0, 0, 1), "specular_mask": (1, 1, 1), "fresnel": (1,), "rotation": (1, 0)}
    if part == "tilt":
        return default_tilt(torch.float64)
    return plane(*map(float, values[part])).expand(-1, *size).contiguous()


@pytest.mark.parametrize("part", PRINTED)
def test_an_absent_part_is_its_neutral_value(part):
    maps = make_maps("distribution", FULL, 2, 3)
    with_neutral = Distribution({**maps, part: _neutral(part, (2, 3))}, **FULL)
    others = [name for name in PRINTED if name != part]
    without = Distribution({name: maps[name] for name in maps if name != part}, **{**FULL, "parts": others})
    light, view = per_image(directions(20)), per_image(directions(20, seed=2))
    # Between whole degrees a straight line stands for the cosine: up to (1 degree)^2 / 8 = 3.8e-5 apart, over D >= 0.19.
    assert_same(with_neutral.shade(light, view), without.shade(light, view), 4e-4 if part == "tilt" else 1e-12)


def test_the_default_tilt_is_the_cosine_at_whole_degrees(dtype):
    table = random_table()
    plain, tilted = build(dtype, specular=table), build(dtype, specular=table, tilt=default_tilt(torch.float64))
    for light_deg, view_deg in ((0, 0), (1, 45), (30, 89), (77, 12)):
        light, view = polar(light_deg, 20, dtype), polar(view_deg, 250, dtype)
        # In float32 the angle near the pole is known to 2e-4 radians, half of 1 - cos(1 degree).
        assert_same(colour_of(tilted, light, view), colour_of(plain, light, view), 1e-4 if dtype == torch.float32 else 1e-11)


@pytest.mark.parametrize("chosen", [0, 1])
def test_case_7_one_index_weight_of_1_is_that_lobe_alone(chosen, dtype):
    table = random_table(lobes=2)
    weight = plane(*(1.0 if lobe == chosen else 0.0 for lobe in range(2)))
    both = build(dtype, lobes=2, index=weight, specular=table)
    alone = build(dtype, specular=table[3 * chosen : 3 * chosen + 3])
    light, view = per_image(directions(9, dtype)), per_image(directions(9, dtype, 2))
    assert_same(both.shade(light, view), alone.shade(light, view))
    differentiated(both, light, view)


def test_turning_by_90_degrees_turns_the_specular_map(dtype):
    # Turned by +90 degrees the tangent points up, so what the map has at its right shows for half vectors that point up.
    table = random_table()
    light, view = per_image(directions(9, dtype)), per_image(directions(9, dtype, 2))
    for quarter, rotation in enumerate(((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))):
        turned = build(dtype, specular=table, rotation=plane(*rotation))
        painted = build(dtype, specular=table.rot90(quarter, (-2, -1)))
        assert_same(turned.shade(light, view), painted.shade(light, view))
    right = torch.zeros(3, 2, 2, dtype=torch.float64)
    right[:, :, 1] = 1
    up = polar(50, 90, dtype)
    assert float(colour_of(build(dtype, specular=right, rotation=plane(0.0, 1.0)), up, up).min()) > 1
    down = polar(50, 270, dtype)
    assert float(colour_of(build(dtype, specular=right, rotation=plane(0.0, 1.0)), down, down).max()) < 0.1


def test_the_length_of_a_rotation_does_not_matter():
    light, view = per_image(directions(9)), per_image(directions(9, seed=2))
    long, short = (build(specular=random_table(), rotation=plane(0.6 * k, 0.8 * k)) for k in (1.0, 0.3))
    assert_same(short.shade(light, view), long.shade(light, view))


def _grazing_pair(normal: torch.Tensor, light_cosine: float, view_cosine: float, apart_deg: float, dtype):
    """Light and view of those cosines with `normal`, `apart_deg` apart in azimuth around it, both above the plane."""
    n = normal[:, 0, 0]
    uphill = torch.tensor([-n[2], 0, n[0]], dtype=torch.float64) if float(n[0]) > 0 else torch.tensor([1.0, 0, 0]).double()
    across = torch.linalg.cross(n, uphill)
    half_angle = math.radians(apart_deg) / 2
    found = []
    for cosine, angle in ((light_cosine, -half_angle), (view_cosine, half_angle)):
        flat = math.cos(angle) * uphill + math.sin(angle) * across
        found.append(unit(math.sqrt(1 - cosine * cosine) * flat + cosine * n, dtype))
    return found


@pytest.mark.parametrize("apart_deg", [0, 60, 130])
@pytest.mark.parametrize("tilt_deg", [0, 70])
@pytest.mark.parametrize("path", ["together", "light first", "view first", "light a tenth"])
def test_case_2_value_is_finite_and_continuous_on_every_path_into_grazing(path, tilt_deg, apart_deg, dtype):
    normal = polar(tilt_deg)
    material = build(dtype, normal=normal, diffuse=plane(0.1, 0.2, 0.3), fresnel=plane(0.1))
    heights = 0.5 * 1.1 ** -np.arange(180.0)  # down to 2e-8
    cosines = {
        "together": (heights, heights), "light first": (heights**2, heights), "view first": (heights, heights**2),
        "light a tenth": (heights / 10, heights),
    }[path]
    pairs = [_grazing_pair(normal, *pair, apart_deg, dtype) for pair in zip(*cosines, strict=True)]
    value = differentiated(material, *(torch.stack(side) for side in zip(*pairs, strict=True)))[:, :, 0, 0]
    largest = math.pi * max(COLOUR)
    # A tenth less of the cosines changes h / (h + 1e-4) by at most 2.4 % of all there is, and the Fresnel term by less.
    assert float((value[1:] - value[:-1]).abs().max()) < 0.03 * largest
    # In float32 the cosine with a steep normal is known to 1e-7.
    assert float(value[-1].max()) < (5e-3 if dtype == torch.float32 else 1e-3) * largest


@pytest.mark.parametrize("sides", [(0.0, 0.0), (0.0, 0.5), (0.5, 0.0), (-0.1, 0.0), (0.0, -0.1), (-0.1, -0.1)])
def test_case_2_exactly_on_and_behind_the_horizon_of_a_texel(sides, dtype):
    normal = polar(60)
    parts = {"normal": normal, "fresnel": plane(0.1), "tilt": default_tilt(torch.float64)}
    material = build(dtype, diffuse=plane(0.1, 0.2, 0.3), **parts)
    value = differentiated(material, *_grazing_pair(normal, *sides, 60, dtype))
    if sides[0] <= 0:
        assert float(value.max()) < 2e-2 * math.pi  # a rounding error of 6e-8 over 1e-4
    if sides[0] < 0:
        assert not bool(value.any())


@pytest.mark.parametrize("azimuth_deg", [0, 77, 180, 300])
def test_case_3_normals_tilted_by_89_9_degrees(azimuth_deg, dtype):
    lights = torch.stack([polar(*angles, dtype) for angles in ((0, 0), (60, 0), (60, 180), (89.99, 77), (89.99, 257))])
    maps = {"fresnel": plane(0.1), "rotation": plane(0.6, 0.8), "tilt": default_tilt(torch.float64)}
    material = build(dtype, normal=polar(89.9, azimuth_deg), specular=random_table(), **maps)
    value = differentiated(material, lights[:, None], lights[None])
    assert value.shape == (5, 5, 3, 1, 1) and float(value.max()) > 0


@pytest.mark.parametrize("normal", [(0.0, 0.0, 0.0), (0.0, 0.0, -1.0), (1.0, 0.0, 0.0)])
def test_case_3_normals_that_are_none(normal, dtype):
    material = build(dtype, normal=plane(*normal), specular=random_table(), rotation=plane(0.0, 0.0))
    differentiated(material, torch.stack([polar(30, 10, dtype), polar(85, 0, dtype)]), polar(40, 200, dtype))


def test_case_4_half_vectors_at_the_rim_and_beyond(dtype):
    # Half vectors in the tangent plane of the texel, and below it, take what the map has at its rim in that direction.
    table = torch.zeros(3, 4, 4, dtype=torch.float64)
    table[:, :, 0], table[:, :, 3] = 0.2, 0.4
    normal = polar(70)
    material = build(dtype, normal=normal, specular=table)
    n = normal[:, 0, 0]
    uphill = torch.stack((-n[2], torch.zeros_like(n[0]), n[0]))
    values = []
    for cosine in (1e-2, 1e-3, 1e-4):
        # At the rim x is -1: half a texel beyond the centre of the first column.
        along = unit(uphill + cosine * n, dtype)
        value = differentiated(material, along, along)
        share = math.pi * cosine / (2 * cosine - cosine**2 + 1e-4)
        assert_same(value[:, 0, 0], torch.full((3,), 0.2 * share, dtype=dtype), 2e-3 if dtype == torch.float32 else 1e-3)
        values.append(value)
    light, view = unit(uphill + 0.3 * n, dtype), unit(uphill - 0.4 * n, dtype)  # the half vector lies below
    differentiated(material, light, view)


@pytest.mark.parametrize("size", [1, 2, 4, 5])
def test_case_4_half_vector_at_the_centre_where_rotation_does_not_matter(size, dtype):
    table = random_table(size)
    values = []
    for angle in torch.linspace(0, 2 * math.pi, 9).tolist():
        material = build(dtype, specular=table, rotation=plane(math.cos(angle), math.sin(angle)))
        for light_deg in (0, 40):
            value = differentiated(material, polar(light_deg, 0, dtype), polar(light_deg, 180, dtype))
            assert light_deg or not bool(material.maps["rotation"].grad.any())
            material.maps["rotation"].grad = None
            values.append((light_deg, value))
    middle = table[:, (size - 1) // 2 : size // 2 + 1, (size - 1) // 2 : size // 2 + 1].mean(dim=(1, 2)).to(dtype)
    for light_deg, value in values:
        cosine = math.cos(math.radians(light_deg))
        share = math.pi * cosine / (2 * cosine - cosine**2 + 1e-4)
        assert_same(value[:, 0, 0], middle * share)


@pytest.mark.parametrize(("x", "weights"), [
    (-0.5, (0.5, 0.5, 0, 0)), (0.0, (0, 0.5, 0.5, 0)), (0.5, (0, 0, 0.5, 0.5)),  # edges between texels
    (-0.75, (1, 0, 0, 0)), (-0.25, (0, 1, 0, 0)), (0.25, (0, 0, 1, 0)),  # their centres, where the slope jumps
    (-0.99, (1, 0, 0, 0)), (0.99, (0, 0, 0, 1)),  # beyond the outermost centres
])
def test_case_4_half_vector_on_the_edge_and_the_centre_of_a_texel(x, weights, dtype):
    columns = torch.tensor([0.1, 0.4, 0.2, 0.3], dtype=torch.float64)
    material = build(dtype, specular=columns.expand(3, 4, 4))
    for move in (0.0, -1e-6, 1e-6):
        place = x + move
        half = unit((2 * place, 0, 1 - place * place), dtype)
        value = differentiated(material, half, half)
        cosine = float(half[2, 0, 0])
        share = math.pi * cosine / (2 * cosine - cosine**2 + 1e-4)
        expected = float(columns @ torch.tensor(weights, dtype=torch.float64)) * share
        # A step of 1e-6 of the way at a slope below 1 a texel.
        assert_same(value[:, 0, 0], torch.full((3,), expected, dtype=dtype), 5e-5)


def test_case_5_359_and_1_degrees_average_to_0(dtype):
    angle = torch.deg2rad(torch.tensor([359.0, 1.0], dtype=torch.float64))
    rotation = torch.stack((torch.cos(angle), torch.sin(angle)))[:, None]
    diffuse = torch.zeros(3, 1, 2, dtype=torch.float64)
    turned = build(dtype, specular=random_table(), rotation=rotation, diffuse=diffuse)
    between = turned.at(torch.full((2, 1, 1), 0.5, dtype=dtype))
    plain = build(dtype, specular=random_table())
    light, view = per_image(directions(9, dtype)), per_image(directions(9, dtype, 2))
    assert_same(between.shade(light, view), plain.shade(light, view))
    level = turned.with_maps(rotation=turned.maps["rotation"].detach().mean(dim=2, keepdim=True).expand(2, 1, 2))
    assert_same(level.shade(light, view)[..., :1], plain.shade(light, view))  # as on a mip level


@pytest.mark.parametrize("exponent", [5.0, 1.0, 0.5, 40.0])
@pytest.mark.parametrize("reflectance", [0.0, 1.0])
def test_case_7_fresnel_ends(reflectance, exponent, dtype):
    material = build(dtype, fresnel=plane(reflectance), fresnel_exponent=exponent)
    for angle_deg, azimuth_deg in ((0, 0), (50, 0), (50, 180), (89.99, 180)):
        light, view = polar(angle_deg, 0, dtype), polar(angle_deg, azimuth_deg, dtype)
        value = differentiated(material, light, view)
        if reflectance == 1:
            assert_same(value[:, 0, 0], colour_of(build(dtype), light, view))
        elif torch.equal(light, view):
            # L.H is 1 up to rounding, of which 1 - L.H may be 2e-7.
            assert float(value.max()) < (1e-6 if exponent >= 1 else 2e-3)


@pytest.mark.parametrize("level", [0.0, 1.0])
def test_case_7_constant_tilt_curves(level, dtype):
    # d = 1 everywhere takes D out; d = 0 leaves 1e-4 of it. Both are bounded.
    material = build(dtype, tilt=torch.full((1, 1, 91), level, dtype=torch.float64))
    light, view = polar(40, 0, dtype), polar(70, 90, dtype)
    share = math.pi * math.cos(math.radians(40)) / (1.0001 if level == 0 else 1e-4)
    found = differentiated(material, light, view)[:, 0, 0]
    assert_same(found, torch.tensor(COLOUR, dtype=dtype) * share, 5e-5 if dtype == torch.float32 else 1e-11)
    for steep in (0.0, 89.9999):
        differentiated(material, polar(steep, 0, dtype), polar(steep, 10, dtype))


def test_a_map_of_quarter_turn_symmetry_is_isotropic_for_quarter_turns(dtype):
    table = sum(random_table(6).rot90(turn, (-2, -1)) for turn in range(4)) / 4
    material = build(dtype, specular=table, fresnel=plane(0.1), diffuse=plane(0.1, 0.2, 0.3))
    light, view = per_image(directions(9, dtype)), per_image(directions(9, dtype, 2))

    def turned(rows):
        return torch.cat((-rows[:, 1:2], rows[:, :1], rows[:, 2:]), dim=1)

    assert_same(material.shade(turned(light), turned(view)), material.shade(light, view))


@pytest.mark.parametrize("angle_deg", [17.0, 45.0, 203.0])
def test_a_radial_map_is_isotropic(angle_deg):
    axis = (torch.arange(64, dtype=torch.float64) + 0.5) / 32 - 1
    table = torch.exp(-4 * (axis[:, None] ** 2 + axis[None] ** 2)).expand(3, 64, 64)
    material = build(specular=table, diffuse=plane(0.1, 0.2, 0.3))
    light, view = per_image(directions(30)), per_image(directions(30, seed=2))
    cosine, sine = math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))
    turn = torch.tensor([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]], dtype=torch.float64)
    found = material.shade(*(torch.einsum("ij,njhw->nihw", turn, d) for d in (light, view)))
    # Bilinear between texels 1/32 apart, curvature up to 8: 8 / 32^2 / 8 = 1e-3 along each axis.
    assert_same(found, material.shade(light, view), 2e-3)
    rotated = build(specular=table, diffuse=plane(0.1, 0.2, 0.3), rotation=plane(cosine, sine))
    assert_same(rotated.shade(light, view), material.shade(light, view), 2e-3)


@pytest.mark.parametrize("exponent", [5.0, 1.0])
def test_reciprocity(exponent):
    maps = make_maps("distribution", FULL, 3, 3)
    material = Distribution(maps, **FULL, fresnel_exponent=exponent)
    light, view = per_image(directions(20, lowest=0.6)), per_image(directions(20, seed=2, lowest=0.6))
    normal = maps["normal"]
    cosines = [(normal * d).sum(dim=-3, keepdim=True) for d in (light, view)]
    assert float(torch.stack(cosines).min()) > 0
    assert_same(material.shade(light, view) / cosines[0], material.shade(view, light) / cosines[1], 1e-11)


@pytest.mark.parametrize("storage", ["png8", "half"])
@pytest.mark.parametrize("channels", [1, 3])
def test_round_trip(storage, channels, tmp_path):
    options = {**FULL, "mask_channels": channels, "fresnel_exponent": 1.0}
    material = Distribution(make_maps("distribution", options, 5, 4, torch.float32), storage=storage, **options)
    loaded = load_material(save_material(material, tmp_path / "out"))
    assert type(loaded) is Distribution and loaded.options == options
    assert loaded.maps["specular_mask"].shape == (channels, 5, 4)
    promised = material.as_exported()
    light, view = (per_image(directions(8, torch.float32, seed)) for seed in (1, 2))
    with torch.no_grad():
        assert torch.equal(loaded.shade(light, view), promised.shade(light, view))
        # Eight bits of a normal are half a degree, and of an index, rotation and mask 0.2 to 0.4 %.
        assert_same(loaded.shade(light, view), material.shade(light, view), 0.03 if storage == "png8" else 2e-3)
    suffix = ".png" if storage == "png8" else ".exr"
    names = {path.name for path in (tmp_path / "out").iterdir()}
    one_each = {f"{name}{suffix}" for name in ("diffuse", "normal", "specular_mask", "fresnel", "rotation_x", "rotation_y")}
    lobes = {f"index_{k}{suffix}" for k in (1, 2)} | {f"specular_{k}.exr" for k in (1, 2)}
    assert names == {"manifest.json", "tilt.exr"} | one_each | lobes


def test_the_specular_maps_keep_half_precision_beside_8_bits():
    material = Distribution(make_maps("distribution", FULL, 5, 4), storage="png8", **FULL)
    # 3 diffuse, 3 normal, 3 mask, 1 Fresnel, 2 rotation, 2 index; two maps of 6 x 6 x 3 and 91 of tilt as halves.
    assert material.bytes_per_texel == 14
    assert material.shared_bytes == 2 * (2 * 3 * 36 + 91)


@pytest.mark.parametrize("tiles", [True, False])
def test_slopes_of_height_and_normal_add_up(tiles, dtype):
    columns = torch.arange(8, dtype=torch.float64)
    # A ramp that rises by 0.3 a width toward +x, and slopes of 0.1 and -0.2 on top.
    height = (0.3 * columns / 8).expand(1, 6, 8).to(dtype)
    normal = unit((-0.1, 0.2, 1.0), dtype).expand(3, 6, 8)
    material = build(dtype, normal=normal, specular=random_table(), tiles=tiles).on_relief(height)
    expected = unit((-0.4, 0.2, 1.0), dtype).expand(3, 6, 6)
    assert_same(material.surface().maps["normal"].detach()[:, :, 1:-1], expected)
    bare = build(dtype, diffuse=torch.ones(3, 6, 8), tiles=tiles).on_relief(height)
    expected = unit((-0.3, 0.0, 1.0), dtype).expand(3, 6, 6)
    assert_same(bare.surface().maps["normal"].detach()[:, :, 1:-1], expected)
    assert bare.options["parts"] == [] and bare.surface().options["parts"] == ["normal"]


def test_what_is_kept_between_pictures_does_not_outlive_the_maps():
    light, view = polar(30), polar(40, 100)
    material = build(normal=plane(0.0, 0.0, 1.0), specular=random_table())
    other = build(normal=plane(0.6, 0.0, 0.8), specular=random_table())
    with torch.no_grad():
        first = material.shade(light, view)
        material.maps["normal"].copy_(plane(0.6, 0.0, 0.8))
        second = material.shade(light, view)
        assert torch.equal(second, other.shade(light, view)) and not torch.equal(first, second)
        assert torch.equal(material.shade(light, view), second)
        narrow = material.float().shade(light.float(), view.float())
        assert_same(narrow, second.float())
    seen = material.double().at(torch.full((2, 3, 4), 0.5, dtype=torch.float64))
    assert_same(seen.shade(light, view), second.expand(3, 3, 4), 1e-6)


def test_inference_mode():
    light, view = polar(30), polar(40, 100)
    expected = build(normal=plane(0.6, 0.0, 0.8), specular=random_table()).shade(light, view).detach()
    with torch.inference_mode():
        material = build(normal=plane(0.6, 0.0, 0.8), specular=random_table())
        for _ in range(2):
            assert torch.equal(material.shade(light, view), expected)


def test_an_empty_batch_is_an_empty_picture():
    none, one = torch.zeros(0, 3, 1, 1, dtype=torch.float64), polar(20)
    for given in ({}, {"rotation": plane(0.6, 0.8)}):
        assert build(**given).shade(none, one).shape == (0, 3, 1, 1)
    assert build().shade(none[:, None], one.expand(2, 3, 1, 1)).shape == (0, 2, 3, 1, 1)


def test_the_oracle_by_hand():
    # What the contract holds the model to, at a normal along x: the shortest rotation takes +x to -z and leaves +y.
    maps = {"diffuse": plane(0.0, 0.0, 0.0).numpy(), "normal": plane(1.0, 0.0, 0.0).numpy()}
    maps["specular"] = np.zeros((3, 2, 2))
    maps["specular"][:, 0] = (0.25, 0.5)
    light = np.array([0.6, 0.48, 0.64])
    # In the frame (-z, y, x) it is (-0.64, 0.48, 0.6): left and up at (-0.4, 0.3), 0.1 texels right of the first centre.
    colour = (0.25 * 0.9 + 0.5 * 0.1) * (0.8 + 0.0)  # 0.8 of the upper row, at 0.2 texels below its centre
    expected = math.pi * 0.6 * colour / (1.2 - 0.36 + 1e-4)
    found = oracle.VALUES["distribution"](maps, {"lobes": 1}, light, light, 0, 0)
    np.testing.assert_allclose(found, [expected] * 3, rtol=1e-12)


@pytest.mark.parametrize("lobes", [-1, 1.5, True, 13, "1", None])
def test_a_wrong_number_of_lobes_is_named(lobes):
    with pytest.raises(RangeError, match="distribution: lobes must be a whole number from 0 to 12; it is"):
        Distribution({"diffuse": torch.ones(3, 2, 2)}, lobes=lobes)


@pytest.mark.parametrize("exponent", [0, -1.0, math.inf, math.nan])
def test_a_wrong_exponent_is_named(exponent):
    with pytest.raises(RangeError, match="distribution: fresnel_exponent must be positive and finite; .*5 is Schlick's"):
        build(fresnel=plane(0.1), fresnel_exponent=exponent)


def test_wrong_options_are_named_with_the_nearest():
    maps = {"diffuse": torch.ones(3, 2, 2)}
    with pytest.raises(RangeError, match="distribution: parts must .* is 'specular_msk'.*Did you mean 'specular_mask'"):
        Distribution(maps, parts=["specular_msk"])
    with pytest.raises(RangeError, match="distribution: mask_channels must be one of 1, 3; it is 2"):
        Distribution(maps, mask_channels=2)
    with pytest.raises(RangeError, match="key 'lobe' .*Did you mean 'lobes'"):
        Distribution(maps, lobe=1)


def test_tables_of_the_wrong_shape_are_named():
    with pytest.raises(ShapeError, match=r"distribution: specular must be square; it is \(3, 4, 6\)"):
        build(specular=torch.ones(3, 4, 6))
    for shape in ((1, 1, 90), (1, 91, 1), (1, 2, 91)):
        with pytest.raises(ShapeError, match=r"distribution: tilt must be \[1, 1, 91\]; it is"):
            build(tilt=torch.full(shape, 0.5))
    with pytest.raises(ShapeError, match=r"distribution: specular must be \[6, H, W\]"):
        build(lobes=2, specular=torch.ones(3, 4, 4), index=plane(0.5, 0.5))
    with pytest.raises(ShapeError, match=r"distribution: specular_mask must be \[1, H, W\]"):
        Distribution({"diffuse": torch.ones(3, 2, 2), "specular_mask": torch.ones(3, 2, 2), "specular": torch.ones(3, 4, 4)})
    with pytest.raises(ShapeError, match=r"index is missing"):
        build(lobes=2)
    with pytest.raises(RangeError, match=r"fresnel must lie in \[0.0, 1.0\]"):
        build(fresnel=plane(1.1))
