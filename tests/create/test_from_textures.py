"""A texture set to a material: what each file becomes, lobes against the microfacet model, and what is refused."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from tests.support import assert_close, shared_path

from torchmat import colour, load_material, render, save_material
from torchmat.create import material_from_textures
from torchmat.create.from_textures import ggx_lobe, quantised
from torchmat.create.textures import find_textures
from torchmat.errors import DataError, RangeError, ShapeError
from torchmat.geometry import normals_from_slopes, slopes_from_height
from torchmat.images import write_image

LIGHT = torch.tensor([-0.4, 0.5, 0.768])[:, None, None]
VIEW = torch.tensor([0.5, -0.3, 0.812])[:, None, None]


def bump(height: int = 16, width: int = 24) -> torch.Tensor:
    """Return a tiling height [1, H, W] in [0, 1]."""
    across, down = (torch.arange(n, dtype=torch.float64) / n * 2 * math.pi for n in (width, height))
    return ((torch.sin(across)[None, :] * torch.cos(down)[:, None] + 1) / 2)[None].float()


def write(path, planes: torch.Tensor, kind=np.uint16) -> None:
    """Write planes [1 or 3, H, W] in [0, 1] as codes, or as they are."""
    pixels = planes.permute(1, 2, 0).numpy()
    full = 1 if np.issubdtype(kind, np.floating) else np.iinfo(kind).max
    write_image(path, (pixels if full == 1 else np.round(pixels * full)).astype(kind))


def textures(scale: float = 0.03) -> dict[str, torch.Tensor]:
    """Return a made-up set whose normals are those of its displacement times `scale`."""
    height = bump()
    normal = normals_from_slopes(slopes_from_height(height, scale))
    return {
        "Color": 0.1 + 0.8 * torch.rand(3, 16, 24), "Displacement": height, "NormalGL": normal / 2 + 0.5,
        "Roughness": 0.2 + 0.6 * torch.rand(1, 16, 24), "AmbientOcclusion": torch.rand(1, 16, 24),
    }


def folder_of(path, planes: dict[str, torch.Tensor], kind=np.uint16, suffix: str = "png"):
    path.mkdir()
    for name, texture in planes.items():
        write(path / f"Made 001_1K_{name}.{suffix}", texture, kind)
    return path


def maps(material) -> dict[str, torch.Tensor]:
    return {name: value.detach() for name, value in material.maps.items()}


def made(path, planes, **settings) -> dict[str, torch.Tensor]:
    return maps(material_from_textures(folder_of(path, planes), **settings))


def test_each_file_becomes_its_map(tmp_path):
    planes = textures()
    found = made(tmp_path / "set", planes, height_scale=0.03)
    assert set(found) == {"diffuse", "normal", "fresnel", "index", "specular", "height"}
    assert_close(found["diffuse"], colour.srgb_to_linear(planes["Color"]), 1e-4)
    assert_close(found["height"], 0.03 * (planes["Displacement"] - planes["Displacement"].mean()), 1e-4)
    assert torch.equal(found["fresnel"], torch.full((1, 16, 24), 0.04))
    # The height has all the slopes of the normals, so that nothing is left of them but the codes' rounding.
    assert_close(found["normal"], torch.tensor([0.0, 0.0, 1.0])[:, None, None].expand(3, 16, 24), 1e-4)


def test_normals_are_the_normal_maps_whatever_the_height(tmp_path):
    planes = textures(0.03)
    folder = folder_of(tmp_path / "set", planes)
    wanted = planes["NormalGL"] * 2 - 1
    for scale in (0.0, 0.01, 0.08):
        surface = material_from_textures(folder, height_scale=scale).surface()
        assert_close(surface.maps["normal"].detach(), wanted, 2e-4)  # 16-bit codes


def test_the_height_scale_is_found_from_the_normals(tmp_path):
    found = made(tmp_path / "set", textures(0.03))["height"]
    assert float(found.max() - found.min()) == pytest.approx(0.03, rel=1e-3)
    planes = textures(0.03)
    del planes["NormalGL"]
    found = made(tmp_path / "without normals", planes)["height"]
    assert float(found.max() - found.min()) == pytest.approx(0.05, rel=1e-3)
    # Steps of 8 bits are noise that must not lower it: two in a hundred are measured at 24 texels.
    found = maps(material_from_textures(folder_of(tmp_path / "8 bits", textures(0.03), np.uint8)))["height"]
    assert float(found.max() - found.min()) == pytest.approx(0.03, rel=0.05)


def test_a_displacement_turned_over_is_refused_and_an_even_one_is_not(tmp_path):
    planes = textures()
    planes["Displacement"] = 1 - planes["Displacement"]
    folder = folder_of(tmp_path / "set", planes)
    with pytest.raises(DataError, match="opposite"):
        material_from_textures(folder)
    assert material_from_textures(folder, height_scale=0.03).has_relief
    planes["Displacement"] = torch.full((1, 16, 24), 0.5)
    assert float(made(tmp_path / "even", planes)["height"].abs().max()) < 1e-7


def test_directx_normals_are_turned_over(tmp_path):
    planes = textures()
    gl = made(tmp_path / "gl", planes, height_scale=0.0)["normal"]
    planes["NormalDX"] = torch.stack((planes["NormalGL"][0], 1 - planes["NormalGL"][1], planes["NormalGL"][2]))
    both = find_textures(folder_of(tmp_path / "both", planes))
    assert both.left_out == {"Made 001_1K_NormalDX.png": "normaldx: normalgl says it"}
    del planes["NormalGL"]
    assert_close(made(tmp_path / "dx", planes, height_scale=0.0)["normal"], gl, 1e-4)


def test_occlusion_darkens_only_when_asked(tmp_path):
    planes = textures()
    folder = folder_of(tmp_path / "set", planes)
    plain, shaded = (maps(material_from_textures(folder, occlusion=wish))["diffuse"] for wish in (False, True))
    assert_close(shaded, plain * planes["AmbientOcclusion"], 1e-4)
    (folder / "Made 001_1K_AmbientOcclusion.png").unlink()
    with pytest.raises(DataError, match="_AmbientOcclusion"):
        material_from_textures(folder, occlusion=True)


def test_metal_has_its_colour_in_the_highlight(tmp_path):
    planes = {"Color": torch.tensor([1.0, 0.8, 0.0])[:, None, None].expand(3, 2, 2).contiguous()}
    planes["Metalness"] = torch.tensor([[[1.0, 0.0], [1.0, 0.0]]])
    found = made(tmp_path / "set", planes)
    linear = colour.srgb_to_linear(planes["Color"])
    assert torch.equal(found["diffuse"][:, :, 0], torch.zeros(3, 2))
    assert_close(found["diffuse"][:, :, 1], linear[:, :, 1], 1e-4)
    assert_close((found["fresnel"] * found["specular_mask"])[:, :, 0], linear[:, :, 0], 1e-4)
    assert_close((found["fresnel"] * found["specular_mask"])[:, :, 1], torch.full((3, 2), 0.04), 1e-5)
    assert torch.equal(found["specular"], ggx_lobe(0.5))


def test_colour_alone_is_diffuse_alone(tmp_path):
    assert set(made(tmp_path / "set", {"Color": torch.rand(3, 3, 4)})) == {"diffuse"}


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (7, 1)])
def test_sets_of_any_shape(tmp_path, size):
    planes = {"Color": torch.rand(3, *size), "Displacement": torch.rand(1, *size), "Roughness": torch.rand(1, *size)}
    planes["NormalGL"] = torch.tensor([0.5, 0.5, 1.0])[:, None, None].expand(3, *size)
    shaded = material_from_textures(folder_of(tmp_path / "set", planes), height_scale=0.02).shade(LIGHT, VIEW)
    assert bool(torch.isfinite(shaded).all()) and shaded.shape == (3, *size)


def test_quantised_roughness_by_hand():
    levels, index = quantised(torch.tensor([[[0.2, 0.3, 0.4, 0.5, 0.6]]]), 3)
    assert_close(levels, torch.tensor([0.2, 0.4, 0.6]))
    wanted = torch.tensor([[[1, 0.5, 0, 0, 0]], [[0, 0.5, 1, 0.5, 0]], [[0, 0, 0, 0.5, 1.0]]])
    assert_close(index, wanted, 1e-6)


def test_weights_sum_to_1_and_mean_the_roughness():
    rough = torch.rand(1, 20, 30)
    for count in (2, 3, 7):
        levels, index = quantised(rough, count)
        assert_close(index.sum(dim=0), torch.ones(20, 30), 1e-6)
        assert_close((levels[:, None, None] * index).sum(dim=0), rough[0], 1e-6)
        assert int((index > 0).sum(dim=0).max()) <= 2
    assert quantised(rough, 1)[0].tolist() == [pytest.approx(float(rough.mean()))]
    levels, index = quantised(torch.full((1, 2, 2), 0.3), 3)
    assert levels.tolist() == [pytest.approx(0.3)] and torch.equal(index, torch.ones(1, 2, 2))


def test_a_lobe_is_a_quarter_of_ggx():
    lobe = ggx_lobe(0.6, 256)
    middle = lobe[0, 127:129, 127:129].mean()
    # Texels hold the mean over them, which takes 0.2 % off the peak.
    assert float(middle) == pytest.approx(1 / (4 * math.pi * 0.36**2), rel=4e-3)
    # Its distribution of normals, weighted with their cosine, adds up to 1 over the hemisphere.
    axis = (torch.arange(256, dtype=torch.float64) + 0.5) / 128 - 1
    squared = axis[None, :] ** 2 + axis[:, None] ** 2
    area = 4 / (1 + squared) ** 2 * (1 / 128) ** 2  # of a texel, on the sphere of directions
    cosine = (1 - squared) / (1 + squared)
    total = (4 * lobe[0].double() * cosine * area)[squared < 1].sum()
    assert float(total) == pytest.approx(1, abs=2e-3)


@pytest.mark.parametrize("roughness", [0.0, 1e-3, 1.0])
@pytest.mark.parametrize("size", [1, 3, 64])
def test_both_ends_of_the_roughness_are_finite_and_fit_a_half(roughness, size):
    lobe = ggx_lobe(roughness, size)
    assert bool(torch.isfinite(lobe).all()) and 0 < float(lobe.max()) < 65504


def test_a_rough_texel_shades_as_the_microfacet_model(tmp_path):
    planes = {"Color": torch.zeros(3, 2, 2), "Roughness": torch.full((1, 2, 2), 0.7)}
    material = material_from_textures(folder_of(tmp_path / "set", planes), size=256)
    pole = torch.tensor([0.0, 0.0, 1.0])[:, None, None]
    rough = round(0.7 * 65535) / 65535
    # pi * D F G / (4 N.L N.V) * N.L along the normal, where G is 1: D = 1 / (pi rough^4).
    wanted = math.pi * 0.04 / (4 * math.pi * rough**4)
    # A texel of the lobe holds the mean over it: measured 0.11 % at its peak.
    assert_close(material.shade(pole, pole).detach(), torch.full((3, 2, 2), wanted), 3e-3)


def test_names_in_any_case_and_format_and_the_rest_is_ignored(tmp_path):
    folder = tmp_path / "Ein Satz ü"
    folder.mkdir()
    planes = textures()
    write(folder / "x_COLOR.jpg", planes["Color"], np.uint8)
    write(folder / "x_roughness.EXR", planes["Roughness"], np.float32)
    write(folder / "x_Emission.png", planes["Roughness"])
    write(folder / "x.png", planes["Color"])
    (folder / "readme_Color.txt").write_text("not a texture", encoding="utf-8")
    (folder / "x.usda").write_text("nor this", encoding="utf-8")
    found = find_textures(folder)
    assert set(found.files) == {"color", "roughness"}
    assert found.ignored == ("readme_Color.txt", "x.png", "x.usda")
    assert found.left_out == {"x_Emission.png": "emission: torchmat has no place for it"}
    assert set(material_from_textures(folder).maps) == {"diffuse", "fresnel", "index", "specular"}


def test_the_round_trip_and_the_sphere(tmp_path):
    material = material_from_textures(folder_of(tmp_path / "set", textures()))
    loaded = load_material(save_material(material, tmp_path / "made"))
    for name, value in maps(material.as_exported()).items():
        assert torch.equal(loaded.maps[name], value), name
    seen = render(loaded, "sphere", size=24, repeat=2.0)
    assert bool(torch.isfinite(seen).all()) and float(seen.max()) > 0


def test_what_is_missing_or_does_not_fit_is_named(tmp_path):
    planes = textures()
    with pytest.raises(DataError, match="nowhere: the textures must be a folder"):
        material_from_textures(tmp_path / "nowhere")
    (tmp_path / "empty").mkdir()
    with pytest.raises(DataError, match=r"hold a colour texture; it holds no texture at all\. Add .* empty_Color\.jpg"):
        material_from_textures(tmp_path / "empty")
    no_colour = {name: planes[name] for name in ("Roughness", "Displacement")}
    with pytest.raises(DataError, match="it holds displacement, roughness"):
        material_from_textures(folder_of(tmp_path / "bare", no_colour))
    folder = folder_of(tmp_path / "set", planes)
    write(folder / "again_Color.png", planes["Color"])
    with pytest.raises(DataError, match="the only one; there are Made 001_1K_Color.png and again_Color.png"):
        material_from_textures(folder)
    (folder / "again_Color.png").unlink()
    write(folder / "Made 001_1K_Roughness.png", torch.rand(1, 16, 23))
    with pytest.raises(ShapeError, match=r"Roughness\.png: the texture must have the size .* \(16, 23\).* \(16, 24\)"):
        material_from_textures(folder)
    (folder / "Made 001_1K_Roughness.png").write_bytes(b"\x89PNG not really")
    with pytest.raises(DataError, match=r"Roughness\.png"):
        material_from_textures(folder)


def test_values_that_cannot_be_are_named(tmp_path):
    planes = {"Color": torch.rand(3, 4, 4), "Roughness": torch.rand(1, 4, 4)}
    planes["Roughness"][0, 1, 2] = math.nan
    folder = folder_of(tmp_path / "nan", planes, np.float32, "exr")
    with pytest.raises(RangeError, match=r"Roughness\.exr.* NaN or Inf"):
        material_from_textures(folder)
    planes["Roughness"][0, 1, 2] = 1.5
    folder = folder_of(tmp_path / "range", planes, np.float32, "exr")
    with pytest.raises(RangeError, match=r"roughness texture must lie in \[0, 1\]"):
        material_from_textures(folder)
    normal = {"Color": planes["Color"], "NormalGL": torch.rand(3, 4, 4) / 4}
    with pytest.raises(DataError, match=r"NormalGL\.png: normals must point away"):
        material_from_textures(folder_of(tmp_path / "normal", normal))
    for settings, said in (({"lobes": 0}, "lobes"), ({"size": 0}, "size"), ({"lobes": 2.0}, "lobes")):
        with pytest.raises(RangeError, match=said):
            material_from_textures(folder, **settings)
    with pytest.raises(RangeError, match="roughness"):
        ggx_lobe(1.5)
    with pytest.raises(RangeError, match="height_scale"):
        material_from_textures(folder_of(tmp_path / "set", textures()), height_scale=-1.0)


@pytest.mark.parametrize(("name", "scale"), [("Leather025", 0.0008), ("PavingStones102", 0.007)])
def test_a_real_set(name, scale):
    folder = shared_path(f"real/ambientcg/{name}")
    material = material_from_textures(folder)
    found = maps(material)
    assert set(found) == {"diffuse", "normal", "fresnel", "index", "specular", "height"}
    assert found["index"].shape[0] == 3 and found["index"].shape[1:] == found["diffuse"].shape[1:]
    displacement = find_textures(folder).read("displacement")
    height = found["height"]
    measured = float((height.max() - height.min()) / (displacement.max() - displacement.min()))
    assert measured == pytest.approx(scale, rel=0.05)
    assert_close(found["index"].sum(dim=0), torch.ones(found["index"].shape[1:]), 1e-5)
    seen = render(material, "sphere", size=32, repeat=1.0)
    assert bool(torch.isfinite(seen).all()) and float(seen.max()) > 0.05
