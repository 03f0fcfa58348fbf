"""Any model on a height map: parallax, shadow and ambient light, against loops over texels and by hand."""

from __future__ import annotations

import functools
import itertools
import json
import math

import numpy as np
import pytest
import torch
from tests.models.examples import CASES, assert_same, directions, make, make_maps, per_image, per_texel
from tests.reference import materials as flat_oracle
from tests.reference import relief as oracle
from tests.reference.gradient import central
from tests.support import TOLERANCE, assert_close

from torchmat import load_material, save_material
from torchmat.errors import DataError, Notice, RangeError, ShapeError
from torchmat.geometry import rays, soft_shadow, trace_view
from torchmat.geometry.rays import texel_centres
from torchmat.images import read_image, write_image
from torchmat.models import MATERIALS, Lambert, Texture

every_model = pytest.mark.parametrize("name, options", CASES)
HEIGHT, WIDTH = 6, 8
# The first light throws shadows, the second reaches every texel of the relief below.
LIGHTS = ((0.3, -0.9, 0.25), (-0.2, 0.3, 0.9))
VIEWS = ((-0.5, 0.6, 0.6), (0.7, 0.1, 0.7))
SOFTNESS = 0.05
# Regula falsi ends about 1e-6 of a texture width from the root; the oracle bisects. Times a change of the random maps
# from texel to texel, measured at most 1.2e-5 of the largest value over all models.
ROOT = 5e-5
# `shade` sends four rays a texel, some of which only just clear an edge, where the search ends less close to the root:
# measured at most 1.4e-4. One ray a texel, or bilinear look-ups, are off by more than 1e-2.
FOUR_RAYS = 3e-4


def unit(x: float, y: float, z: float, dtype=torch.float64) -> torch.Tensor:
    vector = torch.tensor([x, y, z], dtype=torch.float64)
    return (vector / vector.norm()).to(dtype)[:, None, None]


def waves(rows: int = HEIGHT, columns: int = WIDTH, amplitude: float = 0.12, dtype=torch.float64) -> torch.Tensor:
    """A tileable height [1, H, W] of slow waves about zero."""
    v, u = np.meshgrid((np.arange(rows) + 0.5) / rows, (np.arange(columns) + 0.5) / columns, indexing="ij")
    total = np.sin(2 * np.pi * (u + v) + 0.4) + 0.6 * np.cos(2 * np.pi * u - 1.1) + 0.5 * np.sin(2 * np.pi * v + 2.0)
    return torch.from_numpy(amplitude * total / np.ptp(total))[None].to(dtype)


def ambient(rows: int = HEIGHT, columns: int = WIDTH, dtype=torch.float64) -> torch.Tensor:
    random = np.random.default_rng(11)
    return torch.from_numpy(random.uniform(0, 0.2, (3, rows, columns))).to(dtype)


def on_waves(name, options, rows=HEIGHT, columns=WIDTH, dtype=torch.float64, amplitude=0.12, **settings):
    flat = make(name, options, rows, columns, dtype, **settings)
    return flat.on_relief(waves(rows, columns, amplitude, dtype), ambient(rows, columns, dtype))


def arrays(material) -> dict:
    return {key: value.detach().double().numpy() for key, value in material.maps.items()}


def surface_arrays(material) -> dict:
    """Return the maps of what one texel does; normals of lobes are those of the height, refined: slopes add up."""
    maps = arrays(material)
    if material.name in ("distribution", "microfacet"):
        slopes = oracle.sobel(maps["height"][0], material.tiles) * material.size[1] / 8
        if "normal" in maps:
            slopes = slopes - maps["normal"][:2] / maps["normal"][2]
        normal = np.stack((-slopes[0], -slopes[1], np.ones(material.size)))
        maps["normal"] = normal / np.linalg.norm(normal, axis=0)
    return maps


def row_of(direction: torch.Tensor) -> np.ndarray:
    return direction.detach().double().numpy().reshape(3)


def bicubic(planes: np.ndarray, u: float, v: float, tiles: bool) -> np.ndarray:
    """Return planes [C, H, W] at u, v by cubic convolution (Keys 1981, a = -0.75)."""
    rows, columns = planes.shape[1:]
    x, y = u * columns - 0.5, (1 - v) * rows - 0.5
    left, top = math.floor(x), math.floor(y)

    def weight(distance: float) -> float:
        a, d = -0.75, abs(distance)
        if d <= 1:
            return (a + 2) * d**3 - (a + 3) * d**2 + 1
        return a * d**3 - 5 * a * d**2 + 8 * a * d - 4 * a if d < 2 else 0.0

    total = np.zeros(len(planes))
    for row in range(top - 1, top + 3):
        for column in range(left - 1, left + 3):
            r = row % rows if tiles else min(max(row, 0), rows - 1)
            c = column % columns if tiles else min(max(column, 0), columns - 1)
            total += weight(x - column) * weight(y - row) * planes[:, r, c]
    return total


def hit_of(height: np.ndarray, view: np.ndarray, u: float, v: float, tiles: bool) -> tuple[float, float]:
    z = oracle.first_hit(height, view, u, v, tiles, steps=400)
    du, dv = oracle.slope_of(view, height.shape)
    return u + z * du, v + z * dv


def clearance_at(height: np.ndarray, light: np.ndarray, u: float, v: float, tiles: bool) -> float:
    """By how much the light's ray is free at u, v. The ray is asked as often as the package documents: once a texel."""
    rows, columns = height.shape
    du, dv = oracle.slope_of(light, height.shape)
    steps = math.ceil(math.hypot(du * columns, dv * rows) * float(height.max() - height.min())) + 2
    return oracle.least_clearance(height, light, u, v, tiles, steps)


def shadow_at(height: np.ndarray, light: np.ndarray, u: float, v: float, tiles: bool) -> float:
    """The share of the light at u, v."""
    return min(max(clearance_at(height, light, u, v, tiles) / SOFTNESS + 0.5, 0.0), 1.0)


def centre_of(row: int, column: int, shape: tuple[int, int]) -> tuple[float, float]:
    return (column + 0.5) / shape[1], 1 - (row + 0.5) / shape[0]


@functools.lru_cache(maxsize=None)
def walked(light: tuple, view: tuple, tiles: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return what each of four rays a texel of `waves()` sees, uv [4, 2, H, W] brought back to the texel's centre, and
    how much light reaches it [H, W]."""
    height = waves()[0].numpy()
    light, view = row_of(unit(*light)), row_of(unit(*view))
    seen, lit = np.zeros((4, 2, *height.shape)), np.zeros(height.shape)
    for row, column in np.ndindex(height.shape):
        centre = centre_of(row, column, height.shape)
        for ray, (x, y) in enumerate(itertools.product((-0.25, 0.25), repeat=2)):
            offset = np.array([x / height.shape[1], y / height.shape[0]])
            seen[ray, :, row, column] = hit_of(height, view, *(centre + offset), tiles) - offset
        lit[row, column] = shadow_at(height, light, *centre, tiles)
    return seen, lit


def expected_picture(name, options, material, light: tuple, view: tuple) -> np.ndarray:
    """Shade texel by texel, then look the picture up where the rays of the view end."""
    seen, lit = walked(light, view, material.tiles)
    maps = surface_arrays(material)
    directions_ = (row_of(unit(*d))[:, None, None] for d in (light, view))
    shaded = flat_oracle.shade(name, maps, options, *directions_, HEIGHT, WIDTH) * lit + maps["ambient"]
    picture = np.zeros_like(shaded)
    for row, column in np.ndindex(lit.shape):
        picture[:, row, column] = np.mean([bicubic(shaded, *ray[:, row, column], material.tiles) for ray in seen], axis=0)
    return np.maximum(picture, 0)


def at_point(material, u: float, v: float) -> dict:
    """Return the maps at u, v as maps of one texel: bilinear, indices from the texel that holds the point."""
    found = {}
    rows, columns = material.size
    specs = {spec.name: spec for spec in material.surface().specs()} | {spec.name: spec for spec in material.specs()}
    for key, value in surface_arrays(material).items():
        spec = specs[key]
        if spec.constant or not spec.per_texel:
            found[key] = value
        elif spec.index:
            column, row = math.floor(u * columns), math.floor((1 - v) * rows)
            if material.tiles:
                column, row = column % columns, row % rows
            else:
                column, row = min(max(column, 0), columns - 1), min(max(row, 0), rows - 1)
            found[key] = value[:, row : row + 1, column : column + 1]
        else:
            planes = [oracle.bilinear(plane, u, v, material.tiles) for plane in value]
            found[key] = np.array(planes)[:, None, None]
    return found


def expected_point(name, options, material, u: float, v: float, light: torch.Tensor, view: torch.Tensor) -> np.ndarray:
    light, view = row_of(light), row_of(view)
    height = arrays(material)["height"][0]
    hit = hit_of(height, view, u, v, material.tiles)
    maps = at_point(material, *hit)
    value = flat_oracle.shade(name, maps, options, light[:, None, None], view[:, None, None], 1, 1)
    return (value * shadow_at(height, light, *hit, material.tiles) + maps["ambient"])[:, 0, 0]


def test_the_bicubic_oracle_by_hand():
    planes = np.array([[[0.0, 0.0, 1.0, 0.0, 0.0, 0.0]]])
    # Half way to its neighbour an impulse weighs 0.59375 with a = -0.75, and -0.09375 half a texel further out.
    found = [bicubic(planes, (2.5 + d) / 6, 0.5, True)[0] for d in (0, 0.5, 1, 1.5, -1.5, 2)]
    assert np.allclose(found, [1, 0.59375, 0, -0.09375, -0.09375, 0], atol=1e-12)


def test_the_example_has_parallax_and_shadow():
    seen, lit = walked(LIGHTS[0], VIEWS[0], True)
    moved = seen - texel_centres(HEIGHT, WIDTH, torch.float64).numpy()
    assert np.abs(moved * np.array([WIDTH, HEIGHT])[:, None, None]).max() > 0.4
    assert (lit == 0).mean() > 0.1 and (lit == 1).mean() > 0.3
    assert walked(LIGHTS[1], VIEWS[1], True)[1].min() == 1


@every_model
@pytest.mark.parametrize("tiles", [True, False])
def test_shade_matches_the_oracle(name, options, tiles):
    material = on_waves(name, options, tiles=tiles)
    flat = material.surface()
    for light, view in zip(LIGHTS, VIEWS, strict=True):
        expected = torch.from_numpy(expected_picture(name, options, material, light, view))
        assert_same(material.shade(unit(*light), unit(*view)), expected, FOUR_RAYS)
        without = flat.shade(unit(*light), unit(*view)).detach() + ambient()
        assert float((without - expected).abs().max()) > 0.05 * float(expected.max()), "a flat surface would pass as well"


@every_model
@pytest.mark.parametrize("tiles", [True, False])
def test_shade_at_matches_the_oracle(name, options, tiles):
    material = on_waves(name, options, tiles=tiles)
    random = np.random.default_rng(4)
    uv = torch.from_numpy(random.uniform(-0.6, 1.6, (2, 3, 4)))
    light, view = unit(0.3, -0.9, 0.15) + 0.1 * per_texel(3, 4, seed=21), per_texel(3, 4, seed=22, lowest=0.35)
    light = light / light.norm(dim=0)
    expected, unlit = torch.zeros(3, 3, 4, dtype=torch.float64), 0
    for row, column in np.ndindex(3, 4):
        place = (*uv[:, row, column].tolist(), light[:, row, column], view[:, row, column])
        expected[:, row, column] = torch.from_numpy(expected_point(name, options, material, *place))
        hit = hit_of(arrays(material)["height"][0], row_of(place[3]), *place[:2], tiles)
        unlit += shadow_at(arrays(material)["height"][0], row_of(place[2]), *hit, tiles) < 0.5
    assert unlit > 0, "no point lies in shadow"
    assert_same(material.shade_at(uv, light, view), expected, ROOT)


@every_model
def test_directions_per_texel_are_shaded_at_the_texel_centres(name, options, dtype):
    material = on_waves(name, options, dtype=dtype)
    light, view = per_texel(HEIGHT, WIDTH, dtype, 3, 0.3), per_texel(HEIGHT, WIDTH, dtype, 4, 0.3)
    uv = texel_centres(HEIGHT, WIDTH, dtype)
    one = per_image(directions(1, dtype, 5, 0.3))[0]
    for pair in ((light, view), (one, view), (light, one)):
        assert_same(material.shade(*pair), material.shade_at(uv, *pair), 1e-12)
    expected = expected_point(name, options, material, *uv[:, 2, 5].tolist(), light[:, 2, 5], view[:, 2, 5])
    assert_same(material.shade(light, view)[:, 2, 5], torch.from_numpy(expected).to(dtype), ROOT)


@every_model
def test_the_two_ways_of_looking_agree_where_nothing_moves(name, options):
    material = on_waves(name, options)
    light, view = unit(*LIGHTS[0]), unit(0, 0, 1)
    spread = [d.expand(3, HEIGHT, WIDTH).contiguous() for d in (light, view)]
    assert_same(material.shade(*spread), material.shade(light, view), 1e-12)


@every_model
def test_a_vanishing_relief_is_the_flat_surface_plus_ambient(name, options, dtype):
    flat = make(name, options, HEIGHT, WIDTH, dtype)
    light, view = per_image(directions(5, dtype, 1)), per_image(directions(5, dtype, 2))
    for scale, bound in ((1e-12, 1e-11 if dtype == torch.float64 else None), (0.0, None)):  # a relief of 1e-12 moves by as much
        material = flat.on_relief(scale * waves(dtype=dtype), ambient(dtype=dtype))
        assert_same(material.shade(light, view), flat.shade(light, view) + ambient(dtype=dtype), bound)
        # A distribution's normals go to slopes and back, which rounds them.
        same = bound if name in ("distribution", "microfacet") else 0.0
        assert_same(material.surface().shade(light, view), flat.shade(light, view), same)


@every_model
def test_from_straight_above_and_fully_lit_nothing_moves(name, options):
    material = on_waves(name, options)
    light, view = unit(*LIGHTS[1]), unit(0, 0, 1)
    assert_same(material.shade(light, view), material.surface().shade(light, view) + ambient(), 1e-12)


@every_model
def test_a_broadcast_is_what_each_pair_gives(name, options):
    material = on_waves(name, options, 3, 4).requires_grad_(False)
    light = per_image(directions(2, seed=1))[:, None]
    view = per_image(directions(3, seed=2))[None]
    together = material.shade(light, view)
    assert together.shape == (2, 3, 3, 3, 4)
    for i in range(2):
        for j in range(3):
            assert_same(together[i, j], material.shade(light[i, 0], view[0, j]), 1e-12)


def test_a_broadcast_at_points_is_what_each_pair_gives():
    material = on_waves("ptm", {}, 3, 4)
    uv = torch.rand(2, 2, 3, dtype=torch.float64)
    light = per_image(directions(2, seed=1))[:, None]
    view = per_texel(2, 3, seed=2).expand(1, 3, 3, 2, 3)
    together = material.shade_at(uv, light, view)
    assert together.shape == (2, 3, 3, 2, 3)
    for i in range(2):
        assert_same(together[i, 1], material.shade_at(uv, light[i, 0], view[0, 1]), 1e-12)


def test_what_a_ray_meets_does_not_depend_on_the_others_of_the_call():
    # Flat rays take many short steps; they must not make those of their neighbours shorter.
    material = on_waves("texture", {})
    uv = torch.rand(2, 3, 3, dtype=torch.float64)
    light, view = per_texel(3, 3, seed=5, lowest=0.05), per_texel(3, 3, seed=6, lowest=0.05)
    together = material.shade_at(uv, light, view)
    for row, column in np.ndindex(3, 3):
        place = slice(row, row + 1), slice(column, column + 1)
        alone = material.shade_at(uv[:, *place], light[:, *place], view[:, *place])
        assert_same(alone[:, 0, 0], together[:, row, column], 1e-12)


def test_repeated_directions_come_back_in_their_places():
    material = on_waves("lambert", {}, 3, 4)
    few = per_image(directions(3))
    order = [2, 0, 0, 1, 2]
    whole = material.shade(few[order], few.flip(0)[order])
    for place, index in enumerate(order):
        assert_same(whole[place], material.shade(few[index], few.flip(0)[index]), 1e-12)


def test_no_directions_and_no_points_give_empty_pictures():
    material = on_waves("texture", {})
    none, one = torch.zeros(0, 3, 1, 1, dtype=torch.float64), unit(0.3, 0, 1)
    uv = torch.zeros(2, 1, 4, dtype=torch.float64)
    assert material.shade(none, one).shape == (0, 3, HEIGHT, WIDTH)
    assert material.shade_at(uv, none[:, None], one).shape == (0, 1, 3, 1, 4)
    assert material.shade_at(uv[..., :0], one, one).shape == (3, 1, 0)


@every_model
@pytest.mark.parametrize("which", ["light", "view"])
def test_below_the_horizon_is_exactly_zero(name, options, dtype, which):
    material = on_waves(name, options, 2, 3, dtype)
    rows = [((1 - z * z) ** 0.5, 0.0, z) for z in (0.0, -0.0, -1e-30, -0.5)]
    low = torch.tensor(rows, dtype=dtype)[:, :, None, None].requires_grad_()
    high = per_image(directions(1, dtype))[0].requires_grad_()
    pair = (low, high) if which == "light" else (high, low)
    # At points each has a direction of its own: one call for all of them.
    uv, column = torch.rand(2, 4, 3, dtype=dtype), low[:, :, 0].permute(1, 0, 2).expand(3, 4, 3)
    points = (column, high) if which == "light" else (high, column)
    for value, shape in ((material.shade(*pair), (4, 3, 2, 3)), (material.shade_at(uv, *points), (3, 4, 3))):
        assert value.shape == shape and bool((value == 0).all())
        (value * torch.rand_like(value)).sum().backward()  # random weights: what two of them leave cannot cancel
        for leaf in (low, high, *material.maps.values()):
            assert leaf.grad is None or bool((leaf.grad == 0).all())


def test_one_direction_below_leaves_the_others():
    material = on_waves("ptm", {})
    light, view = per_image(directions(4)), per_image(directions(4, seed=2))
    expected = material.shade(light, view).detach()
    light[2] = unit(0.6, 0.0, -0.8)
    expected[2] = 0
    assert_same(material.shade(light, view), expected, 1e-12)


@every_model
def test_at_grazing_directions_float32_agrees_with_float64_values_reach_a_limit_and_gradients_are_finite(name, options):
    uv, values = torch.rand(2, 2, 9, dtype=torch.float64), {}
    single, double = torch.float32, torch.float64
    for dtype, z in ((single, 1e-4), (double, 1e-4), (single, 1e-12), (double, 1e-12), (double, 1e-9)):
        material = on_waves(name, options, 3, 4, dtype)
        low, high = unit(0.6, 0.8, z, dtype).requires_grad_(), unit(0.1, -0.3, 0.8, dtype).requires_grad_()
        lights, views = torch.stack((low, high, low)), torch.stack((high, low, low))
        # At points each pair has three of the nine columns: one call for all of them.
        points = (torch.cat(list(rows.expand(3, 3, 2, 3)), dim=-1) for rows in (lights, views))
        shaded = [value.flatten() for value in (material.shade(lights, views), material.shade_at(uv.to(dtype), *points))]
        sum(value.sum() for value in shaded).backward()
        for leaf in (low, high, *material.maps.values()):
            assert leaf.grad is None or bool(torch.isfinite(leaf.grad).all())
        values[dtype, z] = torch.cat(shaded).detach()
        assert bool((values[dtype, z] >= 0).all()) and float(values[dtype, z].max()) > 0.1
    for z in (1e-4, 1e-12):
        # Rows of a table may change places where two angles are alike: measured 6e-4 of local_pca, 9e-6 of the others.
        assert_close(values[single, z].double(), values[double, z], 2e-3 if "pca" in name else 5e-5)
    # Harmonics end in a root of the height over the horizon, of 1e-9: measured 1.3e-4, the others 2e-6.
    assert_close(values[double, 1e-9], values[double, 1e-12], 3e-4 if name == "hsh" else 1e-5)


@pytest.fixture
def exact_roots(monkeypatch):
    """Refine hits to the last bit, so that a difference of two values is not a difference of two rounding errors."""
    monkeypatch.setattr(rays, "REFINEMENTS", 40)


def _floats(material) -> list[str]:
    return [spec.name for spec in material.specs() if not spec.index and spec.name != "directions"]


def _slopes(material, shade, changes: dict[str, torch.Tensor], step: float = 1e-6) -> tuple[float, float]:
    """Return the derivative along `changes` of the maps, by autograd and by central differences."""
    probe = torch.rand(shade(material).shape, dtype=torch.float64)
    found = torch.autograd.grad((shade(material) * probe).sum(), [material.maps[key] for key in changes])
    by_graph = sum(float((g * change).sum()) for g, change in zip(found, changes.values(), strict=True))
    totals = []
    with torch.no_grad():
        for sign in (1, -1):
            maps = {key: material.maps[key].detach() + sign * step * change for key, change in changes.items()}
            totals.append(float((shade(material.with_maps(**maps)) * probe).sum()))
    return by_graph, (totals[0] - totals[1]) / (2 * step)


@every_model
@pytest.mark.parametrize("how", ["shade", "shade_at"])
def test_gradients_match_differences(name, options, how, exact_roots):
    material = on_waves(name, options, 4, 5)
    light, view, uv = unit(*LIGHTS[1]), unit(0.4, -0.3, 0.8), torch.rand(2, 3, 3, dtype=torch.float64)

    def shade(material):
        return material.shade(light, view) if how == "shade" else material.shade_at(uv, light, view)

    # Along one random direction of all maps: what is wrong in any of them shows.
    by_graph, numeric = _slopes(material, shade, {key: torch.randn_like(material.maps[key]) for key in _floats(material)})
    assert numeric != 0
    assert abs(by_graph - numeric) < 1e-6 * max(1.0, abs(numeric))


def test_gradient_of_each_height_matches_differences(exact_roots):
    # The normals, the parallax and the ambient light's place all follow from the height.
    maps = {"albedo": make_maps("lambert", {}, 4, 5)["albedo"], "height": waves(4, 5), "ambient": ambient(4, 5)}
    light, view = unit(*LIGHTS[1]), unit(0.4, -0.3, 0.8)
    probe = torch.rand(3, 4, 5, dtype=torch.float64)
    material = Lambert(maps, normals="height")
    (material.shade(light, view) * probe).sum().backward()

    def total(height):
        with torch.no_grad():
            return float((material.with_maps(height=torch.from_numpy(height)).shade(light, view) * probe).sum())

    expected = torch.from_numpy(central(total, maps["height"].numpy()))
    assert float(expected.abs().min()) > 0
    assert_same(material.maps["height"].grad, expected, 1e-6)


@pytest.mark.parametrize("how", ["shade", "shade_at"])
def test_gradient_through_the_penumbra_matches_differences(how, exact_roots):
    # The steps of the shadow run from the lowest to the highest texel, so those two stay where they are.
    material = on_waves("texture", {})
    light, view, uv = unit(0.3, -0.9, 0.32), unit(0.2, -0.3, 0.8), torch.rand(2, 6, 6, dtype=torch.float64)
    free = torch.ones_like(material.maps["height"])
    height = material.maps["height"].detach()
    free[(height == height.min()) | (height == height.max())] = 0
    partly = soft_shadow(height, light)
    assert int(((partly > 0) & (partly < 1)).sum()) > 4

    def shade(material):
        return material.shade(light, view) if how == "shade" else material.shade_at(uv, light, view)

    for _ in range(4):
        by_graph, numeric = _slopes(material, shade, {"height": torch.randn_like(height) * free})
        assert abs(by_graph - numeric) < 1e-6 * max(1.0, abs(numeric))


@pytest.mark.parametrize("needs", [True, False])
@pytest.mark.parametrize("large", [True, False])
def test_gradient_of_the_directions_matches_differences(needs, large, exact_roots, monkeypatch):
    # Neither a frozen height nor the shifted maps of a large one may lose the way back to light and view.
    monkeypatch.setattr(rays, "SHIFT_TEXELS", 1 if large else 10**9)
    material = on_waves("phong_srf", {"residual": "half", "base": "phong"})
    material.requires_grad_(needs)
    pair = [unit(0.3, -0.9, 0.32), unit(0.2, -0.3, 0.8)]
    probe = torch.rand(3, HEIGHT, WIDTH, dtype=torch.float64)
    leaves = [d.clone().requires_grad_() for d in pair]
    (material.shade(*leaves) * probe).sum().backward()

    def total(which, direction):
        given = [torch.from_numpy(direction) if i == which else d for i, d in enumerate(pair)]
        with torch.no_grad():
            return float((material.shade(*given) * probe).sum())

    for which, leaf in enumerate(leaves):
        expected = torch.from_numpy(central(functools.partial(total, which), pair[which].numpy()))
        apart = leaf.grad - expected  # only the part along the sphere is defined
        along = apart - pair[which] * (apart * pair[which]).sum(dim=0)
        assert float(along.abs().max()) < 1e-5 * float(expected.abs().max())


@pytest.mark.parametrize("axis", ["x", "y"])
@pytest.mark.parametrize("tiles", [True, False])
def test_a_raised_plane_moves_away_from_the_viewer(axis, tiles):
    # The point q of a surface h above the plane shows at p = q - h v_xy / v_z, here two texels from q.
    albedo = make_maps("texture", {}, 4, 8)["albedo"]
    height = torch.full((1, 4, 8), 2 / 8, dtype=torch.float64)  # texels are an eighth of the width, in both directions
    material = Texture({"albedo": albedo}, tiles=tiles).on_relief(height)
    view = unit(1, 0, 1) if axis == "x" else unit(0, 1, 1)
    picture = material.shade(unit(0, 0, 1), view).detach()
    if axis == "x":
        expected = albedo.roll(-2, 2)
        expected[:, :, -2:] = expected[:, :, -2:] if tiles else albedo[:, :, -1:]
    else:
        expected = albedo.roll(2, 1)  # +y is up and rows run downward
        expected[:, :2] = expected[:, :2] if tiles else albedo[:, :1]
    assert_same(picture, expected, 1e-9)


@pytest.mark.parametrize("axis", ["x", "y"])
def test_a_deep_bump_moves_away_from_the_viewer_and_its_ground_does_not(axis):
    size, wide = 32, 6
    height, albedo = torch.zeros(1, size, size, dtype=torch.float64), torch.zeros(3, size, size, dtype=torch.float64)
    top = slice(13, 13 + wide)
    height[:, top, top] = 8 / size
    albedo[0] = 0.1
    albedo[:, 15:17, 15:17] = 1.0  # a white spot on the plateau
    view = unit(1, 0, 1) if axis == "x" else unit(0, 1, 1)
    picture = Texture({"albedo": albedo}).on_relief(height).shade(unit(0, 0, 1), view)[1].detach()
    weight = picture / picture.sum()
    index = torch.arange(size, dtype=torch.float64)
    row, column = float((weight.sum(1) * index).sum()), float((weight.sum(0) * index).sum())
    # Seen from +x it moves 8 texels toward -x, seen from +y (up) toward -y, which is down the rows.
    assert (row, column) == pytest.approx((15.5, 7.5) if axis == "x" else (23.5, 15.5), abs=1e-6)
    assert float(picture.max()) == pytest.approx(1, abs=1e-6)


def test_a_deep_bump_hides_what_lies_behind_it():
    size = 32
    height, albedo = torch.zeros(1, size, size, dtype=torch.float64), torch.full((3, size, size), 0.1, dtype=torch.float64)
    height[:, :, 14:18] = 8 / size
    albedo[:, :, 11] = 1.0  # on the ground, left of the wall
    material = Texture({"albedo": albedo}).on_relief(height).requires_grad_(False)
    light = unit(0, 0, 1)
    assert float(material.shade(light, unit(-1, 0, 1)).max()) > 0.9
    assert float(material.shade(light, unit(1, 0, 1)).max()) < 0.2


@every_model
def test_rolled_maps_give_rolled_pictures(name, options):
    material = on_waves(name, options)
    rolled = {
        spec.name: material.maps[spec.name].detach().roll((2, -3), (1, 2))
        for spec in material.specs() if spec.per_texel and not spec.constant
    }
    other = material.with_maps(**rolled)
    light, view = (torch.stack([unit(*d) for d in ds]) for ds in (LIGHTS, VIEWS))
    assert_same(other.shade(light, view), material.shade(light, view).roll((2, -3), (-2, -1)), 1e-9)


def test_a_surface_that_does_not_repeat_sees_no_neighbour():
    # A light spot at the right border is what the left border sees of a repeating surface, and only of that.
    albedo = torch.full((3, 8, 8), 0.1, dtype=torch.float64)
    albedo[:, :, -2:] = 1.0
    height = torch.full((1, 8, 8), 0.25, dtype=torch.float64)
    material = Texture({"albedo": albedo}).on_relief(height).requires_grad_(False)
    light, view = unit(0, 0, 1), unit(-1, 0, 1)
    assert float(material.shade(light, view)[:, :, 0].min()) > 0.9
    bounded = material.repeating(False).requires_grad_(False)
    assert bounded.tiles is False and material.tiles is True
    assert bounded.has_relief
    assert float(bounded.shade(light, view)[:, :, :3].max()) < 0.2
    assert torch.equal(bounded.repeating(True).shade(light, view), material.shade(light, view))


@every_model
def test_float32_agrees_with_float64(name, options):
    light, view = directions(20, torch.float32, lowest=0.3).double(), directions(20, torch.float32, 2, 0.3).double()
    wide = on_waves(name, options).shade(per_image(light), per_image(view))
    narrow = on_waves(name, options, dtype=torch.float32)
    narrow = narrow.shade(per_image(light.float()), per_image(view.float()))
    assert_same(narrow, wide.float(), TOLERANCE[torch.float32])  # measured 7e-6


@every_model
def test_one_thread_and_two_give_the_same_bits(name, options):
    material = on_waves(name, options, 104, 104, torch.float32, amplitude=0.03)  # enough texels for two threads, short ways
    light, view = (per_image(directions(1, torch.float32, seed, 0.4)) for seed in (1, 2))
    before, found = torch.get_num_threads(), []
    try:
        for threads in (1, 2):
            torch.set_num_threads(threads)
            with torch.no_grad():
                found.append(material.shade(light, view))
    finally:
        torch.set_num_threads(before)
    assert torch.equal(*found)


@every_model
@pytest.mark.parametrize("height, width", [(1, 1), (1, 7), (7, 1), (3, 5)])
@pytest.mark.parametrize("tiles", [True, False])
def test_odd_sizes(name, options, height, width, tiles):
    flat = make(name, options, height, width, torch.float32, tiles=tiles)
    material = flat.on_relief(torch.rand(1, height, width) * 0.2)
    light, view = (per_image(directions(2, torch.float32, seed)) for seed in (1, 2))
    value = material.shade(light, view)
    assert value.shape == (2, 3, height, width)
    assert bool(torch.isfinite(value).all()) and bool((value >= 0).all())


@pytest.mark.parametrize("tiles", [True, False])
def test_lambert_takes_its_normals_from_the_height(tiles, dtype):
    albedo = make_maps("lambert", {}, HEIGHT, WIDTH, dtype)["albedo"]
    slope = oracle.sobel(waves()[0].numpy(), tiles) * WIDTH / 8
    normal = np.stack((-slope[0], -slope[1], np.ones((HEIGHT, WIDTH))))
    normal = torch.from_numpy(normal / np.linalg.norm(normal, axis=0)).to(dtype)
    parts = {"height": waves(dtype=dtype), "ambient": ambient(dtype=dtype)}
    own = Lambert({"albedo": albedo, **parts}, normals="height", tiles=tiles)
    given = Lambert({"albedo": albedo, "normal": normal, **parts}, tiles=tiles)
    light, view = (torch.stack([unit(*d, dtype) for d in ds]) for ds in (LIGHTS, VIEWS))
    assert_same(own.shade(light, view), given.shade(light, view))
    uv = torch.rand(2, 4, 5, dtype=dtype) * 3 - 1
    assert_same(own.shade_at(uv, light, view), given.shade_at(uv, light, view))
    assert_same(own.surface().shade(light, view), given.surface().shade(light, view))
    assert float((normal[:2]).abs().max()) > 0.3


def test_lambert_without_a_height_to_take_normals_from():
    with pytest.raises(ShapeError, match=r"lambert: height must be there for normals='height'; it is not\. Give a height map"):
        Lambert({"albedo": torch.ones(3, 2, 2)}, normals="height")
    with pytest.raises(RangeError, match=r"normals must be one of 'map', 'height'.*Did you mean 'height'\?"):
        Lambert({"albedo": torch.ones(3, 2, 2)}, normals="heigth")


def test_gradients_reach_the_maps_of_the_surface():
    material = on_waves("lambert", {})
    material.surface().shade(unit(*LIGHTS[1]), unit(0, 0, 1)).sum().backward()
    assert float(material.maps["albedo"].grad.abs().min()) > 0
    assert material.maps["height"].grad is None


def test_at_of_a_relief_says_what_to_use():
    material = on_waves("ptm", {})
    uv = torch.rand(2, 2, 2, dtype=torch.float64)
    advice = r"shade_at\(uv, light, view\), or surface\(\)\.at\(uv\)"
    with pytest.raises(RangeError, match=rf"ptm\.at: the material must be flat.*{advice}"):
        material.at(uv)
    flat = make("ptm", {}, HEIGHT, WIDTH)
    light, view = unit(0.2, 0.1, 1), unit(0.3, 0, 1)
    assert_same(material.surface().at(uv).shade(light, view), flat.at(uv).shade(light, view), 1e-12)


@every_model
def test_parts_of_the_wrong_shape_are_named(name, options):
    flat = make(name, options, 3, 4)
    good = torch.zeros(1, 3, 4, dtype=torch.float64)
    for bad in (torch.zeros(3, 4), torch.zeros(3, 3, 4), torch.zeros(1, 3, 0)):
        with pytest.raises(ShapeError, match=rf"{name}: height must be \[1, H, W\]"):
            flat.on_relief(bad.double())
    for bad in (torch.zeros(1, 3, 4), torch.zeros(3)):
        with pytest.raises(ShapeError, match=rf"{name}: ambient must be \[3, H, W\]"):
            flat.on_relief(good, bad.double())
    with pytest.raises(ShapeError, match=f"{name}: height must have the size of the other maps"):
        flat.on_relief(good[:, :, :-1])
    with pytest.raises(ShapeError, match=f"{name}: ambient must have the size of the other maps"):
        flat.on_relief(good, torch.zeros(3, 2, 4, dtype=torch.float64))


def test_parts_that_leave_their_range_are_named():
    flat = make("texture", {}, 3, 4)
    height = waves(3, 4)
    with pytest.raises(RangeError, match="texture: height must be torch.float64 as the maps are"):
        flat.on_relief(height.float())
    with pytest.raises(RangeError, match="texture: ambient must lie in"):
        flat.on_relief(height, torch.full((3, 3, 4), -0.1, dtype=torch.float64))
    height[0, 1, 2] = math.nan
    with pytest.raises(RangeError, match=r"texture: height must be finite; 1 of 12 values .* first at index \(0, 1, 2\)"):
        flat.on_relief(height)


def test_shade_at_of_a_relief_checks_what_it_is_given():
    material = on_waves("texture", {})
    uv, up = torch.zeros(2, 2, 5, dtype=torch.float64), unit(0, 0, 1)
    with pytest.raises(ShapeError, match=r"texture.shade_at: uv must be \[2, H, W\]"):
        material.shade_at(torch.zeros(3, 4, 4, dtype=torch.float64), up, up)
    with pytest.raises(ShapeError, match=r"view must be \[\.\.\., 3, 1, 1\] or \[\.\.\., 3, 2, 5\]"):
        material.shade_at(uv, up, up.expand(3, HEIGHT, WIDTH))
    with pytest.raises(RangeError, match="light must be torch.float64"):
        material.shade_at(uv, up.float(), up)


@every_model
def test_settings_survive_the_relief_and_changes_of_them(name, options):
    material = on_waves(name, options, storage="png8", tiles=False)
    for other in (material, material.repeating(True), material.stored_as("half"), material.with_maps(height=waves())):
        assert other.options == make(name, options).options
        assert other.has_relief and set(other.maps) == {spec.name for spec in other.specs()}
    assert material.tiles is False and material.repeating(True).tiles is True
    assert material.storage == "png8" and material.repeating(True).storage == "png8"
    flat = material.surface()
    assert not flat.has_relief and flat.tiles is False
    taken = {"normal"} if name in ("distribution", "microfacet") else set()  # from the height
    assert {spec.name for spec in flat.specs()} == set(material.maps) - {"height", "ambient"} | taken
    assert not make(name, options).has_relief


@every_model
def test_bytes_count_height_and_ambient(name, options):
    for storage, ambient_bytes in (("half", 6), ("float", 12), ("png8", 3), ("png16", 6)):
        flat = make(name, options, HEIGHT, WIDTH, storage=storage)
        bare = flat.on_relief(waves())
        assert bare.bytes_per_texel == flat.bytes_per_texel + 2
        assert bare.on_relief(waves(), ambient()).bytes_per_texel == flat.bytes_per_texel + 2 + ambient_bytes
        assert bare.shared_bytes == flat.shared_bytes


STORED_LIGHT, STORED_VIEW = (per_image(directions(4, torch.float32, seed)) for seed in (1, 2))


@every_model
@pytest.mark.parametrize("storage", ["half", "png8", "tiff16"])
def test_the_folder_brings_back_what_export_promised(name, options, storage, tmp_path):
    material = on_waves(name, options, dtype=torch.float32, storage=storage, tiles=False)
    promised = material.as_exported()
    folder = save_material(material, tmp_path / "out")
    loaded = load_material(folder)
    assert loaded.has_relief and loaded.tiles is False and set(loaded.maps) == set(material.maps)
    for key, value in promised.maps.items():
        assert torch.equal(loaded.maps[key], value), key
    with torch.no_grad():
        found, exported = loaded.shade(STORED_LIGHT, STORED_VIEW), promised.shade(STORED_LIGHT, STORED_VIEW)
    assert torch.equal(found, exported)
    # Whatever the storage of the others, the height has 16 bits: half a step of its range is lost at most.
    pixels = read_image(folder / "height.png")
    assert pixels.dtype == np.uint16 and pixels.shape == (HEIGHT, WIDTH, 1)
    height = material.maps["height"].detach()
    lost = (loaded.maps["height"] - height).detach().abs().max()
    assert 0 < float(lost) <= 0.51 * float(height.max() - height.min()) / 65535
    entry = {e["map"]: e for e in json.loads((folder / "manifest.json").read_text("utf-8"))["textures"]}["height"]
    assert entry["low"] == [float(height.min())] and entry["high"] == [float(height.max())]


def test_lambert_with_the_heights_normals_writes_no_normal_map(tmp_path):
    maps = {"albedo": make_maps("lambert", {}, 5, 6, torch.float32)["albedo"], "height": waves(5, 6, dtype=torch.float32)}
    material = Lambert(maps, normals="height", storage="png8")
    folder = save_material(material, tmp_path / "out")
    assert {path.name for path in folder.iterdir()} == {"manifest.json", "albedo.png", "height.png"}
    loaded = load_material(folder)
    assert loaded.options == {"normals": "height"}
    assert torch.equal(loaded.shade(STORED_LIGHT, STORED_VIEW), material.as_exported().shade(STORED_LIGHT, STORED_VIEW))
    assert material.bytes_per_texel == 5


@pytest.mark.parametrize("level", [0.0, 0.07, -0.3])
def test_a_height_of_one_value_exports_and_loads(level, tmp_path):
    material = make("texture", {}, 4, 5, torch.float32).on_relief(torch.full((1, 4, 5), level))
    loaded = load_material(save_material(material, tmp_path / "out"))
    assert torch.equal(loaded.maps["height"], material.maps["height"])
    assert bool(torch.isfinite(loaded.shade(STORED_LIGHT, STORED_VIEW)).all())


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_a_painted_height_arrives(kind, tmp_path):
    folder = save_material(on_waves("texture", {}, dtype=torch.float32), tmp_path / "out")
    entry = {e["map"]: e for e in json.loads((folder / "manifest.json").read_text("utf-8"))["textures"]}["height"]
    low, high, most = entry["low"][0], entry["high"][0], np.iinfo(kind).max
    codes = np.random.default_rng(2).integers(0, most + 1, (HEIGHT, WIDTH, 1)).astype(kind)
    write_image(folder / "height.png", codes)
    loaded = load_material(folder)
    expected = torch.from_numpy(low + codes.astype(np.float64) / most * (high - low)).permute(2, 0, 1)
    assert_same(loaded.maps["height"], expected.float(), 1e-6)
    direct = loaded.with_maps(height=expected.float())
    assert_same(loaded.shade(STORED_LIGHT, STORED_VIEW), direct.shade(STORED_LIGHT, STORED_VIEW), 1e-4)


def test_a_painted_height_that_cannot_be_read_names_the_file(tmp_path):
    folder = save_material(on_waves("texture", {}, dtype=torch.float32), tmp_path / "out")
    write_image(folder / "height.png", np.zeros((HEIGHT, WIDTH, 3), np.uint8))
    with pytest.warns(Notice, match=r"height\.png: its channels are equal, and one was taken"):
        load_material(folder)
    write_image(folder / "height.png", np.zeros((HEIGHT, WIDTH, 2), np.uint8))
    with pytest.raises(DataError, match=r"height\.png: alpha must be opaque; 48 of 48 texels are not"):
        load_material(folder)
    (folder / "height.png").unlink()
    with pytest.raises(DataError, match=r"height\.png: the texture must exist"):
        load_material(folder)


def test_every_model_is_covered():
    assert {case.values[0] for case in CASES} == set(MATERIALS)


def test_shade_walks_the_rays_that_trace_view_finds():
    # The picture of a ramp of albedo tells where each texel looked, independently of the shading.
    rows, columns = 12, 16
    u = texel_centres(rows, columns, torch.float64)[0]
    albedo = (0.5 + 0.3 * torch.sin(2 * math.pi * u))[None].expand(3, rows, columns)
    material = Texture({"albedo": albedo}).on_relief(waves(rows, columns, 0.1))
    view = unit(0.5, 0.2, 0.8)
    seen = trace_view(waves(rows, columns, 0.1), view).uv[0]
    picture = material.shade(unit(0, 0, 1), view)[0].detach()
    # Cubic convolution with a = -0.75 is of first order: measured 5.4e-3 for a sine of 16 texels a period.
    assert float((picture - (0.5 + 0.3 * torch.sin(2 * math.pi * seen))).abs().max()) < 8e-3
    assert float((picture - albedo[0]).abs().max()) > 0.05
