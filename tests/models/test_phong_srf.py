"""Phong + residual by hand; its families and bases."""

from __future__ import annotations

import math

import pytest
import torch
from tests.models.examples import LOBES, assert_same, directions, make, make_maps, per_image

from torchmat.errors import RangeError
from torchmat.models import PhongSrf


def test_the_papers_equation_by_hand():
    # Eq. 5 at L = (0.6, 0, 0.8), V = (-0.6, 0, 0.8): H = z. Red: 0.5 * 0.8 + 0.25 * 1 + s_z.
    residual = torch.zeros(9, 1, 1, dtype=torch.float64)
    residual[6:9, 0, 0] = torch.tensor([0.1, 0.2, -2.0], dtype=torch.float64)  # s_z of each channel
    residual[0:6] = 7.0  # s_x and s_y meet 0
    lobe = torch.tensor([0.5, 0.5, 0.5, 0.25, 0.0, 0.25, math.log(3)], dtype=torch.float64)
    material = PhongSrf({"lobe": lobe, "residual": residual})
    light, view = (torch.tensor(d, dtype=torch.float64)[:, None, None] for d in ((0.6, 0, 0.8), (-0.6, 0, 0.8)))
    assert_same(material.shade(light, view)[:, 0, 0], torch.tensor([0.75, 0.6, 0.0], dtype=torch.float64))


def test_srf_gives_the_papers_vectors():
    material = make("phong_srf", {"residual": "half"})
    for channel in range(3):
        for term in range(3):
            assert torch.equal(material.srf(channel)[term], material.maps["residual"][3 * term + channel])


@pytest.mark.parametrize("residual, numbers", [("half", 9), ("half_light", 21), ("quadratic", 45)])
def test_numbers_per_texel(residual, numbers):
    material = make("phong_srf", {"residual": residual})
    assert material.maps["residual"].shape[0] == numbers
    assert material.bytes_per_texel == 2 * numbers
    assert material.shared_bytes == 4 * 7


@pytest.mark.parametrize("base", LOBES)
def test_without_a_residual_every_texel_is_the_lobe(base):
    maps = make_maps("phong_srf", {"residual": "half", "base": base}, 2, 3)
    maps["residual"] = torch.zeros_like(maps["residual"])
    material = PhongSrf(maps, base=base)
    value = material.shade(per_image(directions(4)), per_image(directions(4, seed=2)))
    assert_same(value, value[:, :, :1, :1].expand_as(value))
    assert set(material.parameters_by_name) >= {"diffuse_r", "specular_b"}
    assert list(material.parameters_by_name.values()) == pytest.approx(list(LOBES[base]), rel=1e-6)


def test_options_are_checked_by_name():
    maps = make_maps("phong_srf", {"residual": "half", "base": "phong"})
    with pytest.raises(RangeError, match=r"residual must be one of .*Did you mean 'half_light'\?"):
        PhongSrf(maps, residual="halflight")
    with pytest.raises(RangeError, match=r"base must be one of .*Did you mean 'phong'\?"):
        PhongSrf(maps, base="fong")


def test_export_of_a_double_precision_material_can_be_shaded():
    exported = make("phong_srf", {"residual": "half", "base": "phong"}, dtype=torch.float64).as_exported()
    light = per_image(directions(2, torch.float32))
    assert exported.shade(light, light).dtype == torch.float32
