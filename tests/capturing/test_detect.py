"""The board in photographs: corners where they are, turned any way, and a reason in words for what cannot be used."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import torch
from tests.capturing.bad_photographs import GOOD, KINDS, bad_photographs, photographs_of
from tests.capturing.shots import Lamp, Lens, shots_around
from tests.capturing.simulated import Studio, matte_grey

from torchmat.capturing.board import Board
from torchmat.capturing.detect import detect
from torchmat.colour import srgb_to_linear

pytest.importorskip("cv2")
SMALL = Lens((720, 480), 800.0)


def linear_of(pixels):
    return srgb_to_linear(torch.from_numpy(pixels).permute(2, 0, 1).float() / 255)


@pytest.fixture(scope="module")
def good():
    return photographs_of(Board(), SMALL, 1)


@pytest.fixture(scope="module")
def other():
    return photographs_of(Board(series=3), SMALL, 1)


@pytest.mark.parametrize(("polar", "roll", "least"), [(0, 90, 52), (40, 270, 45), (60, 90, 30)])
def test_corners_are_found_to_a_fraction_of_a_pixel(polar, roll, least):
    studio = Studio(matte_grey(0.4), lens=SMALL, texels=(4, 4), full_well=20000)
    taken = studio.one(shots_around([polar], [30], 400, [Lamp((200, 150, 400))], roll=roll)[0])
    found = detect(studio.board, linear_of(taken.pixels))
    assert found.reason == "" and len(found.corners) >= least and 0.3 < found.blur < 1
    truth = studio.pixels_of(taken.shot, np.c_[studio.board.corners, np.zeros(54)])[found.corners]
    # 0.12 to 0.3 pixels rms were measured: four rays a pixel make the edges, and squares have 37 pixels, or 18 at 60 degrees.
    assert np.sqrt(((found.pixels - truth) ** 2).sum(1).mean()) < 0.35
    assert np.abs(found.pixels - truth).max() < 1.2


def test_a_board_upside_down_has_the_same_corners(good):
    upright, turned = (detect(Board(), torch.from_numpy(picture.copy()).permute(2, 0, 1)) for picture in (good[0], good[0][::-1, ::-1]))
    both = np.intersect1d(upright.corners, turned.corners)
    there = [one.pixels[np.isin(one.corners, both)] for one in (upright, turned)]
    assert len(both) > 45 and np.abs(there[0] + there[1] - (719, 479)).max() < 0.1


def test_each_bad_photograph_is_told_by_its_reason(good, other):
    assert {word for word, _ in KINDS.values()} >= {GOOD, "no board", "blurred", "glare"}
    found = {name: (word, detect(Board(), linear_of(pixels)).reason) for name, word, pixels in itertools.islice(bad_photographs(good, other), len(KINDS))}
    assert {name: reason for name, (word, reason) in found.items() if not reason.startswith(word) or bool(word) != bool(reason)} == {}


@pytest.mark.parametrize("picture", [torch.zeros(3, 8, 8), torch.full((3, 90, 90), float("nan")), torch.zeros(3, 480, 720), torch.ones(3, 480, 720)])
def test_no_picture_is_an_exception(picture):
    assert detect(Board(), picture).reason
