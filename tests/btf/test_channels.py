"""What the channels of an EXR mean: CIE XYZ becomes linear RGB, and what is no picture's set of channels is refused."""

from __future__ import annotations

import numpy as np
import OpenImageIO as oiio
import pytest
from tests.btf.files import put_manifest, random_codes
from tests.support import assert_close, shared_path

from torchmat import DataError, RangeError, load_btf
from torchmat.btf.photographs import read_linear
from torchmat.channels import rgb_of_xyz
from torchmat.images import write_image
from torchmat.report.describe import describe_btf

XYZ, RGB = ("X", "Y", "Z"), ("R", "G", "B")
# Linear RGB and its XYZ, from the primaries of Rec. 709 and the white of D65 (IEC 61966-2-1), four digits.
KNOWN = (
    ((1.0, 1.0, 1.0), (0.9505, 1.0000, 1.0891)), ((1.0, 0.0, 0.0), (0.4124, 0.2126, 0.0193)),
    ((0.0, 1.0, 0.0), (0.3576, 0.7152, 0.1192)), ((0.0, 0.0, 1.0), (0.1805, 0.0722, 0.9505)),
    ((0.643, 0.201, 0.100), (0.3551, 0.2877, 0.1314)),
)


def even(colour, dtype: str = "float16") -> np.ndarray:
    return np.broadcast_to(np.array(colour, dtype), (3, 4, 3)).copy()


def put(folder, colours, names=XYZ, dtype: str = "float16"):
    folder.mkdir(parents=True)
    files = [f"{number}.exr" for number in range(len(colours))]
    for file, colour in zip(files, colours, strict=True):
        write_image(folder / file, even(colour, dtype), names)
    return put_manifest(folder, files)


@pytest.mark.parametrize(("rgb", "xyz"), KNOWN)
def test_known_colours(tmp_path, rgb, xyz):
    wanted = np.tile(np.array(rgb)[:, None, None], (1, 3, 4))
    four_digits = 3e-4  # what is left of the rounding of XYZ: 3.2 times half a unit of the last, and others
    assert_close(rgb_of_xyz("here", even(xyz, "float64").transpose(2, 0, 1)), wanted, four_digits)
    write_image(tmp_path / "a.exr", even(xyz), XYZ)
    assert_close(read_linear(tmp_path / "a.exr"), wanted, 2e-3)  # half precision, worst of three terms
    write_image(tmp_path / "b.exr", even(xyz, "float32"), RGB)
    assert_close(read_linear(tmp_path / "b.exr", "xyz"), wanted, four_digits)


@pytest.mark.parametrize("settings", [{}, {"downscale": 2}, {"encoding": "xyz"}, {"encoding": "linear"}])
def test_a_btf_whose_channels_are_called_xyz(tmp_path, settings):
    btf = load_btf(put(tmp_path / "d", [xyz for _, xyz in KNOWN[:4]]), cache=tmp_path / "cache", **settings)
    for number, (rgb, _) in enumerate(KNOWN[:4]):
        assert_close(btf.image(number).mean(dim=(1, 2)), np.array(rgb), 2e-3)
    assert btf.source.xyz and "linear RGB, from CIE XYZ" in describe_btf(btf)
    again = load_btf(tmp_path / "d", cache=tmp_path / "cache", **settings)
    assert again.source.from_cache and again.source.xyz
    assert_close(again.images(range(4)), btf.images(range(4)), 0)


def test_xyz_that_is_called_rgb(tmp_path):
    folder = put(tmp_path / "d", [KNOWN[4][1], KNOWN[1][1]], RGB, "float32")
    cache = tmp_path / "cache"
    plain, told = load_btf(folder, cache=cache), load_btf(folder, encoding="xyz", cache=cache)
    assert_close(plain.image(0).mean(dim=(1, 2)), np.array(KNOWN[4][1]), 1e-6)
    assert_close(told.image(0).mean(dim=(1, 2)), np.array(KNOWN[4][0]), 2e-4)
    assert told.source.xyz and not plain.source.xyz


def test_the_order_in_the_file_does_not_matter_and_alpha_stays_alpha(tmp_path):
    pixels = random_codes(0, (3, 4, 4), "float32")
    pixels[..., 0] = 1
    pixels[1, 2, 0] = 0
    (tmp_path / "d").mkdir()
    write_image(tmp_path / "d" / "0.exr", pixels, ("A", "Z", "Y", "X"))
    btf = load_btf(put_manifest(tmp_path / "d", ["0.exr"]), cache=False)
    wanted = rgb_of_xyz("here", pixels[..., [3, 2, 1]].transpose(2, 0, 1))
    keep = pixels[..., 0] == 1
    assert_close(btf.image(0)[:, keep], wanted[:, keep], 1e-6)
    assert int((btf.weights(range(1)) == 0).sum()) == 1


def test_what_overflows_half_precision_is_no_number(tmp_path):
    with pytest.raises(DataError, match=r"0\.exr: the image must be finite; 12 texels are NaN or Inf"):
        load_btf(put(tmp_path / "d", [(60000.0, 1.0, 1.0)]), cache=False)


def test_whole_numbers_are_no_xyz(tmp_path):
    write_image(tmp_path / "a.png", random_codes(0))
    with pytest.raises(RangeError, match=r"a\.png: CIE XYZ must be in floating-point numbers; they are uint8"):
        read_linear(tmp_path / "a.png", "xyz")
    (tmp_path / "d").mkdir()
    write_image(tmp_path / "d" / "0.png", random_codes(0))
    with pytest.raises(RangeError, match=r"0\.png: CIE XYZ must be in floating-point numbers"):
        load_btf(put_manifest(tmp_path / "d", ["0.png"]), encoding="xyz", cache=False)


def test_one_image_in_another_space(tmp_path):
    folder = put(tmp_path / "d", [KNOWN[0][1], KNOWN[1][1]])
    write_image(folder / "1.exr", even(KNOWN[1][0]), RGB)
    with pytest.raises(DataError, match=r"1\.exr: the image must match the others; its channels are none of X, Y, Z"):
        load_btf(folder, cache=False)


@pytest.mark.parametrize(
    "names", [("diffuse.R", "diffuse.G", "diffuse.B"), ("Y", "RY", "BY"), ("U", "V", "W"), ("Z",), ("R", "G"),
              ("R", "G", "B", "A", "Z"), ("R", "G", "B", "left.R", "left.G", "left.B"), ("B", "X", "Z"), ("450nm",)],
)
def test_other_channels_are_refused_by_name(tmp_path, names):
    (tmp_path / "d").mkdir()
    write_image(tmp_path / "d" / "0.exr", random_codes(0, (3, 4, len(names)), "float16"), names)
    for read in (lambda: read_linear(tmp_path / "d" / "0.exr"), lambda: load_btf(folder, cache=False)):
        folder = put_manifest(tmp_path / "d", ["0.exr"])
        with pytest.raises(DataError, match=r"0\.exr: the channels must be Y, or R, G, B, or X, Y, Z") as caught:
            read()
        assert all(repr(name) in str(caught.value) for name in names)


@pytest.mark.parametrize("names", [("Y",), ("Y", "A"), RGB, (*RGB, "A"), XYZ, (*XYZ, "A"), ("r", "g", "b")])
def test_channels_that_are_pictures(tmp_path, names):
    write_image(tmp_path / "a.exr", random_codes(0, (3, 4, len(names)), "float16"), names)
    assert read_linear(tmp_path / "a.exr").shape == (3, 3, 4)


def test_an_exr_of_several_parts(tmp_path):
    specs = [oiio.ImageSpec(4, 3, 3, "half") for _ in range(2)]
    for spec, name in zip(specs, ("beauty", "albedo"), strict=True):
        spec.attribute("oiio:subimagename", name)
    target = oiio.ImageOutput.create(str(tmp_path / "a.exr"))
    assert target.open(str(tmp_path / "a.exr"), specs)
    target.write_image(random_codes(0, dtype="float16"))
    target.open(str(tmp_path / "a.exr"), specs[1], "AppendSubimage")
    target.write_image(random_codes(1, dtype="float16"))
    target.close()
    with pytest.raises(DataError, match=r"a\.exr: the image must hold one picture; it holds 2 parts"):
        read_linear(tmp_path / "a.exr")


def test_the_published_form_of_utia():
    btf = load_btf(shared_path("field/utia_xyz"), cache=False)
    # One of its texels is known: (.643, .201, .100), seen along the normal under a light there.
    away = (btf.image(0).permute(1, 2, 0).numpy() - np.array([0.643, 0.201, 0.100])) ** 2
    assert btf.source.kind == "utia" and float(away.sum(axis=2).min()) ** 0.5 < 2e-3
