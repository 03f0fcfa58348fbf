"""Colour by a chart: its reference by what is published, and matrices that are known."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
import tyro

from torchmat.capturing.chart import _LAB, NAMES, Patches, colour_of_chart, find_chart, fit_colour, read_chart, reference_colours
from torchmat.cli.capture import Capture
from torchmat.errors import DataError, ShapeError
from torchmat.images import write_image

# A camera that mixes channels; its rows, as those of a camera after white balance, sum to 1.
MIX = np.array([[0.80, 0.15, 0.05], [0.10, 0.75, 0.15], [0.02, 0.20, 0.78]])
GAINS = np.array([0.5, 0.9, 0.7])


def patches(colours, **fields):
    given = {"clipped": np.zeros(24, bool), "uneven": np.zeros(24)} | fields
    return Patches(colours, **given)


def painted(colours, corners, size=(240, 320), cell=30, jitter=0.0):
    """Paint a chart as a photograph [3, H, W]: patches with dark gaps, in the homography of `corners` by OpenCV."""
    cv2 = pytest.importorskip("cv2")
    flat = np.full((4 * cell, 6 * cell, 3), 0.02, np.float32)
    for number, colour in enumerate(colours):
        row, column = divmod(number, 6)
        flat[row * cell + 3 : (row + 1) * cell - 3, column * cell + 3 : (column + 1) * cell - 3] = colour
    middles = np.array([[cell / 2, cell / 2], [5.5 * cell, cell / 2], [5.5 * cell, 3.5 * cell], [cell / 2, 3.5 * cell]], np.float32) - 0.5
    turn = cv2.getPerspectiveTransform(middles, np.asarray(corners, np.float32))
    picture = cv2.warpPerspective(flat, turn, size[::-1], flags=cv2.INTER_AREA, borderValue=(0.05, 0.05, 0.05))
    return torch.from_numpy(np.ascontiguousarray(picture.transpose(2, 0, 1)))


CORNERS = np.array([[60, 50], [260, 70], [250, 190], [70, 180]], float)


def test_reference_colours_are_what_littlecms_makes_of_the_lab_values():
    from PIL import Image, ImageCms

    # 8 bits of Lab: L* of 255 levels, a* and b* whole numbers, signed.
    codes = np.round(_LAB * [2.55, 1, 1]).astype(int) % 256
    picture = Image.frombytes("LAB", (24, 1), codes.astype(np.uint8).tobytes())
    turn = ImageCms.buildTransform(ImageCms.createProfile("LAB"), ImageCms.createProfile("sRGB"), "LAB", "RGB")
    expected = np.asarray(ImageCms.applyTransform(picture, turn))[0]
    encoded = np.clip(reference_colours(), 0, 1)
    encoded = np.where(encoded <= 0.0031308, 12.92 * encoded, 1.055 * encoded ** (1 / 2.4) - 0.055)
    assert np.abs(encoded * 255 - expected).max() < 4.5  # half a unit of Lab, which is most in the dark blue


def test_the_matrix_of_a_known_camera_is_found_and_white_stays_white():
    camera = np.linalg.inv(MIX)
    found = fit_colour(patches(reference_colours() @ camera.T * GAINS * 0.8))
    assert found.matrix == pytest.approx(MIX, abs=5e-3) and found.matrix.sum(1) == pytest.approx(np.ones(3))
    assert found.mean < 0.2 < found.before and found.largest < 0.5 and found.notes == ()


def test_noise_and_a_clipped_patch_do_little():
    random = np.random.default_rng(1)
    colours = reference_colours() @ np.linalg.inv(MIX).T * (1 + 0.02 * random.standard_normal((24, 3)))
    clipped = np.arange(24) == 18
    colours[18] = 0.7
    found = fit_colour(patches(colours, clipped=clipped))
    assert found.mean < 2 and found.matrix == pytest.approx(MIX, abs=0.08) and "'white' is clipped" in found.notes[0]


@pytest.mark.parametrize(
    ("order", "fields", "expected"),
    [(np.arange(24)[::-1], {}, "start at dark skin; turned by 180 degrees"), (np.arange(24).reshape(4, 6)[:, ::-1].ravel(), {}, "start at dark skin; mirrored"),
     (np.arange(24), {"clipped": np.arange(24) < 3}, "not be clipped; 3 are: dark skin, light skin, blue sky"),
     (np.roll(np.arange(24), 7), {}, "fit within 6")],
    ids=["turned", "mirrored", "clipped", "another chart"],
)
def test_bad_charts_are_refused(order, fields, expected):
    with pytest.raises(DataError, match=expected):
        fit_colour(patches(reference_colours()[order] * 0.8, **fields))


def test_patches_are_read_in_perspective_by_four_corners():
    true = np.clip(reference_colours(), 0, 1)
    linear = painted(true, CORNERS)
    found = read_chart(linear, linear.amin(0) > 0.85, CORNERS)
    assert found.colours == pytest.approx(true, abs=0.01) and found.uneven.max() < 0.1
    assert [name for name, clipped in zip(NAMES, found.clipped, strict=True) if clipped] == ["white"]
    assert fit_colour(found).mean < 0.5
    with pytest.raises(DataError, match="lie in its photograph"):
        read_chart(linear, linear.amax(0) > 2, CORNERS * 2)
    with pytest.raises(DataError, match="span a quadrilateral|lie in its photograph"):
        read_chart(linear, linear.amax(0) > 2, np.ones((4, 2)) * 5)
    with pytest.raises(ShapeError, match="be four points"):
        read_chart(linear, linear.amax(0) > 2, CORNERS[:3])


def test_a_file_and_its_corners_as_the_command_has_them(tmp_path):
    def of(options):
        return colour_of_chart(options.chart, options.chart_corners, options.encoding)

    linear = painted(np.clip(reference_colours(), 0, 1) * 0.8, CORNERS)
    write_image(tmp_path / "chart.tif", np.ascontiguousarray((linear.permute(1, 2, 0).clamp(0, 1) * 65535).round().numpy().astype(np.uint16)))
    read = tyro.cli(Capture, args=["x", "--chart", str(tmp_path / "chart.tif"), "--encoding", "linear", "--chart-corners", *map(str, CORNERS.ravel())])
    assert of(read.light()).mean < 0.5
    turned = dataclasses.replace(read.light(), chart_corners=CORNERS[[2, 3, 0, 1]])
    with pytest.raises(DataError, match=r"chart.tif: .*the chart's corners must start at dark skin.*turned by 180 degrees"):
        of(turned)
    write_image(tmp_path / "chart.tif", np.full((60, 80, 3), 20000, np.uint16))
    with pytest.raises(DataError, match=r"chart.tif: .*the chart must be found.*--chart-corners"):
        of(dataclasses.replace(read.light(), chart_corners=None))


def test_a_photograph_without_a_chart_is_named():
    pytest.importorskip("cv2")
    with pytest.raises(DataError, match="the chart must be found"):
        find_chart(torch.full((3, 60, 80), 0.3))


def test_a_chart_is_found_by_opencv():
    cv2 = pytest.importorskip("cv2")
    if not hasattr(cv2, "mcc"):
        pytest.skip("this OpenCV has no search for charts")
    corners = np.array([[180, 140], [640, 160], [630, 450], [170, 440]], float)
    linear = painted(np.clip(reference_colours(), 0, 1), corners, (600, 800), 60)
    assert np.abs(find_chart(linear) - corners).max() < 6
