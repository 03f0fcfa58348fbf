"""Hard case 7: parameters of lobes at the ends of their ranges; maps of every model are in the table."""

from __future__ import annotations

import math

import pytest
import torch
from tests.models.examples import LOBES, directions, make, make_maps, per_image

from torchmat import safe
from torchmat.models import PhongSrf
from torchmat.models.lobes import LOBES as TABLE

HARD = torch.tensor(
    [[0, 0, 1.0], [0.6, 0, 0.8], [-0.6, 0, 0.8], [1, 0, 1e-4], [-1, 0, 1e-4], [0, 0.8, 0.6]], dtype=torch.float64
)


def _finite(material, dtype):
    light, view = HARD.repeat(len(HARD), 1).to(dtype), HARD.repeat_interleave(len(HARD), 0).to(dtype)
    leaves = [per_image(d).clone().requires_grad_() for d in (light, view)]
    value = material.shade(*leaves)
    value.sum().backward()
    assert bool(torch.isfinite(value).all())
    for label, leaf in (("light", leaves[0]), ("view", leaves[1]), *material.maps.items()):
        assert leaf.grad is None or bool(torch.isfinite(leaf.grad).all()), label
    return value.detach()


@pytest.mark.parametrize("base", LOBES)
@pytest.mark.parametrize("exponent", [1e-30, 1e-3, 1e-2, 1.0, 1e5])
def test_case_7_exponents(base, exponent, dtype):
    maps = make_maps("phong_srf", {"residual": "half", "base": base}, 1, 1, dtype)
    for place, label in enumerate(TABLE[base].names):
        if label.startswith("log_exponent"):
            maps["lobe"][place] = math.log(exponent)
    maps["residual"] = torch.zeros_like(maps["residual"])
    value = _finite(PhongSrf(maps, base=base), dtype)
    if base == "phong":
        # H = z at the pole: k_d + k_s whatever the exponent.
        expected = maps["lobe"][:3] + maps["lobe"][3:6]
        assert float((value[0, :, 0, 0] - expected).abs().max()) < 1e-5


@pytest.mark.parametrize("exponent", [0.0, 1e-3, 1.0, 1e5])
def test_case_7_power_of_zero(exponent, dtype):
    base = torch.zeros(1, dtype=dtype, requires_grad=True)
    power = torch.full((1,), exponent, dtype=dtype, requires_grad=True)
    value = safe.power(base, power)
    value.backward()
    assert float(value.detach()) == (1.0 if exponent == 0 else 0.0)
    assert float(base.grad) == float(power.grad) == 0


@pytest.mark.parametrize("reflectance", [0.0, 1.0])
def test_case_7_fresnel_ends(reflectance, dtype):
    maps = make_maps("phong_srf", {"residual": "half", "base": "ashikhmin_shirley"}, 1, 1, dtype)
    maps["lobe"][3:6] = reflectance
    _finite(PhongSrf(maps, base="ashikhmin_shirley"), dtype)


@pytest.mark.parametrize("strength", [0.0, 1.0])
def test_case_7_black_and_white_lobes(strength, dtype):
    maps = make_maps("phong_srf", {"residual": "half", "base": "phong"}, 1, 1, dtype)
    maps["lobe"][:6] = strength
    maps["residual"] = torch.zeros_like(maps["residual"])
    value = _finite(PhongSrf(maps), dtype)
    assert strength > 0 or not bool(value.any())


def test_case_7_one_component_and_one_cluster(dtype):
    for name, options in (("pca", {"components": 1}), ("local_pca", {"clusters": 1, "components": 1})):
        material = make(name, options, 2, 2, dtype)
        _finite(material, dtype)
        light = per_image(directions(3, torch.float32))
        assert bool(torch.isfinite(material.as_exported().shade(light, light)).all())
