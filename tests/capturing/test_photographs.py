"""What files say of how photographs were taken, and the frame of the sensor."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tests.capturing.shots import Lamp, Shot
from tests.capturing.simulated import Taken, write

from torchmat.capturing.photographs import grey_codes, photograph, turned_alike
from torchmat.errors import DataError
from torchmat.images import write_image

SAID = {
    "Make": "Maker", "Model": "M 1", "Exif:FocalLength": 26.0, "Exif:FocalLengthIn35mmFilm": 52, "ExposureTime": 0.02, "FNumber": 8.0,
    "Exif:PhotographicSensitivity": 200,
}


def files(folder, suffix, exif):
    pixels = np.zeros((4, 6, 3), np.uint8)
    pixels[0, 0] = 255
    nothing = np.zeros((3, 1, 1), np.float32)
    return write(folder, [Taken(Shot((0, 0, 1), Lamp((0, 0, 1))), pixels, pixels, nothing, nothing, nothing, nothing)], suffix, exif)[0]


def test_camera_and_exposure_are_read(tmp_path):
    found = photograph(files(tmp_path, ".jpg", SAID)).exif
    assert (found.camera, found.focal, found.focal_35, found.aperture, found.iso) == ("Maker M 1", 26.0, 52.0, 8.0, 200.0)
    assert found.exposure == pytest.approx(0.02, rel=1e-3) and found.size == (6, 4)


def test_what_is_not_said_is_none(tmp_path):
    found = photograph(files(tmp_path, ".png", {})).exif
    assert found.camera == "" and [found.focal, found.focal_35, found.exposure, found.aperture, found.iso] == [None] * 5


@pytest.mark.parametrize(("orientation", "turns"), [(1, 0), (3, 2), (6, 1), (8, 3)])
def test_pixels_are_in_the_frame_of_the_sensor_however_the_camera_was_held(tmp_path, orientation, turns):
    one = photograph(files(tmp_path, ".png", {"Orientation": orientation}))
    assert one.turns == turns and one.size == (6, 4)
    pixels = one.linear()
    assert pixels.shape == (3, 4, 6) and pixels[0, 0, 0] == 1 and pixels.sum() == 3


def test_an_upright_file_among_others_lies_as_they_do(tmp_path):
    write_image(tmp_path / "upright.png", np.zeros((6, 4, 3), np.uint8))
    paths = [files(tmp_path / name, ".png", {}) for name in "ab"]
    found = turned_alike([photograph(path) for path in (tmp_path / "upright.png", *paths)])
    assert [one.size for one in found] == [(6, 4)] * 3 and [one.turns for one in found] == [1, 0, 0]
    assert found[0].linear().shape == (3, 4, 6)


def test_dark_pictures_are_brightened_to_find_a_board_and_bright_ones_are_left():
    ramp = torch.linspace(0, 1, 100).expand(3, 50, 100)
    assert grey_codes(ramp)[0, 50] == round((50 / 99) ** (1 / 2.2) * 255)
    assert np.abs(grey_codes(ramp * 0.01).astype(int) - grey_codes(ramp * 0.1)).max() <= 1 and grey_codes(ramp * 0.01).max() > 220
    assert grey_codes(torch.zeros(3, 4, 4)).max() == 0


def test_a_file_that_is_no_photograph_is_named(tmp_path):
    (tmp_path / "x.jpg").write_bytes(b"no")
    with pytest.raises(DataError, match="x.jpg"):
        photograph(tmp_path / "x.jpg")
