"""What becomes of pixels on the way in: crop, shrink, clipping, alpha, grey, and images that do not fit."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tests.btf.files import either_way, put_btf, put_image, put_manifest, random_codes, srgb_decoded
from tests.support import assert_close

from torchmat import DataError, RangeError, ShapeError, load_btf


def put_images(folder, *images: np.ndarray, suffix: str = "png"):
    names = [f"{number}.{suffix}" for number in range(len(images))]
    for name, pixels in zip(names, images, strict=True):
        put_image(folder / name, pixels)
    return put_manifest(folder, names)


def filled(value, dtype: str = "uint8", shape: tuple[int, ...] = (2, 2, 3)) -> np.ndarray:
    return np.full(shape, value, dtype)


@pytest.mark.parametrize("height, width", [(1, 1), (1, 9), (7, 1), (5, 3), (64, 32), (1, 4096)])
@pytest.mark.parametrize("dtype, suffix", [("uint8", "png"), ("float16", "exr")])
def test_every_size(tmp_path, height, width, dtype, suffix):
    images = [random_codes(seed, (height, width, 3), dtype) for seed in range(2)]
    btf = load_btf(put_images(tmp_path / "d", *images, suffix=suffix))
    assert (btf.height, btf.width, len(btf)) == (height, width, 2)
    expected = images[1].astype("float64").transpose(2, 0, 1)
    assert_close(btf.image(1), srgb_decoded(expected / 255) if dtype == "uint8" else expected, 1e-6)


def test_one_sample(tmp_path):
    btf = load_btf(put_images(tmp_path / "d", random_codes(0)))
    assert (len(btf), len(btf.lights), len(btf.views)) == (1, 1, 1)


def test_rows_run_down_and_channels_are_red_green_blue(tmp_path):
    pixels = filled(0, shape=(2, 3, 3))
    pixels[0, 2] = (255, 0, 0)
    pixels[1, 0] = (0, 0, 255)
    image = load_btf(put_images(tmp_path / "d", pixels)).image(0)
    assert image[0].tolist() == [[0, 0, 1], [0, 0, 0]]
    assert image[2].tolist() == [[0, 0, 0], [1, 0, 0]]


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32"])
def test_grey_is_three_equal_colours(tmp_path, dtype):
    grey = random_codes(0, (2, 3, 1), dtype)
    btf = load_btf(put_images(tmp_path / "d", grey, suffix="tif"), encoding="linear")
    full = np.iinfo(dtype).max if dtype.startswith("uint") else 1
    assert_close(btf.image(0), np.repeat(grey.astype("float64").transpose(2, 0, 1) / full, 3, axis=0), 1e-6)


@pytest.mark.parametrize("dtype, full", [("uint8", 255), ("uint16", 65535)])
def test_clipped_samples_are_flagged(tmp_path, dtype, full):
    first, second = filled(100, dtype), filled(full - 1, dtype)
    first[0, 1, 2] = first[1, 0, 0] = full
    btf = load_btf(put_images(tmp_path / "d", first, second), clipped_weight=0.25)
    assert btf.clipped([0, 1]).flatten().tolist() == [False, True, True, False] + [False] * 4
    assert btf.weights([0, 1]).flatten().tolist() == [1, 0.25, 0.25, 1] + [1] * 4
    assert (btf.clipped_share, btf.invalid_share) == (0.25, 0)
    assert float(btf.image(1).max()) < btf.clip_level < 1 == float(btf.image(0).max())
    assert btf.value_range[1] == 1


def test_floating_point_does_not_clip(tmp_path):
    btf = load_btf(put_images(tmp_path / "d", filled(1.0, "float32"), filled(7.0, "float32"), suffix="exr"))
    assert (btf.clipped_share, btf.clip_level, btf.value_range) == (0, float("inf"), (1.0, 7.0))


@pytest.mark.parametrize("channels", [2, 4])
@pytest.mark.parametrize(
    "dtype, full, suffix", [("uint8", 255, "png"), ("uint16", 65535, "png"), ("float32", 1, "exr")]
)
def test_alpha_is_a_weight(tmp_path, channels, dtype, full, suffix):
    pixels = random_codes(3, (1, 4, channels), dtype)
    pixels[0, 0, 0] = full  # clipped, and left out all the same
    pixels[0, :, -1] = [0, full * 0.4, full * 0.6, full]
    btf = load_btf(put_images(tmp_path / "d", pixels, suffix=suffix), encoding="linear", mask="none")
    assert btf.weight(0).flatten().tolist() == [0, 0, 1, 1]
    assert btf.invalid_share == 0.5
    colours = pixels[..., :-1].astype("float64").transpose(2, 0, 1) / full
    assert_close(btf.image(0), np.repeat(colours, 3 // len(colours), axis=0), 1e-6)


def holed(row: int, column: int, value: float) -> np.ndarray:
    pixels = filled(0.5, "float32", (3, 4, 3))
    pixels[row, column, 1] = value
    return pixels


@either_way
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_not_finite(tmp_path, pack, value):
    path = pack(put_images(tmp_path / "d", holed(0, 0, 0.5), holed(1, 3, value), suffix="exr"))
    with pytest.raises(DataError, match="1.exr: the image must be finite; 1 texels are .*, first at row 1, column 3"):
        load_btf(path)
    with pytest.raises(DataError, match="first at row 1, column 3"):
        load_btf(path, crop=(1, 2, 2, 2))
    assert len(load_btf(path, crop=(0, 0, 3, 3))) == 2
    btf = load_btf(path, invalid="mask")
    assert btf.weights([0, 1]).sum().item() == 23
    assert btf.weight(1)[0, 1, 3].item() == 0
    assert btf.image(1)[:, 1, 3].tolist() == [0, 0, 0]
    assert btf.value_range == (0, 0.5)


def test_not_finite_under_alpha_is_no_error(tmp_path):
    pixels = filled(1.0, "float32", (1, 2, 4))
    pixels[0, 0] = (np.nan, 1, 1, 0)
    btf = load_btf(put_images(tmp_path / "d", pixels, suffix="exr"))
    assert btf.weight(0).flatten().tolist() == [0, 1]
    assert bool(torch.isfinite(btf.image(0)).all())


def test_an_alpha_of_nan_counts_as_none(tmp_path):
    pixels = filled(1.0, "float32", (1, 2, 4))
    pixels[0, 0, 3] = np.nan
    assert load_btf(put_images(tmp_path / "d", pixels, suffix="exr")).weight(0).flatten().tolist() == [0, 1]


@either_way
@pytest.mark.parametrize(
    "odd, text",
    [
        (filled(1, shape=(2, 3, 3)), r"it is \(2, 3, 3\) uint8, the first image is \(2, 2, 3\) uint8"),
        (filled(1, shape=(2, 2, 1)), r"it is \(2, 2, 1\) uint8"),
        (filled(1, shape=(2, 2, 4)), r"it is \(2, 2, 4\) uint8"),
        (filled(1, "uint16"), r"it is \(2, 2, 3\) uint16"),
    ],
)
def test_images_that_differ(tmp_path, pack, odd, text):
    folder = put_images(tmp_path / "d", filled(1), filled(2), odd)
    expected = f"2.png: the image must match the others; {text}.*Bring all images to one size"
    with pytest.raises(ShapeError, match=expected):
        load_btf(pack(folder))


def test_more_channels_than_colours(tmp_path):
    with pytest.raises(DataError, match="0.exr: the channels must be Y, or R, G, B, or X, Y, Z, .*; they are .*'channel4'"):
        load_btf(put_images(tmp_path / "d", filled(1, "float32", (2, 2, 5)), suffix="exr"))


@either_way
@pytest.mark.parametrize("number", [0, 2])
@pytest.mark.parametrize("suffix, dtype", [("jpg", "uint8"), ("png", "uint8"), ("tif", "uint16"), ("exr", "float16")])
def test_truncated(tmp_path, pack, suffix, dtype, number):
    folder = put_images(tmp_path / "d", *[random_codes(seed, (40, 40, 3), dtype) for seed in range(3)], suffix=suffix)
    path = folder / f"{number}.{suffix}"
    path.write_bytes(path.read_bytes()[:-60])
    packed = pack(folder)
    expected = f": .*{number}.{suffix}: the image must be readable; .*Check that the file"
    with pytest.raises(DataError, match=expected) as caught:
        load_btf(packed)
    assert str(packed) in str(caught.value)
    assert "unzip" not in str(caught.value)


@either_way
def test_a_text_file_called_exr(tmp_path, pack):
    folder = put_images(tmp_path / "d", *[filled(1.0, "float16")] * 2, suffix="exr")
    (folder / "1.exr").write_text("this is not light")
    with pytest.raises(DataError, match="1.exr: the image must be readable"):
        load_btf(pack(folder))


def test_the_first_bad_image_is_named_whichever_thread_meets_it(tmp_path):
    names = [f"tl{n % 90:03d}_pl{n // 90:03d}_tv000_pv000.png" for n in range(1, 200) if n % 90]
    for name in names:
        put_image(tmp_path / "d" / name, filled(1))
    for name in (sorted(names)[70], sorted(names)[150]):
        (tmp_path / "d" / name).write_text("damaged")
    for _ in range(3):
        with pytest.raises(DataError, match=f"{sorted(names)[70]}: the image must be readable"):
            load_btf(tmp_path / "d")


# Crop and downscale.


def test_crop(tmp_path):
    pixels = random_codes(0, (5, 6, 3))
    btf = load_btf(put_images(tmp_path / "d", pixels), crop=(1, 2, 3, 4))
    assert_close(btf.image(0), srgb_decoded(pixels[1:4, 2:6].transpose(2, 0, 1) / 255), 1e-6)
    assert load_btf(tmp_path / "d", crop=[0, 0, 5, 6]).height == 5
    assert load_btf(tmp_path / "d", crop=np.array([4, 5, 1, 1])).image(0).shape == (3, 1, 1)


@pytest.mark.parametrize("crop", [(0, 0, 3, 2), (0, 0, 2, 3), (-1, 0, 1, 1), (0, -1, 1, 1), (0, 0, 0, 1), (2, 0, 1, 1)])
def test_crop_outside(tmp_path, crop):
    with pytest.raises(ShapeError, match="0.png: crop must lie inside the images; .*for 2 x 2. Move it"):
        load_btf(put_images(tmp_path / "d", filled(1)), crop=crop)


@pytest.mark.parametrize("crop, text", [((0, 0, 2), "it has 3 numbers"), ((0, 0, 1.5, 1), "whole number; it is 1.5")])
def test_crop_of_another_form(tmp_path, crop, text):
    with pytest.raises(RangeError, match=f"crop must be .*{text}"):
        load_btf(put_images(tmp_path / "d", filled(1)), crop=crop)


def test_downscale_averages_light_and_not_codes(tmp_path):
    pixels = np.array([[[0] * 3, [254] * 3], [[0] * 3, [0] * 3]], dtype=np.uint8)
    btf = load_btf(put_images(tmp_path / "d", pixels), downscale=2)
    # 254/255 decodes to 0.99110210; a quarter of it. The average of the codes would decode to 0.0508.
    assert_close(btf.image(0), torch.full((3, 1, 1), 0.99110210 / 4), 1e-6)
    assert (btf.stored_dtype, btf.encoding) == ("float32", "linear")
    linear = load_btf(tmp_path / "d", downscale=2, encoding="linear", exposure=0.5)
    assert_close(linear.image(0), torch.full((3, 1, 1), 254 / 255 / 4 / 0.5), 1e-6)


def test_downscale_after_crop_drops_what_is_left_over(tmp_path):
    values = np.arange(35, dtype=np.float32).reshape(5, 7, 1).repeat(3, axis=2)
    btf = load_btf(put_images(tmp_path / "d", values, suffix="exr"), crop=(1, 0, 4, 7), downscale=3)
    block = values[1:4, :, 0]
    assert_close(btf.image(0)[1], [[block[:, :3].mean(), block[:, 3:6].mean()]], 1e-6)


def test_downscale_keeps_the_worst_flag(tmp_path):
    pixels = filled(10, shape=(2, 6, 4))
    pixels[..., 3] = 255
    pixels[0, 0, :3] = 255  # clipped
    pixels[0, 2, :3], pixels[1, 3, 3] = 255, 0  # clipped and invalid
    btf = load_btf(put_images(tmp_path / "d", pixels), downscale=2, clipped_weight=0.5)
    assert btf.weight(0).flatten().tolist() == [0.5, 0, 1]
    assert btf.clipped([0]).flatten().tolist() == [True, False, False]
    assert 0.99 < btf.clip_level <= 1


@pytest.mark.parametrize("factor", [0, -1, 3])
def test_downscale_must_leave_a_texel(tmp_path, factor):
    with pytest.raises(ShapeError, match="0.png: downscale must be a whole number that leaves .*smaller"):
        load_btf(put_images(tmp_path / "d", filled(1)), downscale=factor)


@pytest.mark.parametrize("factor", [1.5, "2", None])
def test_downscale_must_be_whole(tmp_path, factor):
    with pytest.raises(RangeError, match="downscale must be a whole number; it is"):
        load_btf(put_images(tmp_path / "d", filled(1)), downscale=factor)


# A part of the directions.


def test_lights_and_views(tmp_path):
    put_btf(tmp_path / "d")
    whole = load_btf(tmp_path / "d")
    for option, directions in (("lights", whole.lights), ("views", whole.views)):
        for number, direction in enumerate(directions):
            part = load_btf(tmp_path / "d", **{option: [number]})
            rows = (whole.__getattribute__(option[:-1]) == direction).all(dim=1)
            assert torch.equal(part.__getattribute__(option[:-1]), direction.expand(len(part), 3))
            assert torch.equal(part.images(range(len(part))), whole.images(rows))
            assert part.source.files == tuple(np.array(whole.source.files)[rows.numpy()])
    assert len(load_btf(tmp_path / "d", lights=range(4), views=torch.tensor([0, 1, 2]))) == 4


def test_flags_follow_a_chosen_part(tmp_path):
    images = [filled(255 if seed == 2 else seed) for seed in range(4)]
    btf = load_btf(put_images(tmp_path / "d", *images), lights=[2])
    assert btf.source.files == ("2.png",)
    assert (btf.clipped_share, btf.value_range) == (1.0, (1.0, 1.0))


@pytest.mark.parametrize(
    "options, text",
    [
        ({"lights": [4]}, "lights must be numbers from 0 to 3; 4 is not. Leave the option out"),
        ({"views": [0, -1]}, "views must be numbers from 0 to 2; -1 is not"),
        ({"lights": []}, "lights must be numbers from 0 to 3; none is given"),
        ({"lights": [0.5]}, "lights must be a whole number; it is 0.5"),
        ({"lights": [True, False]}, "lights must be a whole number; it is True"),
        ({"lights": 2}, "lights must be a list of numbers; it is 2"),
        ({"lights": [0], "views": [2]}, "lights and views must leave at least one image; they leave none"),
    ],
)
def test_lights_and_views_refused(tmp_path, options, text):
    with pytest.raises(RangeError, match=text):
        load_btf(put_btf(tmp_path / "d"), **options)
