"""A relief that is followed between its texels: against loops over rays, by hand, and nearer to the truth than the fast way."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch
from tests.models.test_relief_maps import arrays, bicubic, centre_of, clearance_at, hit_of, on_waves, row_of, shadow_at, unit, waves
from tests.reference import materials as flat_oracle
from tests.reference import relief as oracle
from tests.support import assert_close

from torchmat import load_material, save_material
from torchmat.errors import RangeError
from torchmat.material_io import pack, unpack
from torchmat.models import Distribution, Lambert, Texture
from torchmat.models.edit import resized
from torchmat.models.fine_relief import FACTOR, refined

LIGHT, VIEW = (0.3, -0.9, 0.25), (-0.5, 0.6, 0.6)
ROWS, COLUMNS = 5, 6
ROOT = 3e-4  # rays that just clear an edge end less close to the root, as in the fast way


def textured(height: torch.Tensor, tiles: bool = True, seed: int = 3, relief: str = "fine") -> Texture:
    random = np.random.default_rng(seed)
    value = torch.from_numpy(random.uniform(0.2, 0.8, (3, *height.shape[-2:]))).to(height.dtype)
    return Texture({"albedo": value}, tiles=tiles).on_relief(height, 0.1 * value.flip(0)).with_relief(relief)


@pytest.mark.parametrize("tiles", [True, False])
@pytest.mark.parametrize("size", [(5, 6), (1, 7), (4, 1)])
def test_the_height_between_texels_is_that_of_a_cubic(size, tiles):
    height = torch.from_numpy(np.random.default_rng(1).uniform(-1, 1, (1, *size)))
    assert_close(refined(height, tiles)[0], torch.from_numpy(oracle.refined(height[0].numpy(), FACTOR, tiles)))


def test_a_plane_stays_one_and_a_constant_too():
    ramp = torch.arange(8, dtype=torch.float64).expand(1, 8, 8) / 8
    fine = refined(ramp, False)[0, 6, 6:-6]
    assert torch.allclose(fine.diff(), torch.full((3,), 1 / 16, dtype=torch.float64), atol=1e-12)
    assert torch.allclose(refined(torch.full((1, 3, 3), 0.7), True), torch.tensor(0.7), atol=1e-6)


def expected_picture(material, light: np.ndarray, view: np.ndarray) -> np.ndarray:
    """Follow FACTOR squared rays a texel: colours where they have moved to, light where they end."""
    tiles, maps = material.tiles, arrays(material)
    fine = oracle.refined(maps["height"][0], FACTOR, tiles)
    free = np.zeros(fine.shape)
    for row, column in np.ndindex(fine.shape):
        free[row, column] = clearance_at(fine, light, *centre_of(row, column, fine.shape), tiles)
    # The edge of a shadow is at least half a finer texel wide.
    wide = np.pad(free, 1, mode="wrap" if tiles else "edge")
    change = (np.abs(wide[1:-1, 2:] - wide[1:-1, :-2]) + np.abs(wide[2:, 1:-1] - wide[:-2, 1:-1])) / 2
    lit = np.clip(free / np.maximum(change / 2, 0.05) + 0.5, 0, 1)
    shaded = flat_oracle.shade(material.name, maps, {}, light[:, None, None], view[:, None, None], *material.size)
    picture = np.zeros_like(shaded)
    for row, column in np.ndindex(fine.shape):
        start = np.array(centre_of(row, column, fine.shape))
        centre = np.array(centre_of(row // FACTOR, column // FACTOR, material.size))
        end = np.array(hit_of(fine, view, *start, tiles))
        moved = end - start + centre
        seen = bicubic(shaded, *moved, tiles) * oracle.bilinear(lit, *end, tiles) + bicubic(maps["ambient"], *moved, tiles)
        picture[:, row // FACTOR, column // FACTOR] += seen / FACTOR**2
    return np.maximum(picture, 0)


@pytest.mark.parametrize("tiles", [True, False])
@pytest.mark.parametrize("name", ["texture", "lambert"])
def test_a_fine_picture_matches_the_oracle(name, tiles):
    material = on_waves(name, {}, ROWS, COLUMNS, tiles=tiles).with_relief("fine")
    expected = expected_picture(material, row_of(unit(*LIGHT)), row_of(unit(*VIEW)))
    found = material.shade(unit(*LIGHT), unit(*VIEW)).detach()
    assert_close(found, torch.from_numpy(expected), ROOT)
    fast = material.with_relief("fast").shade(unit(*LIGHT), unit(*VIEW)).detach()
    assert float((fast - found).abs().max()) > 0.02 * float(expected.max()), "the fast way would pass as well"


@pytest.mark.parametrize("tiles", [True, False])
def test_fine_points_match_the_oracle(tiles):
    material = on_waves("texture", {}, ROWS, COLUMNS, tiles=tiles).with_relief("fine")
    uv = torch.from_numpy(np.random.default_rng(4).uniform(-0.4, 1.4, (2, 2, 3)))
    light, view = unit(*LIGHT), unit(*VIEW)
    maps, found = arrays(material), material.shade_at(uv, light, view).detach()
    fine = oracle.refined(maps["height"][0], FACTOR, tiles)
    for row, column in np.ndindex(2, 3):
        hit = hit_of(fine, row_of(view), *uv[:, row, column].tolist(), tiles)
        share = shadow_at(fine, row_of(light), *hit, tiles)
        colour, more = (np.array([oracle.bilinear(plane, *hit, tiles) for plane in maps[n]]) for n in ("albedo", "ambient"))
        assert_close(found[:, row, column], torch.from_numpy(colour * share * float(light[2]) + more), ROOT)


def test_fine_is_nearer_to_the_surface_between_the_texels():
    big = waves(96, 96, 0.16)
    small = big.reshape(1, 12, 8, 12, 8)[:, :, 4, :, 4]  # what 12 x 12 texels know of it
    value = torch.full((3, 12, 12), 0.5, dtype=torch.float64)
    light, view = unit(*LIGHT), unit(*VIEW)
    flat = torch.full((3, 96, 96), 0.5, dtype=torch.float64)
    truth = Texture({"albedo": flat}).on_relief(big).shade(light, view).unflatten(1, (12, 8)).unflatten(3, (12, 8)).mean(dim=(2, 4))
    gaps = [
        float((Texture({"albedo": value}).on_relief(small).with_relief(way).shade(light, view) - truth).square().mean().detach())
        for way in ("fast", "fine")
    ]
    assert gaps[1] < 0.6 * gaps[0]


def test_the_gradient_in_the_height_is_that_of_finite_differences():
    # Gentle, from well above: no ray comes near a silhouette, and the light is partly hidden only where it is soft.
    height = waves(ROWS, COLUMNS, 0.03)
    material = textured(height)
    light, view = unit(0.4, 0.3, 0.8), unit(-0.3, 0.5, 0.8)
    random = np.random.default_rng(7)
    weight = torch.from_numpy(random.normal(size=(3, ROWS, COLUMNS)))
    way = torch.from_numpy(random.normal(size=(1, ROWS, COLUMNS)))

    def value(step: float) -> float:
        moved = material.with_maps(height=height + step * way)
        return float((moved.shade(light, view) * weight).sum().detach())

    (material.shade(light, view) * weight).sum().backward()
    gradient = float((material.maps["height"].grad * way).sum())
    numeric = (value(1e-4) - value(-1e-4)) / 2e-4
    # Roots are found to about 1e-6 of a texture width, which differences divide by their step.
    assert abs(numeric) > 0.1 and abs(gradient - numeric) < 0.02 * abs(numeric)


def test_the_gradient_moves_a_shadow():
    # A wall under light at 45 degrees: its shadow grows by as much as the wall, of which the cubic leaves 0.867. Of heights
    # whose shadows end at all places of a finer texel, the mean gradient is that of the shadow's length.
    gradients = []
    for height in torch.linspace(0.15, 0.15 + 1 / 16, 17, dtype=torch.float64)[:-1]:
        wall = torch.zeros(1, 2, 16, dtype=torch.float64)
        wall[..., 12] = height
        material = Texture({"albedo": torch.ones(3, 2, 16, dtype=torch.float64)}).on_relief(wall).with_relief("fine")
        material.shade(unit(1.0, 0.0, 1.0), unit(0, 0, 1))[..., 2:11].sum().backward()
        gradients.append(float(material.maps["height"].grad[..., 12].mean()))
    # In each row 16 texels a texture width, 3 channels of cos(45 degrees).
    assert np.mean(gradients) == pytest.approx(-16 * 3 * 0.5**0.5 * 0.867, rel=0.15)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("tiles", [True, False])
@pytest.mark.parametrize("case", ["spikes", "deep", "constant", "row", "column", "one"])
def test_hard_heights_give_finite_pictures_in_range(case, tiles, dtype):
    random = np.random.default_rng(5)
    height = {
        "spikes": np.where(random.uniform(size=(6, 7)) > 0.8, 0.5, 0.0), "deep": random.uniform(-2, 2, (5, 6)),
        "constant": np.full((4, 4), 0.3), "row": random.uniform(0, 0.2, (1, 8)), "column": random.uniform(0, 0.2, (8, 1)),
        "one": np.array([[0.1]]),
    }[case][None]
    material = textured(torch.from_numpy(height).to(dtype), tiles)
    light = torch.stack([unit(*d, dtype=dtype) for d in (LIGHT, (0.0, 0.0, 1.0), (0.9, 0.1, 0.02))])
    view = torch.stack([unit(*d, dtype=dtype) for d in (VIEW, (0.1, 0.9, 0.05), (-0.7, 0.1, 0.1))])
    picture = material.shade(light, view)
    shown = picture.detach()
    assert bool(torch.isfinite(picture).all()) and float(shown.min()) >= 0
    # Bicubic look-ups of colours of at most 0.8 + 0.08 overshoot by less than a half.
    assert float(shown.max()) < 1.4
    picture.sum().backward()
    assert all(bool(torch.isfinite(leaf.grad).all()) for leaf in material.maps.values())


def test_a_constant_height_is_seen_as_in_the_fast_way():
    material = textured(torch.full((1, 4, 5), 0.2, dtype=torch.float64))
    light, view = unit(0.4, 0.3, 0.8), unit(-0.3, 0.5, 0.8)
    assert_close(material.shade(light, view), material.with_relief("fast").shade(light, view).detach(), 1e-10)


def test_holes_are_black_in_the_fine_way_too():
    material = textured(waves(ROWS, COLUMNS)).with_maps()
    whole = torch.zeros(1, ROWS, COLUMNS, dtype=torch.float64)
    holed = Texture({**material.maps, "opacity": whole}, relief="fine")
    assert not bool(holed.shade(unit(*LIGHT), unit(*VIEW)).any())


def test_the_way_is_kept_by_folders_packs_and_edits(tmp_path):
    material = textured(waves(ROWS, COLUMNS).float())
    folder = save_material(material, tmp_path / "m")
    loaded = load_material(folder)
    assert loaded.relief == "fine" and loaded.as_exported().relief == "fine"
    assert torch.equal(loaded.shade(unit(*LIGHT, torch.float32), unit(*VIEW, torch.float32)),
                       material.as_exported().shade(unit(*LIGHT, torch.float32), unit(*VIEW, torch.float32)))
    assert json.loads((folder / "manifest.json").read_text())["relief"] == "fine"
    assert resized(material, (7, 8)).relief == material.with_maps().relief == material.repeating(False).relief == "fine"
    lobed = Distribution({"diffuse": torch.full((3, 4, 4), 0.5), "height": waves(4, 4).float()}, lobes=0, parts=(), relief="fine")
    assert unpack(pack(lobed, tmp_path / "p")).relief == "fine"


def test_a_folder_that_does_not_say_is_fast(tmp_path):
    material = textured(waves(ROWS, COLUMNS).float(), relief="fast")
    folder = save_material(material, tmp_path / "m")
    assert "relief" not in json.loads((folder / "manifest.json").read_text())
    assert load_material(folder).relief == "fast"


def test_an_unknown_way_is_refused():
    with pytest.raises(RangeError, match="relief must be one of"):
        Lambert({"albedo": torch.ones(3, 2, 2), "normal": torch.ones(3, 2, 2)}, relief="finest")
