"""Hard cases 1 to 6: every model at the directions where formulas break. Finite means value and gradient."""

from __future__ import annotations

import math

import pytest
import torch
from models.examples import CASES, make

from torchmat import frames, safe
from torchmat.models.bases import BASES

every_model = pytest.mark.parametrize("name, options", CASES)


def _graze(azimuth: float, height: float) -> tuple[float, float, float]:
    flat = math.sqrt(1 - height * height)
    return flat * math.cos(azimuth), flat * math.sin(azimuth), height


POLE = (0.0, 0.0, 1.0)
PAIRS = {
    "light_and_view_are_the_normal": (POLE, POLE),
    "light_is_view": (_graze(0.3, 0.6), _graze(0.3, 0.6)),
    "mirror_pair": (_graze(0.3, 0.6), _graze(0.3 + math.pi, 0.6)),
    "light_at_normal_view_at_horizon": (POLE, _graze(1.0, 1e-4)),
    "both_at_horizon_same_side": (_graze(0.2, 1e-4), _graze(0.2, 1e-4)),
    "both_at_horizon_across": (_graze(0.2, 1e-4), _graze(0.2 + math.pi / 2, 1e-4)),
    "both_at_horizon_opposite": (_graze(0.2, 1e-4), _graze(0.2 + math.pi, 1e-4)),
    "both_a_rounding_error_above_the_horizon": ((1.0, 0.0, 6.1e-17), (-1.0, 0.0, 6.1e-17)),
    "light_lower_than_view_at_horizon": (_graze(0.0, 1e-7), _graze(math.pi, 1e-4)),
    "nearly_the_pole": ((1e-20, -1e-20, 1.0), (3e-25, 0.0, 1.0)),
    "negative_zeros": ((-0.0, -0.0, 1.0), (-0.0, 0.0, 1.0)),
}


def _shade_and_differentiate(material, light, view, dtype):
    leaves = [torch.tensor(d, dtype=dtype)[:, None, None].requires_grad_() for d in (light, view)]
    value = material.shade(*leaves)
    assert bool(torch.isfinite(value).all())
    assert bool((value >= 0).all())
    value.sum().backward()
    for label, leaf in (("light", leaves[0]), ("view", leaves[1]), *material.maps.items()):
        assert leaf.grad is None or bool(torch.isfinite(leaf.grad).all()), f"the gradient of {label} is not finite"
    return value.detach(), leaves


@every_model
@pytest.mark.parametrize("pair", PAIRS)
def test_case_1_value_and_gradient_are_finite(name, options, pair, dtype):
    _shade_and_differentiate(make(name, options, 2, 2, dtype), *PAIRS[pair], dtype)


@every_model
@pytest.mark.parametrize("light", [POLE, (1.0, 0.0, 0.0), _graze(0.4, 0.5)])
def test_case_1_light_opposite_to_view_is_dark(name, options, light, dtype):
    # One of the two is below or both are on the horizon.
    value, leaves = _shade_and_differentiate(make(name, options, 2, 2, dtype), light, tuple(-k for k in light), dtype)
    assert not bool(value.any())
    assert all(leaf.grad is None or not bool(leaf.grad.any()) for leaf in leaves)


@every_model
@pytest.mark.parametrize("azimuth", [0.0, 1.3, 3.0])
def test_case_2_value_is_continuous_on_the_way_into_the_horizon(name, options, azimuth):
    # Light and view sink together, side by side; equal ratios of the height must change ever less.
    material = make(name, options, 2, 2)
    heights = [10.0**-k for k in range(2, 9)]
    with torch.no_grad():
        values = [
            material.shade(*(torch.tensor(_graze(a, h), dtype=torch.float64)[:, None, None] for a in (azimuth, azimuth + 0.5)))
            for h in heights
        ]
    steps = [float((b - a).abs().max()) for a, b in zip(values, values[1:], strict=False)]
    assert steps[-1] < 1e-3
    assert steps[-1] <= steps[0] + 1e-12


def test_case_3_frames_of_steep_normals():
    tilt = torch.deg2rad(torch.linspace(0, 89.9, 100, dtype=torch.float64))[:, None]
    azimuth = torch.linspace(0, 2 * math.pi, 101, dtype=torch.float64)[None, :-1]
    normal = frames.from_polar(*torch.broadcast_tensors(tilt, azimuth), dim=-3)
    assert normal[0].numel() == 10_000
    tangent, bitangent = frames.tangent_frame(normal)
    frame = torch.stack((tangent, bitangent, normal))
    gram = torch.einsum("ikhw,jkhw->hwij", frame, frame)
    assert float((gram - torch.eye(3, dtype=torch.float64)).abs().max()) < 1e-12
    assert float((torch.linalg.det(frame.permute(2, 3, 0, 1)) - 1).abs().max()) < 1e-12
    turned = torch.roll(frame, 1, dims=-1)
    assert float((turned - frame).norm(dim=1).max()) < 2 * 2 * math.pi / 100


def test_case_3_a_normal_tilted_to_the_rim_shades(dtype):
    from torchmat.models import Lambert

    tilt = math.radians(89.9)
    normal = torch.tensor([math.sin(tilt), 0, math.cos(tilt)], dtype=dtype)[:, None, None]
    _shade_and_differentiate(Lambert({"albedo": torch.ones_like(normal), "normal": normal}), POLE, POLE, dtype)


@every_model
def test_case_5_azimuth_zero_is_a_full_turn(name, options, dtype):
    material = make(name, options, 2, 2, dtype)
    view = torch.tensor(_graze(1.0, 0.7), dtype=dtype)[:, None, None]
    with torch.no_grad():
        values = [
            material.shade(torch.tensor(_graze(a, 0.5), dtype=dtype)[:, None, None], view)
            for a in (0.0, 2 * math.pi, -1e-7, 1e-7)
        ]
    for value in values[1:]:
        assert float((value - values[0]).abs().max()) < 1e-5


def test_case_5_harmonics_do_not_jump_where_the_azimuth_wraps():
    lights = torch.tensor([_graze(math.pi - 1e-9, 0.5), _graze(-math.pi + 1e-9, 0.5)], dtype=torch.float64)[:, :, None, None]
    planes = BASES["hsh16"].evaluate(lights, lights)
    assert float((planes[0] - planes[1]).abs().max()) < 1e-7


@pytest.mark.parametrize("end", [1.0, -1.0])
def test_case_6_acos_at_the_ends_and_one_ulp_outside(end, dtype):
    one = torch.tensor(end, dtype=dtype)
    for x in (one, torch.nextafter(one, 2 * one)):
        leaf = x.clone().requires_grad_()
        value = safe.acos(leaf)
        value.backward()
        assert float(value.detach()) == pytest.approx(0.0 if end > 0 else math.pi)
        assert float(leaf.grad) == 0
