"""Hard cases 3, 5 and 6 of frames, bases and cosines; models at such directions are in the table."""

from __future__ import annotations

import math

import pytest
import torch
from tests.brdf.directions import graze

from torchmat import frames, safe
from torchmat.models.bases import BASES


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


def test_case_5_harmonics_do_not_jump_where_the_azimuth_wraps():
    lights = torch.tensor([graze(math.pi - 1e-9, 0.5), graze(-math.pi + 1e-9, 0.5)], dtype=torch.float64)[:, :, None, None]
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
