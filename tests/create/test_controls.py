"""The artist's controls: known values, neutral settings, directions and hues, segments."""

from __future__ import annotations

import math

import pytest
import torch
from tests.support import assert_close

from torchmat.create.controls import (
    brightness_contrast,
    constant_rotation,
    darkened,
    draw_360,
    hue_to_rotation,
    rotation_to_hue,
    segments,
)
from torchmat.errors import RangeError, ShapeError

DARK, BRIGHT = (0.1, 0.02, 0.02), (0.3, 0.6, 0.9)


def two_colours(height: int = 6, width: int = 5) -> tuple[torch.Tensor, torch.Tensor]:
    """Return a picture of two colours and where the bright one is, [H, W]."""
    bright = torch.rand(height, width) < 0.4
    bright[0, 0], bright[-1, -1] = True, False
    picture = torch.where(bright, torch.tensor(BRIGHT)[:, None, None], torch.tensor(DARK)[:, None, None])
    return picture, bright


def test_neutral_brightness_and_contrast_leave_values_alone():
    grey = torch.cat((torch.rand(1, 40, 50), torch.tensor([0.0, 1.0, 1e-8]).expand(1, 40, 3)), dim=2)
    assert torch.equal(brightness_contrast(grey), grey)


def test_brightness_and_contrast_by_hand():
    grey = torch.tensor([[[0.0, 0.25, 0.5, 1.0]]])
    assert_close(brightness_contrast(grey, contrast=2.0), torch.tensor([[[0.0, 0.0, 0.5, 1.0]]]))
    assert_close(brightness_contrast(grey, contrast=0.5), torch.tensor([[[0.25, 0.375, 0.5, 0.75]]]))
    assert_close(brightness_contrast(grey, brightness=0.3), torch.tensor([[[0.3, 0.55, 0.8, 1.0]]]))
    assert_close(brightness_contrast(grey, contrast=0.0, brightness=-0.4), torch.full((1, 1, 4), 0.1), 1e-6)
    assert_close(brightness_contrast(grey, contrast=-1.0), 1 - grey)


@pytest.mark.parametrize(("brightness", "contrast"), [(9.0, 1.0), (-9.0, 1.0), (0.3, 50.0), (0.0, -3.0)])
def test_the_result_stays_within_0_and_1(brightness, contrast):
    found = brightness_contrast(torch.rand(1, 9, 9) * 3, brightness, contrast)
    assert float(found.min()) >= 0 and float(found.max()) <= 1


def test_darkened_by_hand():
    picture = torch.rand(3, 2, 3)
    assert torch.equal(darkened(picture, 0.0), picture)
    assert_close(darkened(picture, 0.25), picture * 0.75)
    for share in (-0.1, 1.1, math.nan):
        with pytest.raises(RangeError, match="darken"):
            darkened(picture, share)


def test_two_colours_are_found_from_dark_to_bright():
    picture, bright = two_colours()
    found = segments(picture, 2)
    assert torch.equal(found[1], bright.float()) and torch.equal(found[0], 1 - bright.float())


def test_soft_segments_sum_to_1_and_fall_off_as_they_should():
    picture = torch.rand(3, 12, 9)
    found = segments(picture, 3, softness=15.0)
    assert_close(found.sum(dim=0), torch.ones(12, 9), 1e-6)
    assert float(found.min()) >= 0 and bool(((found > 0.05) & (found < 0.95)).any())
    assert torch.equal(found.argmax(dim=0), segments(picture, 3).argmax(dim=0))
    # Far apart colours belong to themselves however soft; half-way between two the weights are equal.
    pair, bright = two_colours()
    assert_close(segments(pair, 2, softness=5.0)[1], bright.float(), 1e-6)


def test_one_segment_is_everywhere():
    assert torch.equal(segments(torch.rand(3, 4, 5), 1), torch.ones(1, 4, 5))


def test_segments_are_what_the_seed_says():
    picture = torch.rand(3, 30, 30)
    assert torch.equal(segments(picture, 4, seed=5), segments(picture, 4, seed=5))


def test_more_segments_than_colours_are_refused():
    with pytest.raises(RangeError, match="at most the 2 colours there are"):
        segments(two_colours()[0], 3)
    with pytest.raises(RangeError, match="at most the 1 colours"):
        segments(torch.ones(3, 1, 1), 2)


@pytest.mark.parametrize("settings", [{"count": 0}, {"count": 1.5}, {"softness": -1.0}, {"softness": 1e-300}, {"softness": math.nan}])
def test_segments_refuse_what_makes_no_sense(settings):
    with pytest.raises(RangeError, match=next(iter(settings))):
        segments(torch.rand(3, 4, 4), **{"count": 2, **settings})


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (9, 1), (6, 10), (8, 8)])
@pytest.mark.parametrize("centre", [(0.5, 0.5), (0.1, 0.8), (-0.3, 1.6)])
def test_draw_360_is_the_azimuth_about_its_centre(size, centre):
    found = draw_360(size, [centre])
    height, width = size
    assert found.shape == (2, height, width)
    for row in range(height):
        for column in range(width):
            # In texels: right of the centre is 0, above it a quarter turn.
            x = column + 0.5 - centre[0] * width
            y = (height - row - 0.5) - centre[1] * height
            angle = 0.0 if math.hypot(x, y) < 1e-9 else math.atan2(y, x)
            assert float(found[0, row, column]) == pytest.approx(math.cos(angle), abs=1e-6)
            assert float(found[1, row, column]) == pytest.approx(math.sin(angle), abs=1e-6)


def test_draw_360_takes_the_nearest_of_several_centres():
    found = draw_360((4, 20), [(0.25, 0.5), (0.75, 0.5)])
    assert torch.equal(found[..., :10], draw_360((4, 20), [(0.25, 0.5)])[..., :10])
    assert torch.equal(found[..., 10:], draw_360((4, 20), [(0.75, 0.5)])[..., 10:])


def test_directions_are_unit_vectors():
    for found in (draw_360((33, 17), [(0.5, 0.5), (0.2, 0.9)]), constant_rotation((3, 4), 2.0)):
        assert_close(found.norm(dim=0), torch.ones(found.shape[1:]), 1e-6)
    assert_close(constant_rotation((1, 2), math.pi / 6)[:, 0, 1], torch.tensor([math.sqrt(0.75), 0.5]))


def test_hues_by_hand():
    quarters = torch.tensor([[[1.0, -0.5, -0.5, -1.0]], [[0.0, math.sqrt(0.75), -math.sqrt(0.75), 0.0]]])
    wanted = torch.tensor([[[1.0, 0, 0, 0]], [[0.0, 1, 0, 1]], [[0.0, 0, 1, 1]]])  # red, green, blue, cyan
    assert_close(rotation_to_hue(quarters), wanted, 1e-6)
    assert_close(rotation_to_hue(quarters * 7), wanted, 1e-6)


def test_every_angle_comes_back_from_its_hue(dtype):
    angle = torch.linspace(-math.pi, 3 * math.pi, 1441, dtype=dtype)[None]
    rotation = torch.stack((torch.cos(angle), torch.sin(angle)))
    picture = rotation_to_hue(rotation)
    assert float(picture.min()) >= 0 and float(picture.max()) <= 1
    # kornia's saturation has an eps, hue none: the error is rounding.
    assert_close(hue_to_rotation(picture), rotation, 2e-6 if dtype == torch.float32 else 1e-12)
    eight_bit = (picture * 255).round() / 255
    assert float((hue_to_rotation(eight_bit) - rotation).norm(dim=0).max()) < math.radians(60) / 255
    assert_close(hue_to_rotation(0.3 + 0.4 * picture), rotation, 1e-5)  # paler and darker: the same hue


def test_a_grey_texel_has_no_hue():
    picture = rotation_to_hue(constant_rotation((2, 3), 1.0))
    picture[:, 1, 2] = 0.4
    with pytest.raises(RangeError, match=r"1 of 6 texels are grey, first at \(1, 2\)"):
        hue_to_rotation(picture)


@pytest.mark.parametrize("centres", [[], [(0.5,)], [(0.5, math.nan)], [(0.1, 0.2, 0.3)]])
def test_centres_that_are_none_are_refused(centres):
    with pytest.raises(RangeError, match="centres"):
        draw_360((4, 4), centres)


def test_bad_pictures_are_refused():
    bad = torch.rand(3, 4, 4)
    bad[1, 2, 3] = math.nan
    for function in (darkened, hue_to_rotation, lambda picture: segments(picture, 2)):
        with pytest.raises(RangeError, match=r"1 of 48 values are NaN or Inf, first at index \(1, 2, 3\)"):
            function(bad)
        with pytest.raises(RangeError, match="not be negative"):
            function(torch.full((3, 2, 2), -0.1))
        for shape in ((1, 4, 4), (3, 4), (3, 0, 4)):
            with pytest.raises(ShapeError, match=r"be \[3, H, W\]"):
                function(torch.rand(shape))
        with pytest.raises(RangeError, match="floating-point"):
            function(torch.ones(3, 2, 2, dtype=torch.uint8))
    with pytest.raises(RangeError, match="finite"):
        brightness_contrast(bad[:1] * math.nan)
    with pytest.raises(RangeError, match="contrast"):
        brightness_contrast(bad[:1], contrast=math.inf)
    with pytest.raises(ShapeError, match="rotation"):
        rotation_to_hue(torch.ones(3, 2, 2))
    with pytest.raises(RangeError, match="angle"):
        constant_rotation((2, 2), math.nan)
