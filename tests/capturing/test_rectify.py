"""Photographs on texels: values where they belong, no aliasing however flat the view, and what is not seen is not valid."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tests.capturing.shots import Lamp, Lens, shots_around
from tests.capturing.simulated import Studio

from torchmat.capturing.board import Board
from torchmat.capturing.rectify import Grid, choose_grid, rectify
from torchmat.capturing.view import Camera, Pose
from torchmat.errors import RangeError

pytest.importorskip("cv2")
LENS, BOX = Lens((600, 400), 660.0), (-48.0, -48.0, 48.0, 48.0)
CAMERA = Camera(LENS.matrix, np.array(LENS.distortion), LENS.size)


def waves(light, view):
    """A matte sample with waves of 8 to 12 texels, other ones in each colour, and no symmetry."""
    row, column = torch.meshgrid(torch.arange(96.0), torch.arange(96.0), indexing="ij")
    phases = torch.stack((column / 8, row / 9 + column / 30, (row - column) / 12)) * 2 * torch.pi
    return (0.5 + 0.3 * torch.sin(phases) + 0.002 * column) * light[2:].clamp(min=0)


@pytest.fixture(scope="module")
def studio():
    return Studio(waves, lens=LENS, texels=(96, 96), extent=BOX, bits=16, supersampling=2)


@pytest.fixture(scope="module")
def taken(studio):
    return studio.take(shots_around([10, 60], [40, 200], 380, [Lamp((100, 150, 400)), Lamp((-50, 100, 400))], roll=90))


def pose_of(one):
    return Pose(one.shot.rotation, one.shot.translation)


@pytest.mark.parametrize("number", [0, 1])
def test_texels_have_the_values_that_the_material_has_there(studio, taken, number):
    one = taken[number]
    found = rectify(torch.from_numpy(one.pixels / np.float32(65535)).permute(2, 0, 1), CAMERA, pose_of(one), Grid(BOX, (96, 96)), studio.board)
    wanted = torch.from_numpy(one.value * one.irradiance * one.shot.exposure)
    inner = (slice(None), slice(2, -2), slice(2, -2))
    beside = (found.values - wanted)[inner]
    # Averages over texels and pixels lower waves of 8 texels by 4 to 8 %; a texel more to a side would make 0.25.
    assert float(beside.abs().max()) < 0.08 and float((beside**2).mean().sqrt()) < 0.025 and found.valid.all()
    pixels = np.abs(np.linalg.det(np.stack([studio.pixels_of(one.shot, np.array(at)) - studio.pixels_of(one.shot, np.zeros(3)) for at in ((1.0, 0, 0), (0, 1.0, 0))])))
    assert float(found.density[47:49, 47:49].mean()) == pytest.approx(pixels, rel=0.02)


def test_views_of_texels_are_those_of_the_studio(taken):
    views = np.moveaxis(pose_of(taken[1]).views(Grid(BOX, (96, 96)).points()), -1, 0)
    assert np.abs(views - taken[1].view).max() < 1e-6


@pytest.mark.parametrize("number", [0, 1])
def test_the_finest_pattern_of_a_photograph_does_not_alias(taken, number):
    rows, columns = np.indices(LENS.size[::-1])
    checks = torch.from_numpy(((rows + columns) % 2).astype(np.float32))[None]
    found = rectify(checks, CAMERA, pose_of(taken[number]), Grid(BOX, (12, 12)))
    assert float(found.density.min()) > 50 and float((found.values - 0.5).abs().max()) < 0.05


def test_an_affine_shift_moves_texels(taken):
    pixels = torch.from_numpy(taken[0].pixels / np.float32(65535)).permute(2, 0, 1)
    plain = rectify(pixels, CAMERA, pose_of(taken[0]), Grid(BOX, (96, 96)))
    moved = rectify(pixels, CAMERA, pose_of(taken[0]), Grid(BOX, (96, 96)), shift=np.array([[1.0, 0, 3], [0, 1, -2]]))
    assert (moved.values[:, 2:, :-3] - plain.values[:, :-2, 3:]).abs().max() < 2e-3


def test_what_lies_outside_the_picture_or_behind_a_sphere_is_not_valid(studio, taken):
    pixels = torch.zeros(1, *LENS.size[::-1])
    wide = rectify(pixels, CAMERA, pose_of(taken[0]), Grid((-200, -50, 200, 50), (10, 40)))
    assert not wide.valid[:, 0].any() and wide.valid[4:6, 19:21].all()
    near = Grid((60, 90, 70, 100), (4, 4))
    flat = shots_around([60], [90], 380, [Lamp((0, 0, 400))], roll=90)[0]  # from above the sphere at (64, 112)
    pose = Pose(flat.rotation, flat.translation)
    assert rectify(pixels, CAMERA, pose, near).valid.all() and not rectify(pixels, CAMERA, pose, near, Board()).valid.any()


def test_the_texels_size_is_the_photographs_or_the_given_one(taken):
    poses = [pose_of(taken[0])] * 2
    grid = choose_grid(Board(), [CAMERA] * 2, poses)
    assert grid.texel[0] == pytest.approx(grid.texel[1]) and grid.texel[0] == pytest.approx(380 / 660, rel=0.02)
    assert grid.box[2] == pytest.approx(54.5, abs=0.3)
    assert choose_grid(Board(), [CAMERA] * 2, poses, 0.5).shape == (218, 218)
    with pytest.raises(RangeError, match="10900 x 10900"):
        choose_grid(Board(), [CAMERA] * 2, poses, 0.01)


def test_texels_lie_in_the_box_row_0_at_the_top():
    points = Grid((0, 0, 4, 2), (2, 4), 1.5).points()
    assert points[0, 0] == pytest.approx([0.5, 1.5, 1.5]) and points[1, 3] == pytest.approx([3.5, 0.5, 1.5])
