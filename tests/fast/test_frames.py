"""Frames and normals of the compiled part against plain torch, in value and gradients."""

from __future__ import annotations

import pytest
import torch
from tests.fast.conftest import on_both_roads, with_threads

from torchmat.geometry import normals_from_slopes
from torchmat.models import Distribution

pytestmark = pytest.mark.usefixtures("compiled")
ROWS, COLUMNS = 7, 9


def hard_normals(dtype):
    """Return normals [3, H, W] of any length: straight down, none at all, next to nothing and very long ones among them."""
    normal = torch.randn(3, ROWS, COLUMNS, dtype=dtype)
    normal[:, 0, 0], normal[:, 0, 1], normal[:, 0, 2] = torch.tensor([0.0, 0, -1]), 0, torch.tensor([0.0, 0, 1])
    small = 1e-30 if dtype == torch.float32 else 1e-200
    normal[:, 1], normal[:, 2] = normal[:, 1] * small, normal[:, 2] / small
    normal[2, 3] = normal[2, 3].abs() * 1e-6
    return normal


def hard_rotations(dtype):
    turn = torch.randn(2, ROWS, COLUMNS, dtype=dtype)
    turn[:, 0, 3], turn[:, 4, 0], turn[:, 4, 1] = 0, torch.tensor([0.0, -1.0]), torch.tensor([1.0, 0.0])
    return turn


def frame_and_pulls(normal, rotation, above):
    """Return the frame of a material of these maps, and the gradients that `above` sends to them."""
    leaves = {name: one.clone().requires_grad_() for name, one in (("normal", normal), ("rotation", rotation)) if one is not None}
    diffuse = torch.zeros(3, ROWS, COLUMNS, dtype=above.dtype)
    specular = torch.zeros(3, 2, 2, dtype=above.dtype)
    rest = {"diffuse": diffuse, "specular": specular}
    flat = {name: torch.zeros_like(leaf) + torch.eye(3)[2][: len(leaf), None, None] for name, leaf in leaves.items()}
    frame, along = Distribution({**rest, **flat}, parts=tuple(leaves)).sharing({**rest, **leaves})._frame()
    (frame * above).sum().backward()
    return {"frame": frame.detach(), "normal": None if along is None else along.detach()} | {f"of {n}": one.grad for n, one in leaves.items()}


@pytest.mark.parametrize("with_normal, with_rotation", [(True, True), (True, False), (False, True)])
def test_frames_and_their_gradients_are_those_of_plain_torch(with_normal, with_rotation, dtype):
    normal = hard_normals(dtype) if with_normal else None
    rotation = hard_rotations(dtype) if with_rotation else None
    above = torch.randn(3, 3, ROWS, COLUMNS, dtype=dtype)
    plain, found = on_both_roads(lambda: frame_and_pulls(normal, rotation, above))
    tolerance = 2e-6 if dtype == torch.float32 else 1e-14
    for name, expected in plain.items():
        if expected is None:
            assert found[name] is None
            continue
        # Gradients of short vectors are as large as these are short: each row has its own unit.
        unit = expected.abs().amax(dim=-1, keepdim=True).clamp(min=1e-300 if dtype == torch.float64 else 1e-37)
        if name == "of normal":  # 1 / (1 + z) is large near z = -1, and so is what rounding makes of it
            expected, found[name], unit = expected[..., 4:], found[name][..., 4:], expected[..., 4:].abs().amax(dim=-1, keepdim=True)
        assert torch.isfinite(found[name]).all() and float(((expected - found[name]).abs() / unit).max()) < 500 * tolerance, name


def test_frames_are_orthonormal(dtype):
    normal = hard_normals(dtype)
    normal[:, 0, 0], normal[:, 0, 1] = torch.tensor([0.0, 0, 1]), torch.tensor([1.0, 0, 0])
    rotation = hard_rotations(dtype)
    rotation[:, 0, 3] = torch.tensor([1.0, 0.0])
    frame = frame_and_pulls(normal, rotation, torch.zeros(3, 3, ROWS, COLUMNS, dtype=dtype))["frame"]
    product = torch.einsum("akij,alij->klij", frame, frame)
    assert float((product - torch.eye(3, dtype=dtype)[:, :, None, None]).abs().max()) < (1e-5 if dtype == torch.float32 else 1e-13)


@pytest.mark.parametrize("shape", [(2, 5, 7), (3, 2, 4, 1), (2, 1, 1)])
def test_normals_of_slopes_and_their_gradients(shape, dtype):
    slopes = torch.randn(shape, dtype=dtype) * 3
    slopes.view(-1)[0], slopes.view(-1)[1] = 0, 1e12
    above = torch.randn(*shape[:-3], 3, *shape[-2:], dtype=dtype)

    def made():
        leaf = slopes.clone().requires_grad_()
        found = normals_from_slopes(leaf)
        found.backward(above)
        return torch.cat((found.detach().flatten(), leaf.grad.flatten()))

    plain, found = on_both_roads(made)
    assert float((plain - found).abs().max()) < (2e-6 if dtype == torch.float32 else 1e-14)


def test_second_derivatives_go_by_plain_torch():
    slopes, weights = torch.randn(2, 3, 3, dtype=torch.float64), torch.randn(3, 3, 3, dtype=torch.float64)

    def twice():
        leaf = slopes.clone().requires_grad_()
        (once,) = torch.autograd.grad((normals_from_slopes(leaf) * weights).sum(), leaf, create_graph=True)
        return torch.autograd.grad(once.square().sum(), leaf)[0]

    plain, found = on_both_roads(twice)
    assert float((plain - found).abs().max()) < 1e-12 * float(plain.abs().max())


def test_what_is_undefined_stays_so():
    rotation = hard_rotations(torch.float32)
    rotation[0, 5, 5] = torch.nan
    frame = frame_and_pulls(hard_normals(torch.float32), rotation, torch.zeros(3, 3, ROWS, COLUMNS))["frame"]
    assert bool(frame[:, :2, 5, 5].isnan().all()) and int(frame.isnan().sum()) == 6
    slopes = torch.zeros(2, 2, 2)
    slopes[1, 0, 1] = torch.nan
    assert bool(normals_from_slopes(slopes.requires_grad_())[:, 0, 1].isnan().all())


def test_bits_do_not_depend_on_threads():
    normal, rotation = hard_normals(torch.float32), hard_rotations(torch.float32)
    above = torch.randn(3, 3, ROWS, COLUMNS)
    one, many = (with_threads(count, lambda: frame_and_pulls(normal, rotation, above)) for count in (1, 4))
    assert all(torch.equal(one[name], many[name]) for name in one)
