"""Texture sets that are written: what `create` reads of them is what was there, for every vendor."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tests.material_io.forms import microfacet, of_metalness, rand
from tests.models.distributions import distribution

import torchmat as tm
from torchmat import RangeError
from torchmat.create import microfacet_from_textures
from torchmat.create.textures import find_textures, read_textures
from torchmat.geometry import normals_from_slopes, slopes_from_height
from torchmat.images import read_image
from torchmat.material_io.orm import VENDORS

QUANTUM = 1 / 65535


def close(actual: torch.Tensor, wanted: torch.Tensor, tolerance: float) -> None:
    assert float((actual.detach() - wanted.detach()).abs().max()) <= tolerance


@pytest.mark.parametrize("vendor", VENDORS)
def test_what_create_reads_comes_back_the_same(tmp_path, vendor):
    opacity = (rand(1, 20) > 0.3).float()
    material = of_metalness("normal", opacity=opacity)
    losses = tm.export(material, tmp_path / "set", to="orm", vendor=vendor)
    read = microfacet_from_textures(tmp_path / "set", tiles=True)
    assert read.options["parts"] == ["normal"]
    there = opacity.expand(3, -1, -1) > 0  # `create` takes the mean where nothing is
    for name in ("diffuse", "specular_f0"):
        close(read.maps[name][there], material.maps[name][there], 4 * QUANTUM)
    close(read.maps["roughness"][opacity > 0], material.maps["roughness"][opacity > 0], QUANTUM)
    close(read.maps["opacity"], opacity, 0)
    close(read.maps["normal"][there], material.maps["normal"][there], 3 * QUANTUM)
    assert losses.errors["native"] < 1e-7 and losses.lost == {}
    assert "metal" in " ".join(path.name.lower() for path in (tmp_path / "set").iterdir()) or vendor in ("polyhaven", "poliigon")
    again = tm.export(read, tmp_path / "again", to="orm", vendor=vendor)
    names = sorted(path.name for path in (tmp_path / "set").glob("*.png"))
    assert names == sorted(path.name for path in (tmp_path / "again").glob("*.png")) and again.errors["native"] < 1e-7
    for name in names:
        one, other = (read_image(tmp_path / folder / name).astype(int) for folder in ("set", "again"))
        seen = opacity[0].numpy() > 0
        assert np.abs(one - other)[seen].max() <= 1  # of 65535: the same set


@pytest.mark.parametrize("vendor", ["unreal", "unity", "ambientcg"])
def test_a_height_comes_back_by_its_normals(tmp_path, vendor):
    y, x = torch.meshgrid(torch.arange(16) / 16, torch.arange(16) / 16, indexing="ij")
    height = (0.01 * torch.sin(6.2832 * x) * torch.cos(6.2832 * y))[None]
    maps = {name: value.detach()[:, :1, :1].expand(-1, 16, 16) for name, value in of_metalness().maps.items()}
    material = microfacet(size=(16, 16), **maps).on_relief(height)
    losses = tm.export(material, tmp_path / "set", to="orm", vendor=vendor)
    read = microfacet_from_textures(tmp_path / "set", tiles=True)
    close(read.maps["height"], height - height.mean(), 2e-4)
    close(read.surface().maps["normal"], material.surface().maps["normal"], 1e-3)
    assert losses.approximated["height"].startswith("0 to 1 without its scale") and losses.lost == {}


def test_greens_and_packing(tmp_path):
    material = of_metalness("normal")
    for vendor in ("unreal", "unity", "ambientcg"):
        tm.export(material, tmp_path / vendor, to="orm", vendor=vendor, name="wool", depth=8)
    gl, dx = (read_image(tmp_path / file) for file in ("ambientcg/wool_NormalGL.png", "unreal/wool_Normal_DirectX.png"))
    assert np.array_equal(gl[..., 0], dx[..., 0]) and np.abs(gl[..., 1].astype(int) + dx[..., 1] - 255).max() <= 1
    orm = read_image(tmp_path / "unreal" / "wool_OcclusionRoughnessMetallic.png")
    rough = np.round(material.maps["roughness"].detach()[0].numpy() * 255)
    assert (orm[..., 0] == 255).all() and np.abs(orm[..., 1] - rough).max() <= 1
    smooth = read_image(tmp_path / "unity" / "wool_MetallicSmoothness.png")
    assert smooth.shape[2] == 4 and np.abs(255 - smooth[..., 3] - rough).max() <= 1 and np.array_equal(smooth[..., 0], orm[..., 2])
    with pytest.raises(RangeError, match="vendor must be one of .*; it is 'unrea'. Did you mean 'unreal'"):
        tm.export(material, tmp_path / "x", to="orm", vendor="unrea")
    with pytest.raises(RangeError, match="depth must be one of 8, 16"):
        tm.export(material, tmp_path / "x", to="orm", depth=12)


def test_every_specular_colour_fits_a_set_with_reflectance_and_not_one_with_metalness(tmp_path):
    material = microfacet()  # F0 of any colour over any diffuse
    exact = tm.export(material, tmp_path / "a", to="orm", vendor="poliigon")
    assert exact.errors["native"] < 1e-7 and "specular_f0" in (*exact.approximated, *exact.exact)
    rough = tm.export(material, tmp_path / "b", to="orm", vendor="unreal")
    assert rough.errors["native"] > 1e-4 and "a base colour and a metalness hold 0.04" in rough.approximated["specular_f0"]


def test_what_has_no_texture_is_lost_by_name(tmp_path):
    material = microfacet("anisotropy", "f90", "coat", "sheen", "rolloff")
    losses = tm.export(material, tmp_path / "a", to="orm")
    assert {"rotation", "f90", "coat", "coat_roughness", "sheen", "sheen_roughness", "rolloff"} <= set(losses.lost)
    assert "one for both directions" in losses.approximated["roughness"]
    told = str(losses)
    assert told.startswith("exact: nothing; approximated (error ") and "against the material): " in told and "lost: " in told


def test_another_model_is_fitted_and_says_so(tmp_path):
    material = distribution(6, 6, 1, ("normal", "specular_mask", "fresnel"))
    losses = tm.export(material, tmp_path / "a", to="orm", vendor="poliigon")
    assert set(losses.approximated) | set(losses.lost) | set(losses.exact) == {spec.name for spec in material.specs()}
    assert losses.approximated["specular"] == "held as diffuse, F0 and roughness of a GGX lobe"
    assert 0 < losses.errors["native"] < 0.5
    assert set(read_textures(find_textures(tmp_path / "a"))) == {"color", "f0", "roughness", "normalgl"}


def test_normals_of_a_relief_are_the_whole_ones(tmp_path):
    height = 0.01 * rand(1, 3)
    material = of_metalness().on_relief(height, 0.1 * rand(3, 4))
    losses = tm.export(material, tmp_path / "a", to="orm", vendor="freepbr")
    read = read_textures(find_textures(tmp_path / "a"))
    close(read["normalgl"], normals_from_slopes(slopes_from_height(height)), 1e-4)
    assert losses.lost == {"ambient": "light from texel to texel has no place"}
