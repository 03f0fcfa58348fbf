"""Texture sets and pictures as microfacet materials: every map is the texture itself."""

from __future__ import annotations

import pytest
import torch
from tests.create.test_from_textures import folder_of, textures
from tests.models.examples import directions, per_image
from tests.support import assert_close

from torchmat import RangeError, load_material, save_material
from torchmat.cli.create import Create
from torchmat.create import material_from_textures, microfacet_from_picture, microfacet_from_textures

LIGHT, VIEW = (per_image(directions(8, torch.float32, seed)) for seed in (1, 2))


def test_each_texture_is_its_map(tmp_path):
    planes = textures()
    folder = folder_of(tmp_path / "set", planes)
    said = []
    material = microfacet_from_textures(folder, say=said.append)
    other = material_from_textures(folder)
    assert_close(material.maps["roughness"].detach(), planes["Roughness"][:1].float(), 2e-5)
    assert_close(material.maps["diffuse"].detach(), other.maps["diffuse"].detach(), 1e-6)
    assert torch.equal(material.maps["specular_f0"], torch.full_like(material.maps["diffuse"], 0.04))
    for name in ("normal", "height"):
        assert torch.equal(material.maps[name], other.maps[name])
    assert material.stored == other.stored and material.storage == "paint8" and any(line.startswith("height") for line in said)


def test_metal_has_its_colour_for_f0_and_no_diffuse_part(tmp_path):
    planes = textures()
    plain = microfacet_from_textures(folder_of(tmp_path / "plain", planes), height_scale=0)
    planes["Metalness"] = torch.ones_like(planes["Roughness"])
    material = microfacet_from_textures(folder_of(tmp_path / "set", planes), height_scale=0)
    assert not bool(material.maps["diffuse"].any())
    assert_close(material.maps["specular_f0"].detach(), plain.maps["diffuse"].detach(), 1e-6)


def test_without_roughness_there_is_nothing_specular_and_it_is_said(tmp_path):
    planes, said = {name: value for name, value in textures().items() if name != "Roughness"}, []
    material = microfacet_from_textures(folder_of(tmp_path / "set", planes), height_scale=0, say=said.append)
    assert not bool(material.maps["specular_f0"].any()) and "roughness: no file gives it; nothing specular is taken" in said


def test_a_picture_becomes_a_material():
    picture = torch.rand(3, 8, 9, generator=torch.Generator().manual_seed(0))
    material = microfacet_from_picture(picture, roughness=0.4)
    assert torch.equal(material.maps["diffuse"], picture * 0.8) and material.has_relief
    assert float(material.maps["roughness"].detach().min()) == float(material.maps["roughness"].detach().max()) == pytest.approx(0.4)
    flat = microfacet_from_picture(picture, fresnel_brightness=-0.43, height_scale=0)
    assert not flat.has_relief and bool(torch.isfinite(flat.shade(LIGHT, VIEW)).all()) and flat.maps["specular_f0"].detach().std() > 0
    with pytest.raises(RangeError, match="roughness must lie in"):
        microfacet_from_picture(picture, roughness=1.2)


def test_the_command_makes_both(tmp_path, capsys):
    folder = folder_of(tmp_path / "set", textures())
    Create(str(folder), tmp_path / "out", model="microfacet", no_pictures=True).run()
    material = load_material(tmp_path / "out")
    assert material.name == "microfacet" and "material" in capsys.readouterr().out
    again = load_material(save_material(material, tmp_path / "again"))
    assert all(torch.equal(again.maps[name], value) for name, value in material.maps.items())
    picture = next(folder.glob("*Color*"))
    Create(str(picture), tmp_path / "picture", model="microfacet", roughness=0.3, height_scale=0.0, no_pictures=True).run()
    assert float(load_material(tmp_path / "picture").maps["roughness"].detach().mean()) == pytest.approx(0.3, abs=0.003)
