"""ICC profiles against LittleCMS, and the EXIF orientation against OpenImageIO."""

from __future__ import annotations

import io
import struct

import numpy as np
import OpenImageIO as oiio
import pytest
from PIL import Image, ImageCms
from tests.btf.files import put_image, random_codes, srgb_decoded

from torchmat import DataError, load_btf
from torchmat.btf.photographs import read_linear
from torchmat.icc import converted, read_profile
from torchmat.images import read_image

ADOBE = np.array([[0.60974, 0.20528, 0.14919], [0.31111, 0.62567, 0.06322], [0.01947, 0.06087, 0.74457]])
SRGB = np.array([[0.43607, 0.38515, 0.14307], [0.22249, 0.71687, 0.06061], [0.01392, 0.09708, 0.71410]])
SRGB_CURVE = struct.pack(">4sIHH5i", b"para", 0, 3, 0, *(round(v * 65536) for v in (2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045)))


def gamma(value: float) -> bytes:
    return struct.pack(">4sIIH", b"curv", 0, 1, round(value * 256)) + b"\0\0"


def profile(to_xyz=ADOBE, curve=gamma(2.19921875), space=b"RGB ", name="Adobe RGB (1998)", leave=()) -> bytes:
    """Build a display profile of version 2 from its primaries and one curve."""
    xyz = {sign: struct.pack(">4sI3i", b"XYZ ", 0, *(round(v * 65536) for v in column)) for sign, column in
           zip((b"rXYZ", b"gXYZ", b"bXYZ"), to_xyz.T, strict=True)}
    tags = {b"desc": struct.pack(">4sII", b"desc", 0, len(name) + 1) + name.encode() + b"\0" + bytes(78),
            b"wtpt": struct.pack(">4sI3i", b"XYZ ", 0, 63190, 65536, 54061), b"cprt": b"text\0\0\0\0none\0"}
    tags |= {b"kTRC": curve} if space == b"GRAY" else {**xyz, b"rTRC": curve, b"gTRC": curve, b"bTRC": curve}
    tags = {sign: data + bytes(-len(data) % 4) for sign, data in tags.items() if sign not in leave}
    table, body, place = b"", b"", 132 + 12 * len(tags)
    for sign, data in tags.items():
        table += struct.pack(">4sII", sign, place + len(body), len(data))
        body += data
    size = place + len(body)
    head = struct.pack(">I4sI4s4s4s12s4s", size, b"lcms", 0x02400000, b"mntr", space, b"XYZ ", bytes(12), b"acsp") + bytes(28)
    head += struct.pack(">3i", 63190, 65536, 54061) + bytes(48)
    assert len(head) == 128
    return head + struct.pack(">I", len(tags)) + table + body


def by_littlecms(codes: np.ndarray, data: bytes) -> np.ndarray:
    source = ImageCms.ImageCmsProfile(io.BytesIO(data))
    flags = ImageCms.Flags.NOOPTIMIZE if hasattr(ImageCms, "Flags") else 0
    return np.asarray(ImageCms.profileToProfile(
        Image.fromarray(codes), source, ImageCms.createProfile("sRGB"), renderingIntent=ImageCms.Intent.RELATIVE_COLORIMETRIC,
        flags=flags,
    ))


@pytest.mark.parametrize(
    "data",
    [profile(), profile(ADOBE, gamma(1.8)), profile(SRGB, gamma(2.2)), profile(SRGB, gamma(1.0)),
     profile(ADOBE, struct.pack(">4sII256H", b"curv", 0, 256, *(round(65535 * (k / 255) ** 1.5) for k in range(256)))),
     profile(ADOBE, SRGB_CURVE)],
    ids=["Adobe RGB", "gamma 1.8", "sRGB's primaries", "linear", "table", "sRGB's curve"],
)
def test_conversion_agrees_with_littlecms(data):
    codes = random_codes(1, (16, 16, 3))
    found = converted("a.jpg", codes, data)
    assert found.dtype == np.uint16
    # Half a code of 8 bits, and what LittleCMS rounds in between.
    assert np.abs(found / 257 - by_littlecms(codes, data)).max() < 1.6


def test_the_red_of_adobe_rgb():
    """By hand: codes 128, 64, 32 are 0.2195, 0.0478, 0.0104 linear Adobe RGB; the red of sRGB is 1.3983 r - 0.3983 g."""
    found = srgb_decoded(converted("a.jpg", np.array([[[128, 64, 32]]], np.uint8), profile())[0, 0] / 65535)
    linear = (np.array([128, 64, 32]) / 255) ** 2.19921875
    assert found[0] == pytest.approx(1.39836 * linear[0] - 0.39836 * linear[1], abs=1e-4)
    assert found[1] == pytest.approx(linear[1], abs=2e-4)


@pytest.mark.parametrize("dtype", ["uint8", "uint16"])
def test_srgb_itself_stays_to_the_bit(dtype):
    codes = random_codes(2, (4, 5, 3), dtype)
    assert converted("a.png", codes, profile(SRGB, SRGB_CURVE)) is codes
    assert converted("a.png", codes, ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()) is codes


def test_floating_point_becomes_linear():
    values = random_codes(3, (4, 5, 4), "float32") / 2
    found = converted("a.tif", values, profile(SRGB, SRGB_CURVE))
    assert found.dtype == np.float32
    assert np.abs(found[..., :3] - srgb_decoded(values[..., :3])).max() < 1e-3 and np.array_equal(found[..., 3], values[..., 3])
    assert converted("a.tif", values, profile(SRGB, gamma(1.0))) is values


def test_grey_alpha_and_clipped_channels():
    grey = np.array([[[64, 255], [255, 0]]], np.uint8)
    found = converted("a.png", grey, profile(curve=gamma(1.0), space=b"GRAY"))
    assert srgb_decoded(found[0, 0, 0] / 65535) == pytest.approx(64 / 255, abs=1e-4)
    assert found[0, :, 1].tolist() == [65535, 0] and found[0, 1, 0] == 65535
    blue = converted("a.png", np.array([[[0, 200, 255]]], np.uint8), profile())
    assert blue[0, 0, 2] == 65535


@pytest.mark.parametrize(
    "data, expected",
    [
        (profile(leave=(b"rXYZ",), name="Printer"), "be of RGB or grey, by matrix and curves; 'Printer' is a table for RGB colours"),
        (profile(space=b"CMYK", name="Fogra"), "'Fogra' is for CMYK colours. Convert the picture to sRGB, or give its encoding"),
        (profile(space=b"GRAY", name="Dot gain"), "be that of its colours; 'Dot gain' has 1 channels, the picture 3"),
        (profile()[:150], "its colour profile must be readable; it is damaged"),
        (b"x", "its colour profile must be readable"),
        (profile(curve=struct.pack(">4sII", b"curv", 0, 2**31)), "it is damaged"),
    ],
)
def test_profiles_that_cannot_be_converted_name_the_picture(data, expected):
    with pytest.raises(DataError, match=f"a.jpg: .*{expected}"):
        converted("a.jpg", random_codes(0), data)


def test_damaged_profiles_are_read_or_refused():
    good, random = profile(), np.random.default_rng(0)
    for _ in range(2000):
        data = bytearray(good)
        for place in random.integers(0, len(good), random.integers(1, 6)):
            data[place] = random.integers(256)
        try:
            found = converted("a.jpg", random_codes(0), bytes(data))
        except DataError:
            continue
        assert found.shape == (3, 4, 3)
    assert read_profile("a.jpg", good).name == "Adobe RGB (1998)"


def put_tagged(path, pixels, data=None, **attributes):
    spec_path = put_image(path, pixels, **attributes)
    if data is None:
        return spec_path
    source = oiio.ImageBuf(str(path))
    source.specmod().attribute("ICCProfile", oiio.TypeDesc(f"uint8[{len(data)}]"), np.frombuffer(data, np.uint8))
    source.read(force=True)
    assert source.write(str(path)), source.geterror()
    return path


@pytest.mark.parametrize("suffix", ["png", "tif", "jpg"])
def test_photographs_are_converted_unless_their_encoding_is_given(tmp_path, suffix):
    codes = np.full((8, 8, 3), (128, 64, 32), np.uint8)
    for number, name in enumerate(("a", "b", "c")):
        put_tagged(tmp_path / "d" / f"{name}.{suffix}", codes + np.uint8(number), profile())
    stored = read_image(tmp_path / "d" / f"a.{suffix}")
    (tmp_path / "d" / "x.lp").write_text("".join(f"{n}.{suffix} {x} 0 0.8\n" for n, x in (("a", 0.6), ("b", -0.6))) + f"c.{suffix} 0 0 1\n")
    wanted = srgb_decoded(converted("", stored, profile())[0, 0] / 65535)
    btf = load_btf(tmp_path / "d")
    assert btf.image(0)[:, 0, 0].tolist() == pytest.approx(wanted, abs=1e-5)
    assert read_linear(tmp_path / "d" / f"a.{suffix}")[:, 0, 0].tolist() == pytest.approx(wanted, abs=1e-5)
    assert "images have the colour profile 'Adobe RGB (1998)'; their colours are converted to sRGB" in btf.source.notes
    given = load_btf(tmp_path / "d", encoding="srgb")
    assert given.image(0)[:, 0, 0].tolist() == pytest.approx(srgb_decoded(stored[0, 0] / 255), abs=1e-5)
    assert any("taken as they are, since an encoding is given" in note for note in given.source.notes)


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("suffix", ["tif", "jpg"])
def test_pictures_are_turned_as_their_orientation_says(tmp_path, orientation, suffix):
    codes = np.kron(random_codes(5, (2, 3, 3)), np.ones((8, 8, 1), np.uint8))
    path = put_image(tmp_path / "d" / f"a.{suffix}", codes, Orientation=orientation)
    put_image(tmp_path / "d" / f"b.{suffix}", codes, Orientation=orientation)
    wanted = oiio.ImageBufAlgo.reorient(oiio.ImageBuf(str(path))).get_pixels(oiio.UINT8)
    assert np.array_equal(read_image(path), wanted)
    assert (wanted.shape[0] == 16) == (orientation < 5)
    (tmp_path / "d" / "x.lp").write_text(f"a.{suffix} 0 0 1\nb.{suffix} 0.6 0 0.8\n")
    btf = load_btf(tmp_path / "d")
    assert (btf.height, btf.width) == wanted.shape[:2]
    assert np.abs(btf.image(0).permute(1, 2, 0).numpy() - srgb_decoded(wanted / 255)).max() < 1e-5
    assert any("turned upright" in note for note in btf.source.notes) == (orientation != 1)


def test_a_profile_of_zeros_is_named_in_printable_words():
    with pytest.raises(DataError, match="^a.jpg: its colour profile must be of RGB or grey, by matrix and curves; .* is for unknown colours") as caught:
        read_profile("a.jpg", bytes(200))
    assert str(caught.value).isprintable()
