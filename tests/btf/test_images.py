"""Files of pixels: in and out unchanged, or an error that names the file."""

from __future__ import annotations

import numpy as np
import pytest
from tests.btf.files import get_image, put_image, random_codes

from torchmat import DataError, ShapeError
from torchmat.images import read_image, write_image


@pytest.mark.parametrize("channels", [1, 2, 3, 4])
@pytest.mark.parametrize(
    "suffix, dtype",
    [("png", "uint8"), ("png", "uint16"), ("tif", "uint8"), ("tif", "uint16"), ("tif", "float32"), ("exr", "float16"),
     ("exr", "float32")],
)
def test_round_trip(tmp_path, suffix, dtype, channels):
    pixels = random_codes(channels, (3, 5, channels), dtype)
    write_image(tmp_path / f"a.{suffix}", pixels)
    again = read_image(tmp_path / f"a.{suffix}")
    assert again.dtype == pixels.dtype
    assert np.array_equal(again, pixels)


@pytest.mark.parametrize("count", [5, 11, 54])
def test_channels_come_back_in_the_order_of_their_numbers(count, tmp_path):
    # Sorted as texts, channel10 stands before channel4: tables of eleven columns and more came back permuted.
    pixels = np.random.default_rng(0).random((2, 3, count), dtype=np.float32)
    write_image(tmp_path / "a.exr", pixels)
    assert np.array_equal(read_image(tmp_path / "a.exr"), pixels)


@pytest.mark.parametrize("suffix", ["png", "tif"])
def test_alpha_leaves_colours_alone(tmp_path, suffix):
    pixels = np.full((1, 2, 4), 200, dtype=np.uint8)
    pixels[..., 3] = [[0, 100]]
    put_image(tmp_path / f"a.{suffix}", pixels)
    assert np.array_equal(read_image(tmp_path / f"a.{suffix}"), pixels)


def test_a_plane_is_one_channel(tmp_path):
    plane = random_codes(0, (4, 3))
    write_image(tmp_path / "a.png", plane)
    assert np.array_equal(get_image(tmp_path / "a.png"), plane[:, :, None])
    assert read_image(tmp_path / "a.png").shape == (4, 3, 1)


@pytest.mark.parametrize("height, width", [(1, 1), (1, 4096), (4096, 1), (7, 13)])
def test_every_size(tmp_path, height, width):
    pixels = random_codes(1, (height, width, 3))
    write_image(tmp_path / "a.png", pixels)
    assert np.array_equal(read_image(tmp_path / "a.png"), pixels)


def test_names_with_spaces_and_letters_from_everywhere(tmp_path):
    path = tmp_path / "Stoff ä 布 #1.png"
    write_image(path, random_codes(0))
    assert np.array_equal(read_image(path), random_codes(0))


def test_content_decides_where_the_suffix_lies(tmp_path):
    put_image(tmp_path / "a.png", random_codes(0))
    (tmp_path / "a.png").rename(tmp_path / "a.exr")
    assert np.array_equal(read_image(tmp_path / "a.exr"), random_codes(0))


def test_channel_names(tmp_path):
    write_image(tmp_path / "a.exr", random_codes(0, (2, 2, 3), "float32"), ("X", "Y", "Z"))
    assert b"X\0" in (tmp_path / "a.exr").read_bytes()[:400]


@pytest.mark.parametrize("share", [0.0, 0.02, 0.5, 0.9, 0.97])
@pytest.mark.parametrize(
    "suffix, dtype", [("jpg", "uint8"), ("png", "uint8"), ("png", "uint16"), ("tif", "float32"), ("exr", "float16")]
)
def test_truncated(tmp_path, suffix, dtype, share):
    path = put_image(tmp_path / f"a.{suffix}", random_codes(0, (48, 48, 3), dtype))
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(DataError, match=f"a.{suffix}: the image must be readable; .*Check that the file is complete"):
        read_image(path)


@pytest.mark.parametrize("suffix", ["exr", "png", "jpg", "tif", "hdr", "bmp", "tga", "ppm"])
def test_a_text_file_is_no_image(tmp_path, suffix):
    path = tmp_path / f"notes.{suffix}"
    path.write_text("polar angles were measured by hand\n" * 20)
    with pytest.raises(DataError, match=f"notes.{suffix}: the image must be readable"):
        read_image(path)


def test_nothing_and_a_folder_are_no_images(tmp_path):
    for path in (tmp_path / "none.png", tmp_path):
        with pytest.raises(DataError, match=path.name):
            read_image(path)


@pytest.mark.parametrize("name", ["a\0.png", "\udcff.png"])
def test_names_that_no_file_can_have(tmp_path, name):
    for call in (lambda: read_image(tmp_path / name), lambda: write_image(tmp_path / name, random_codes(0))):
        with pytest.raises(DataError, match="the file name must be valid UTF-8"):
            call()


@pytest.mark.parametrize(
    "name, dtype, shape",
    [("a.png", "float32", (2, 2, 3)), ("a.jpg", "uint16", (2, 2, 3)), ("a.exr", "uint8", (2, 2, 3)),
     ("a.bmp", "float32", (2, 2, 3)), ("a.jpg", "uint8", (2, 2, 2))],
)
def test_no_silent_change_of_type_or_channels(tmp_path, name, dtype, shape):
    with pytest.raises(DataError, match=f"{name}: the suffix must name a format for {shape[2]} channels.*Use .exr"):
        write_image(tmp_path / name, random_codes(0, shape, dtype))
    assert list(tmp_path.glob("a.*")) == []


def test_unwritable(tmp_path):
    with pytest.raises(DataError, match="none/a.png: the image must be writable.*Check that the folder exists"):
        write_image(tmp_path / "none" / "a.png", random_codes(0))
    with pytest.raises(DataError, match="a.xyz: the suffix must name a writable image format"):
        write_image(tmp_path / "a.xyz", random_codes(0))


@pytest.mark.parametrize("pixels", [np.zeros((2, 2, 3)), np.zeros(3, np.uint8), np.zeros((2, 2, 3), np.int32)])
def test_what_is_no_image(tmp_path, pixels):
    with pytest.raises(ShapeError, match="a.png: pixels must be"):
        write_image(tmp_path / "a.png", pixels)
