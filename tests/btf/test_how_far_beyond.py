"""How far directions lie outside of the known ones: by an outline, as by the triangles."""

from __future__ import annotations

import pytest
import torch

from torchmat.btf.neighbours import Triangulation, how_far_beyond


def _directions(count: int, most: float, seed: int) -> torch.Tensor:
    random = torch.rand(count, 2, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    polar, azimuth = most * random[:, 0], 6.2832 * random[:, 1]
    return torch.stack((polar.sin() * azimuth.cos(), polar.sin() * azimuth.sin(), polar.cos()), dim=1)


@pytest.mark.parametrize("count", [1, 2, 3, 4, 50])
def test_it_is_what_the_triangles_say(count):
    known, wanted = _directions(count, 1.0, 0), _directions(300, 1.5, 1)
    found, said = how_far_beyond(known, wanted), Triangulation(known).find(wanted).beyond
    assert float((found - said).abs().max()) < 1e-12
    assert bool((found > 0.02).any()) and (count < 4 or bool((found == 0).any()))


def test_known_ones_that_repeat_or_stand_in_a_line_enclose_as_much():
    known, wanted = _directions(30, 1.0, 2), _directions(300, 1.5, 3)
    assert torch.equal(how_far_beyond(torch.cat((known, known)), wanted), how_far_beyond(known, wanted))
    polar = torch.linspace(-1, 1, 9, dtype=torch.float64)
    arc = torch.stack((polar.sin(), torch.zeros(9, dtype=torch.float64), polar.cos()), dim=1)
    found, said = how_far_beyond(arc, wanted), Triangulation(arc).find(wanted).beyond
    assert float((found - said).abs().max()) < 1e-12 and float(how_far_beyond(arc, arc).max()) < 1e-12


def test_a_corner_itself_is_not_beyond():
    known = _directions(40, 1.2, 4)
    assert float(how_far_beyond(known, known).max()) < 1e-12
