"""Nine views over the hemisphere: each is `shade` at its pair, and its mark is where the specular map was looked up."""

from __future__ import annotations

import math

import pytest
import torch
from tests.models.distributions import distribution
from tests.support import assert_close

import torchmat as tm
from torchmat.cli import main
from torchmat.errors import RangeError
from torchmat.images import read_image
from torchmat.rendering.nine_views import AZIMUTHS_DEG, half_at, marks, nine_pairs, nine_views


def test_each_view_has_its_azimuths_and_the_polar_angles_that_were_chosen():
    light, view = nine_pairs(40, 70)
    for one, other, (azimuth, opposite) in zip(light, view, AZIMUTHS_DEG, strict=True):
        for direction, polar, turn in ((one, 40, azimuth), (other, 70, opposite)):
            polar, turn = math.radians(polar), math.radians(turn)
            expected = [math.sin(polar) * math.cos(turn), math.sin(polar) * math.sin(turn), math.cos(polar)]
            assert_close(direction, torch.tensor(expected, dtype=torch.float64))
    assert len({tuple(round(number, 6) for number in place) for place in marks(light, view).tolist()}) == 9
    assert_close(marks(*nine_pairs(0, 0)), torch.full((9, 2), 0.5, dtype=torch.float64))
    assert_close(marks(*nine_pairs(90, 90))[5], torch.tensor([1.0, 0.5], dtype=torch.float64))
    for wrong in (-1, 91, math.nan):
        with pytest.raises(RangeError, match="lie in \\[0, 90\\] degrees"):
            nine_pairs(30, wrong)


def test_a_place_in_the_map_is_shown_by_the_view_that_looks_along_it():
    places = torch.rand(50, 2, dtype=torch.float64) * 0.7 + 0.15
    half = half_at(places)
    assert_close(half.norm(dim=1), torch.ones(50, dtype=torch.float64))
    assert_close(marks(half, half), places)
    with pytest.raises(RangeError, match="lie in the disc; number 1 is"):
        half_at(torch.tensor([[0.5, 0.5], [0.01, 0.01]]))


def test_the_texel_under_a_mark_is_the_one_that_the_view_shows():
    material = distribution(2, 2, 1, ())
    light, view = (one.float() for one in nine_pairs(35, 50))
    place = marks(light, view)
    side = material.maps["specular"].shape[-1]
    for number in range(9):
        column, row = int(place[number, 0] * side), int((1 - place[number, 1]) * side)
        painted = torch.zeros_like(material.maps["specular"])
        painted[0, max(0, row - 1) : row + 2, max(0, column - 1) : column + 2] = 5.0
        lit = material.with_maps(specular=painted).shade(light[number, :, None, None], view[number, :, None, None])
        dark = material.with_maps(specular=torch.zeros_like(painted)).shade(light[number, :, None, None], view[number, :, None, None])
        change = (lit - dark).detach()
        assert float(change[0].min()) > 0.05 and not bool(change[1:].any())


def test_the_command_writes_the_sheet_and_says_the_marks(tmp_path, capsys):
    tm.save_material(distribution(4, 6, 1, ()), tmp_path / "wool")
    assert main(["render", str(tmp_path / "wool"), "--nine", "20", "40", "--exr"]) == 0
    said = capsys.readouterr().out
    assert said.count("half       ") == 9 and "light from 135, view from 135 degrees: u 0." in said
    sheet = torch.from_numpy(read_image(tmp_path / "wool" / "pictures" / "render_nine.exr")).permute(2, 0, 1).float()
    material = tm.load_material(tmp_path / "wool")
    light, view = (one.float()[:, :, None, None] for one in nine_pairs(20, 40))
    assert_close(nine_views(material, 20, 40), sheet, 1e-3)
    for number in range(9):
        row, column = divmod(number, 3)
        part = nine_views(material, 20, 40)[:, 4 * row : 4 * row + 4, 6 * column : 6 * column + 6]
        assert torch.equal(part, material.shade(light[number], view[number]).detach())
