"""One picture to a material: what each control makes, what is absent, and what comes back from the textures."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from tests.support import assert_close

from torchmat import colour, load_material, render, save_material
from torchmat.btf.photographs import read_linear
from torchmat.create import material_from_picture
from torchmat.create.controls import draw_360
from torchmat.create.specular_maps import SPECULAR_MAPS, tilt_curve
from torchmat.errors import RangeError, ShapeError
from torchmat.geometry import slopes_from_height
from torchmat.images import write_image

FULL = {
    "lobes": 2, "specular": ("glossy", "anisotropic:ratio=6"), "rotation_centres": [(0.5, 0.5)], "tilt": "velvet",
    "softness": 10.0, "tiles": True,
}
LIGHT = torch.tensor([-0.4, 0.5, 0.768])[:, None, None]
VIEW = torch.tensor([0.5, -0.3, 0.812])[:, None, None]


def picture(height: int = 6, width: int = 5) -> torch.Tensor:
    return 0.05 + 0.9 * torch.rand(3, height, width)


def maps(material) -> dict[str, torch.Tensor]:
    return {name: value.detach() for name, value in material.maps.items()}


def shaded(material) -> torch.Tensor:
    return material.shade(LIGHT, VIEW).detach()


def test_neutral_controls_give_the_picture_and_its_luminance():
    wanted = picture()
    found = maps(material_from_picture(
        wanted, darken=0.0, fresnel_brightness=0.0, fresnel_contrast=1.0, height_scale=0.1, tiles=True
    ))
    grey = 0.2126 * wanted[:1] + 0.7152 * wanted[1:2] + 0.0722 * wanted[2:]
    assert torch.equal(found["diffuse"], wanted)
    assert_close(found["specular_mask"], grey, 1e-6)
    assert_close(found["fresnel"], grey, 1e-6)
    assert torch.equal(found["specular"], SPECULAR_MAPS["glossy"]())
    seen = 0.1 * colour.luminance(colour.display(wanted))[None]
    assert_close(found["height"], seen - seen.mean(), 1e-5)
    assert set(found) == {"diffuse", "specular_mask", "fresnel", "specular", "height"}


def test_the_value_by_hand_on_an_even_picture():
    material = material_from_picture(
        torch.full((3, 3, 3), 0.5), height_scale=0.0, darken=0.2, mask_contrast=0.0, fresnel_contrast=0.0,
        fresnel_brightness=-0.4, specular=(torch.full((3, 4, 4), 0.3),),
    )
    pole = torch.tensor([0.0, 0.0, 1.0])[:, None, None]
    # Head on: C_d + pi * mask * C_s * r0 / D, D = 1 (1e-4 stands in it against 0 / 0).
    assert_close(material.shade(pole, pole).detach(), torch.full((3, 3, 3), 0.4 + math.pi * 0.5 * 0.3 * 0.1), 2e-5)


def test_what_is_not_asked_for_is_absent():
    flat = material_from_picture(
        picture(), lobes=0, specular=(), height_scale=0.0, mask_brightness=None, fresnel_brightness=None
    )
    assert set(flat.maps) == {"diffuse"} and not flat.has_relief
    unmasked = material_from_picture(picture(), height_scale=0.0, mask_brightness=None, fresnel_brightness=None)
    assert set(unmasked.maps) == {"diffuse", "specular"}


def test_all_that_is_asked_for_is_there():
    material = material_from_picture(picture(), **FULL)
    found = maps(material)
    assert set(found) == {"diffuse", "specular_mask", "fresnel", "specular", "index", "rotation", "tilt", "height"}
    assert found["index"].shape == (2, 6, 5) and found["specular"].shape == (6, 48, 48)
    assert_close(found["index"].sum(dim=0), torch.ones(6, 5), 1e-6)
    assert torch.equal(found["rotation"], draw_360((6, 5), [(0.5, 0.5)]))
    assert torch.equal(found["tilt"], tilt_curve("velvet"))
    assert material.tiles and material.storage == "paint8"
    own = torch.full((1, 1, 91), 0.25)
    assert torch.equal(maps(material_from_picture(picture(), tilt=own))["tilt"], own)


def test_bright_colours_stand_high_and_the_light_side_of_a_bump_is_brighter():
    bump = torch.full((3, 9, 9), 0.1)
    bump[:, 3:6, 3:6] = 0.1001
    bump[:, 4, 4] = 0.9
    material = material_from_picture(bump, height_scale=0.02, lobes=0, specular=())
    height = maps(material)["height"]
    assert height.argmax() == 4 * 9 + 4
    left_facing = shaded(material.surface())[0, 4, 3]
    right_facing = shaded(material.surface())[0, 4, 5]
    assert float(left_facing) > float(right_facing)  # the light comes from the left
    assert float(slopes_from_height(height, tiles=False)[0, 4, 3]) > 0


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (5, 1), (3, 8)])
@pytest.mark.parametrize("settings", [{}, {**FULL, "lobes": 1, "specular": ("rim",)}], ids=["plain", "full"])
def test_pictures_of_any_shape(size, settings):
    material = material_from_picture(picture(*size), **settings)
    assert material.size == size
    assert bool(torch.isfinite(shaded(material)).all()) and float(shaded(material).min()) >= 0


@pytest.mark.parametrize("channels", [1, 2, 3, 4])
@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_grey_and_alpha_files(tmp_path, channels, kind):
    codes = np.random.default_rng(0).integers(0, np.iinfo(kind).max, (4, 5, channels)).astype(kind)
    write_image(tmp_path / "a picture ü.png", codes)
    found = maps(material_from_picture(read_linear(tmp_path / "a picture ü.png"), darken=0.0))["diffuse"]
    colours = torch.from_numpy((codes[..., : 1 if channels < 3 else 3] / np.iinfo(kind).max).transpose(2, 0, 1))
    assert_close(found.double(), colour.srgb_to_linear(colours.expand(3, -1, -1)), 1e-6)


def test_the_same_seed_gives_the_same_bits():
    wanted = picture(20, 20)
    settings = {"lobes": 3, "specular": ("glossy", "soft", "noise"), "seed": 4}
    first, again = (maps(material_from_picture(wanted, **settings)) for _ in range(2))
    assert all(torch.equal(first[name], again[name]) for name in first)


@pytest.mark.parametrize("storage", ["png8", "float"])
def test_the_round_trip_and_the_sphere(tmp_path, storage):
    material = material_from_picture(picture(16, 12), storage=storage, **FULL)
    loaded = load_material(save_material(material, tmp_path / "made"))
    exported = material.as_exported()
    for name, value in maps(exported).items():
        assert torch.equal(loaded.maps[name], value), name
    assert_close(shaded(loaded), shaded(material), 0.05 if storage == "png8" else 2e-5)
    for shape in ("sphere", "patch"):
        seen = render(loaded, shape, size=24, repeat=2.0)
        assert bool(torch.isfinite(seen).all()) and float(seen.max()) > 0


@pytest.mark.parametrize(("settings", "error", "said"), [
    ({"specular": ("glossy", "rim")}, ShapeError, "there are 2 for 1 lobes"),
    ({"lobes": 2}, ShapeError, "there are 1 for 2 lobes"),
    ({"specular": ("anisotropc",)}, RangeError, "Did you mean 'anisotropic'"),
    ({"specular": (torch.ones(1, 4, 4),)}, ShapeError, r"be \[3, S, S\]"),
    ({"specular": (torch.ones(3, 4, 5),)}, ShapeError, "be square"),
    ({"lobes": 2, "specular": ("glossy", torch.ones(3, 4, 4))}, ShapeError, "map 1"),
    ({"tilt": "velvt"}, RangeError, "Did you mean 'velvet'"),
    ({"tilt": torch.zeros(1, 1, 90)}, ShapeError, "tilt"),
    ({"darken": 1.5}, RangeError, "darken"),
    ({"height_scale": -0.1}, RangeError, "height_scale"),
    ({"mask_contrast": math.nan}, RangeError, "contrast"),
    ({"rotation_centres": [(0.5,)]}, RangeError, "centres"),
    ({"storage": "png9"}, RangeError, "Did you mean 'png"),
    ({"lobes": 13, "specular": ("glossy",) * 13}, RangeError, "lobes"),
])
def test_wrong_controls_are_named(settings, error, said):
    with pytest.raises(error, match=said):
        material_from_picture(picture(), **settings)


def test_wrong_pictures_are_named():
    bad = picture()
    bad[0, 1, 2] = math.inf
    with pytest.raises(RangeError, match=r"1 of 90 values are NaN or Inf, first at index \(0, 1, 2\)"):
        material_from_picture(bad)
    with pytest.raises(ShapeError, match="picture"):
        material_from_picture(torch.rand(4, 5, 5))
    with pytest.raises(RangeError, match="not be negative"):
        material_from_picture(picture() - 0.5)
