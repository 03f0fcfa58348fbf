"""Texture sets as vendors name them: which file is which map, what a name does not tell, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tests.create.test_from_textures import LIGHT, VIEW, bump, folder_of, maps, textures, write
from tests.support import assert_close, shared_path

from torchmat import colour
from torchmat.cli import main
from torchmat.create import material_from_textures
from torchmat.create.texture_names import kind_of
from torchmat.create.textures import find_textures, read_textures
from torchmat.errors import DataError
from torchmat.geometry import normals_from_slopes, slopes_from_height
from torchmat.images import write_image

# kind: names of files without suffix, of ambientCG (new and old), Poly Haven, FreePBR, Quixel, Substance, Poliigon,
# Textures.com, cgbookcase, 3DTextures and Unreal.
NAMED = {
    "color": "Leather025_1K_Color Leather025_1K-JPG_Color bricks_col rock_wall_15_diff_2k plank_col_1_4k rust2_basecolor "
             "lava-rock-albedo vbogdbl_2K_Albedo Default_Base_Color D_AlbedoTransparency B_COL_2K_METALNESS B_COL_VAR1_4K "
             "Tree_ALPHAMASKED_2K TexturesCom_Brick_2K_albedo Bark02_MR_2K_Base_Color Wall_012_basecolor T_Rock_2K_B "
             "X_BaseColor.1001 metal_0077_color_2k color",
    "normalgl": "Leather025_1K_NormalGL rock_wall_15_nor_gl_2k lava-rock_normal-ogl Default_Normal_OpenGL "
                "m_normal_opengl_2k",
    "normaldx": "Leather025_1K-PNG_NormalDX rock_wall_15_nor_dx_4k-PNG Default_Normal_DirectX",
    "normal": "Bricks_2K_Normal bricks_nrm B_NRM_2K B_NRM16_2K_METALNESS vb_2K_Normal_LOD0 Wall_NORM T_Rock_2K_N",
    "roughness": "x_Roughness bricks_rgh wall_rough_2k Wall_ROUGH", "gloss": "B_GLOSS_4K vb_2K_Gloss Leaf_SG_Glossiness",
    "metalness": "Metal032_1K_Metalness rust2_metallic rock_metal_2k bricks_met B_METALNESS_2K_METALNESS",
    "specular": "B_REFL_3K vb_2K_Specular wall_spec_2k Wall_SPEC", "specularlevel": "D_SpecularLevel",
    "ambientocclusion": "x_AmbientOcclusion wall_ao_2k Wall_012_ambientOcclusion Wall_OCC D_Mixed_AO x_Ambient_Occlusion",
    "displacement": "x_Displacement wall_disp_2k lava-rock_height Wall_DISP B_DISP16_4K T_Rock_2K_H", "bump": "vb_2K_Bump",
    "opacity": "Leaf_1K_Opacity TexturesCom_Leaf_2K_alpha", "arm": "wall_arm_2k", "orm": "T_Rock_2K_ORM",
    "occlusionroughnessmetallic": "D_OcclusionRoughnessMetallic", "ord": "T_Rock_2K_ORD",
    "metallicsmoothness": "D_MetallicSmoothness", "no place: emission": "x_1K_Emission", "no place: mask": "wall_mask_1k",
    "no place: cavity": "vb_2K_Cavity", "no place: specior": "wall_spec_ior_2k", "preview": "streaked-metal1-preview",
    None: "Metal032 photo IMG_0012 old_wood wall_4k",
}


@pytest.mark.parametrize(("kind", "stem"), [(kind, stem) for kind, stems in NAMED.items() for stem in stems.split()])
def test_names_of_vendors(kind, stem):
    assert kind_of(stem) == kind


def put(folder, files: dict[str, torch.Tensor], kind=np.uint16):
    folder.mkdir()
    for name, planes in files.items():
        write(folder / name, planes, kind)
    return folder


def flipped(normal: torch.Tensor) -> torch.Tensor:
    return torch.stack((normal[0], 1 - normal[1], normal[2]))


def linear(planes: torch.Tensor) -> torch.Tensor:
    return colour.srgb_to_linear(planes)


def test_a_poly_haven_set_with_arm(tmp_path):
    planes = textures()
    arm = torch.cat((torch.rand(1, 16, 24), planes["Roughness"], torch.rand(1, 16, 24)))
    folder = put(tmp_path / "wall", {
        "wall_1_diff_2k.png": planes["Color"], "wall_1_arm_2k.png": arm, "wall_1_nor_dx_2k.png": flipped(planes["NormalGL"]),
        "wall_1_disp_2k.png": planes["Displacement"], "wall_1.png": planes["Color"],
    })
    (folder / "wall_1_2k.blend").write_bytes(b"BLENDER")
    found = find_textures(folder)
    assert dict(found.rows()) == {
        "color": "wall_1_diff_2k.png", "displacement": "wall_1_disp_2k.png", "normaldx": "wall_1_nor_dx_2k.png",
        "roughness": "wall_1_arm_2k.png, green", "metalness": "wall_1_arm_2k.png, blue",
        "ambientocclusion": "wall_1_arm_2k.png, red",
    }
    assert found.ignored == ("wall_1.png", "wall_1_2k.blend")
    read = read_textures(found)
    for place, name in enumerate(("ambientocclusion", "roughness", "metalness")):
        assert_close(read[name], arm[place : place + 1], 1e-4)
    assert_close(read["normalgl"], planes["NormalGL"] * 2 - 1, 2e-4)
    assert_close(maps(material_from_textures(folder))["diffuse"], linear(planes["Color"]) * (1 - arm[2:]), 1e-4)


def test_a_file_of_its_own_goes_before_a_packed_channel(tmp_path):
    rough = torch.rand(1, 4, 4)
    folder = put(tmp_path / "s", {
        "x_diff.png": torch.rand(3, 4, 4), "x_rough.png": rough, "x_arm.png": torch.rand(3, 4, 4),
    })
    assert_close(read_textures(find_textures(folder))["roughness"], rough, 1e-4)


@pytest.mark.parametrize("name", ["Metal", "Gold_Metal", "T-Metallic"])
def test_a_set_that_is_called_metal_has_a_roughness_of_its_own(tmp_path, name):
    rough = torch.rand(1, 4, 4)
    folder = put(tmp_path / "s", {f"{name}_BaseColor.png": torch.rand(3, 4, 4), f"{name}_Roughness.png": rough})
    found = find_textures(folder)
    assert set(found.files) == {"color", "roughness"}
    assert_close(read_textures(found)["roughness"], rough, 1e-4)


def test_smoothness_in_the_alpha_of_metal(tmp_path):
    packed = torch.rand(4, 4, 4)
    folder = put(tmp_path / "s", {"x_AlbedoTransparency.png": torch.rand(3, 4, 4), "x_MetallicSmoothness.png": packed})
    read = read_textures(find_textures(folder))
    assert_close(read["metalness"], packed[:1], 1e-4)
    assert_close(read["roughness"], 1 - packed[3:], 1e-4)


def test_a_packed_texture_of_one_channel_is_refused(tmp_path):
    folder = put(tmp_path / "s", {"x_diff.png": torch.rand(3, 4, 4), "x_arm.png": torch.rand(1, 4, 4)})
    with pytest.raises(DataError, match=r"x_arm\.png: the packed texture must have \d channels; it has 1"):
        material_from_textures(folder)


def test_gloss_is_one_minus_roughness(tmp_path):
    rough = 0.2 + 0.6 * torch.rand(1, 8, 8)
    base = torch.rand(3, 8, 8)
    one = put(tmp_path / "rough", {"x_COL_2K.png": base, "x_ROUGHNESS_2K.png": rough})
    other = put(tmp_path / "gloss", {"x_COL_2K.png": base, "x_GLOSS_2K.png": 1 - rough})
    first, second = (material_from_textures(folder).shade(LIGHT, VIEW) for folder in (one, other))
    assert_close(second, first, 1e-3)


def test_metal_stays_metal(tmp_path):
    base = torch.tensor([0.9, 0.6, 0.3])[:, None, None].expand(3, 4, 4).contiguous()
    folder = put(tmp_path / "rust", {
        "rust2_basecolor.png": base, "rust2_metallic.png": torch.ones(1, 4, 4), "rust2_roughness.png": torch.rand(1, 4, 4),
    })
    found = maps(material_from_textures(folder))
    assert float(found["diffuse"].max()) == 0
    assert_close(found["fresnel"] * found["specular_mask"], linear(base), 1e-4)


@pytest.mark.parametrize("coloured", [False, True])
@pytest.mark.parametrize("rough", ["GLOSS", "ROUGHNESS"])
def test_what_a_specular_texture_means(tmp_path, coloured, rough):
    # Beside gloss, or in colour, it is the reflectance in sRGB; a grey one beside roughness is a level: 0.08 of it.
    spec = torch.tensor([0.6, 0.5, 0.4] if coloured else [0.5, 0.5, 0.5])[:, None, None].expand(3, 4, 4).contiguous()
    folder = put(tmp_path / "s", {
        "x_COL.png": torch.rand(3, 4, 4), f"x_{rough}.png": torch.rand(1, 4, 4), "x_REFL.png": spec,
    })
    found = maps(material_from_textures(folder))
    seen = found["fresnel"] * found.get("specular_mask", torch.ones(1))
    level = rough == "ROUGHNESS" and not coloured
    assert_close(seen.expand(3, 4, 4), 0.08 * spec if level else linear(spec), 1e-3)


@pytest.mark.parametrize("made", ["OpenGL", "DirectX"])
@pytest.mark.parametrize("height", ["with", "without", "hollow"])
def test_a_bare_normal_is_told_by_what_it_agrees_with(tmp_path, made, height):
    planes = textures(0.03)
    gl = planes["NormalGL"]
    files = {"x_Color.png": planes["Color"], "x_Normal.png": gl if made == "OpenGL" else flipped(gl)}
    if height != "without":
        files["x_Height.png"] = planes["Displacement"] if height == "with" else 1 - planes["Displacement"]
    said: list[str] = []
    folder = put(tmp_path / "s", files)
    found = maps(material_from_textures(folder, height_scale=0.0, say=said.append))
    assert_close(found["normal"], gl * 2 - 1, 2e-4)
    assert f"read as {made}'s" in said[0] and "guess" not in said[0]


def test_a_flat_bare_normal_is_a_guess_that_is_said(tmp_path):
    flat = torch.tensor([0.5, 0.5, 1.0])[:, None, None].expand(3, 8, 8).contiguous()
    said: list[str] = []
    material_from_textures(put(tmp_path / "s", {"c_Color.png": flat, "c_Normal.png": flat}), say=said.append)
    assert "which is a guess: rename the file to end in _NormalGL or _NormalDX" in said[0]


def test_old_sets_have_the_height_that_their_normals_say(tmp_path):
    planes = textures(0.015)
    folder = put(tmp_path / "s", {
        "Old_Color.png": planes["Color"], "Old_Normal.png": planes["NormalGL"],
        "Old_Displacement.png": planes["Displacement"],
    })
    said: list[str] = []
    height = maps(material_from_textures(folder, say=said.append))["height"]
    assert float(height.max() - height.min()) == pytest.approx(0.015, rel=1e-3)
    assert said[1] == "height: white lies 0.015 texture widths over black, as the normal map's slopes say"


def test_a_normal_map_that_is_called_after_the_other_is_refused(tmp_path):
    planes = textures()
    folder = put(tmp_path / "s", {
        "x_Color.png": planes["Color"], "x_NormalDX.png": planes["NormalGL"], "x_Displacement.png": planes["Displacement"],
    })
    with pytest.raises(DataError, match=r"agree in both directions; they agree by \+1\.00 to the right and -1\.00 upward"):
        material_from_textures(folder)


def test_normals_in_signed_numbers(tmp_path):
    normal = normals_from_slopes(slopes_from_height(bump(), 0.03))
    folder = put(tmp_path / "s", {"x_Color.exr": torch.rand(3, 16, 24), "x_nor_gl.exr": normal}, np.float32)
    assert_close(read_textures(find_textures(folder))["normalgl"], normal, 1e-6)


@pytest.mark.parametrize("name", ["wall_wetness.png", "IMG_12.jpg", "Lacquer.tif"])
def test_a_picture_that_says_nothing_is_an_error_that_helps(tmp_path, name):
    folder = folder_of(tmp_path / "s", {"Color": torch.rand(3, 4, 4)})
    write(folder / name, torch.rand(3, 4, 4), np.uint8)
    with pytest.raises(DataError, match=rf"what they are; {name} does not\. Rename those that are maps to end in _Color, "):
        find_textures(folder)


def test_a_format_that_is_not_read(tmp_path):
    folder = folder_of(tmp_path / "s", {"Color": torch.rand(3, 4, 4)})
    (folder / "x_Roughness.webp").write_bytes(b"RIFF")
    with pytest.raises(DataError, match=r"x_Roughness\.webp is not\. Save as PNG"):
        find_textures(folder)


def test_tiles_and_variants_of_one_map_are_two(tmp_path):
    folder = put(tmp_path / "s", {"x_BaseColor.1001.png": torch.rand(3, 4, 4), "x_BaseColor.1002.png": torch.rand(3, 4, 4)})
    with pytest.raises(DataError, match=r"be the only one; there are x_BaseColor\.1001\.png and x_BaseColor\.1002\.png"):
        find_textures(folder)


def test_a_folder_of_folders_names_them(tmp_path):
    put(tmp_path / "textures", {"x_Color.png": torch.rand(3, 4, 4)})
    with pytest.raises(DataError, match="Give a folder inside it: textures"):
        find_textures(tmp_path)


def test_two_real_forms():
    wall = read_textures(find_textures(shared_path("field/polyhaven")))
    assert set(wall) == {"color", "normalgl", "displacement", "roughness", "ambientocclusion", "metalness"}
    rust = maps(material_from_textures(shared_path("field/freepbr")))
    metal = read_textures(find_textures(shared_path("field/freepbr")))["metalness"]
    assert float(metal.max()) > 0.9
    assert float(rust["diffuse"][:, metal[0] == 1].max() if bool((metal == 1).any()) else 0) == 0


def test_names_without_a_colour(tmp_path):
    write_image((tmp_path / "x_nor_gl_2k.png"), np.zeros((2, 2, 3), np.uint8))
    with pytest.raises(DataError, match="hold a colour texture; it holds normalgl"):
        find_textures(tmp_path)


def test_info_and_create_say_what_is_read_from_what(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    planes = textures(0.03)
    folder = put(tmp_path / "wall", {
        "wall_diff_2k.png": planes["Color"], "wall_disp_2k.png": planes["Displacement"],
        "wall_nor_2k.png": planes["NormalGL"],
        "wall_arm_2k.png": torch.rand(3, 16, 24), "wall_emission_2k.png": planes["Color"], "wall.png": planes["Color"],
    })
    assert main(["info", str(folder)]) == 0
    told = capsys.readouterr().out
    table = [[cell.strip() for cell in line.strip("|").split("|")] for line in told.splitlines() if line.startswith("|")]
    rows = {row[0]: row[1:] for row in table}
    assert rows["displacement"][:3] == ["wall_disp_2k.png", "16 x 24", "1 x uint16"]
    assert [float(end) for end in rows["displacement"][3:]] == pytest.approx([0, 1], abs=0.02)
    assert rows["metalness"][0] == "wall_arm_2k.png, blue"
    assert "left out   wall_emission_2k.png (emission: torchmat has no place for it)" in told
    assert "ignored    wall.png" in told
    assert main(["create", str(folder), "--out", "made", "--no-pictures"]) == 0
    told = capsys.readouterr().out
    assert "normal: read as OpenGL's" in told and "height: white lies 0.03 texture widths over black" in told
    write(folder / "wall_wetness.png", planes["Roughness"])
    assert main(["info", str(folder)]) == 2
    assert "wall_wetness.png does not. Rename" in capsys.readouterr().err
