"""manifest.csv in the forms that spreadsheets give it, and the mistakes that people make in it."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from tests.btf.files import ANGLES, HEADER, directions_of, either_way, put_btf, put_image, put_manifest, random_codes
from tests.btf.files import srgb_decoded, zip_of
from tests.support import assert_close

from torchmat import DataError, RangeError, TorchmatError, load_btf

LIGHTS = np.array([directions_of(*row[:2]) for row in ANGLES])
VIEWS = np.array([directions_of(*row[2:]) for row in ANGLES])


def with_text(folder, text: str | bytes):
    """Write four images and a manifest of exactly this text."""
    put_btf(folder)
    (folder / "manifest.csv").write_bytes(text if isinstance(text, bytes) else text.encode())
    return folder


def rows_of(*columns: str) -> str:
    """Return manifest lines with the unit vectors or angles that the header's columns ask for."""
    values = {
        **{f"light_{axis}": LIGHTS[:, k] for k, axis in enumerate("xyz")},
        **{f"view_{axis}": VIEWS[:, k] for k, axis in enumerate("xyz")},
    }
    for k, name in enumerate(("light_polar", "light_azimuth", "view_polar", "view_azimuth")):
        values[f"{name}_deg"] = np.array([row[k] for row in ANGLES])
        values[f"{name}_rad"] = np.deg2rad(values[f"{name}_deg"])
    lines = [",".join(columns)]
    for row in range(4):
        lines.append(",".join(f"{row}.png" if name == "file" else repr(float(values[name][row])) for name in columns))
    return "\n".join(lines) + "\n"


@either_way
@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float16", "float32"])
def test_images_and_directions(tmp_path, pack, dtype):
    btf = load_btf(pack(put_btf(tmp_path / "wool", dtype, suffix="exr" if dtype.startswith("float") else "png")))
    assert (btf.source.kind, btf.stored_dtype, btf.height, btf.width) == ("manifest", dtype, 3, 4)
    assert_close(btf.light, LIGHTS, 1e-6)
    assert_close(btf.view, VIEWS, 1e-6)
    for seed in range(4):
        codes = random_codes(seed, dtype=dtype).astype("float64").transpose(2, 0, 1)
        full = {"uint8": 255, "uint16": 65535}.get(dtype)
        assert_close(btf.image(seed), codes if full is None else srgb_decoded(codes / full), 1e-6)


@pytest.mark.parametrize("light", [("light_polar_deg", "light_azimuth_deg"), ("light_polar_rad", "light_azimuth_rad"),
                                   ("light_x", "light_y", "light_z")])
@pytest.mark.parametrize("view", [("view_polar_deg", "view_azimuth_deg"), ("view_polar_rad", "view_azimuth_rad"),
                                  ("view_x", "view_y", "view_z")])
def test_units_and_column_order(tmp_path, light, view):
    btf = load_btf(with_text(tmp_path / "d", rows_of(*view[::-1], "file", *light)))
    assert_close(btf.light, LIGHTS, 1e-6)
    assert_close(btf.view, VIEWS, 1e-6)


def usual() -> str:
    return rows_of("file", *HEADER.split(",")[1:])


@pytest.mark.parametrize(
    "text",
    [
        usual().replace("\n", "\r\n"),
        usual().replace("\n", "\r"),
        usual().rstrip("\n"),
        usual().replace("\n", "\n\n") + " , , , , \n",
        usual().replace(",", ";"),
        usual().replace(",", "\t"),
        usual().replace(",", " , "),
        usual().replace(",", ",,", 1).replace(".png,", ".png,,"),
        usual().replace("file,light", "FILE,Light"),
        usual().replace("0.png", '"0.png"'),
        usual().replace("0.png", "./0.png"),
        usual().replace("0.png", "0.PNG"),
        usual().replace("0.png", "C:\\\\data\\\\wool\\\\0.png"),
        usual().replace("0.png", "/home/me/wool/0.png"),
        b"\xef\xbb\xbf" + usual().encode(),
        usual().encode("utf-16"),
        b"\xfe\xff" + usual().encode("utf-16-be"),
    ],
    ids=["crlf", "cr", "no last end", "blank lines", "semicolon", "tab", "spaces", "empty column", "capitals", "quotes",
         "dot", "other case", "windows path", "absolute path", "bom", "utf-16", "utf-16-be"],
)
def test_what_programs_write(tmp_path, text):
    btf = load_btf(with_text(tmp_path / "d", text))
    assert btf.source.files == ("0.png", "1.png", "2.png", "3.png")
    assert_close(btf.light, LIGHTS, 1e-6)


@either_way
def test_names_with_spaces_commas_and_letters_from_everywhere(tmp_path, pack):
    names = ["my cloth.png", "Stoff ä.png", "布.png", '"a, b.png"']
    for seed, name in enumerate(names):
        put_image(tmp_path / "d ü" / name.strip('"'), random_codes(seed))
    btf = load_btf(pack(put_manifest(tmp_path / "d ü", names)))
    files = tuple(file.removeprefix("d ü/") for file in btf.source.files)
    assert files == ("my cloth.png", "Stoff ä.png", "布.png", "a, b.png")
    assert_close(btf.image(3), srgb_decoded(random_codes(3).transpose(2, 0, 1) / 255), 1e-6)


def test_letters_that_macos_takes_apart(tmp_path):
    folder = put_btf(tmp_path / "d")
    (folder / "0.png").rename(folder / "a\u0308.png")
    put_manifest(folder, ["\u00e4.png", "1.png", "2.png", "3.png"])
    assert load_btf(folder).source.files[0] == "a\u0308.png"


@either_way
def test_images_in_folders(tmp_path, pack):
    names = ["v0/l0.png", "v0/l1.png", "v1/l0.png", "v1/l1.png"]
    for seed, name in enumerate(names):
        put_image(tmp_path / "d" / name, random_codes(seed))
    put_manifest(tmp_path / "d", [name.replace("/", "\\").upper() for name in names])
    btf = load_btf(pack(tmp_path / "d"))
    assert [file.removeprefix("d/") for file in btf.source.files] == names
    assert_close(btf.image(2), srgb_decoded(random_codes(2).transpose(2, 0, 1) / 255), 1e-6)


def test_a_zip_with_backslashes(tmp_path):
    put_btf(tmp_path / "d")
    members = {f"d\\{path.name}": path.read_bytes() for path in (tmp_path / "d").iterdir()}
    assert len(load_btf(zip_of(tmp_path / "windows.zip", members))) == 4


def test_path_of_the_manifest_itself(tmp_path):
    folder = put_btf(tmp_path / "d")
    (folder / "old.lp").write_text("0.png 0 0 1\n")
    btf = load_btf(folder / "manifest.csv")
    assert (btf.source.kind, len(btf), btf.source.path) == ("manifest", 4, str(folder))
    assert load_btf(folder / "old.lp").source.kind == "rti"


def without(column: str) -> str:
    return rows_of(*(name for name in HEADER.split(",") if name != column))


LINES = usual().split("\n")


def changed(number: int, line: str) -> str:
    return "\n".join([*LINES[:number], line, *LINES[number + 1 :]])


@pytest.mark.parametrize(
    "text, expected",
    [
        ("", "hold a header and at least one line; it has 0"),
        (LINES[0], "it has 1. List one image a line"),
        (without("file"), "have a column `file`; it has light_polar_deg"),
        (without("light_azimuth_deg"), "the light direction must have the columns .*Add the missing columns"),
        (without("view_polar_deg"), "the view direction must have the columns"),
        (usual().replace("light_polar_deg", "light_polar"), "the columns are file, light_polar, .*Add the missing"),
        (usual().replace("file", "file_name", 1), "have a column `file`"),
        (usual().replace("view_azimuth_deg", "file"), "name each column once; 'file' stands twice"),
        (changed(2, "1.png,30.0,90.0,0.0"), "line 3: each line must have a cell per column; it has 4 cells and .* 5"),
        (changed(2, "1, 2.png,30,90,0,0"), "line 3: each line .*in quotes"),
        (changed(2, "1.png,,90,0,0"), "line 3: light_polar_deg must be a finite number; it is ''. Fill in"),
        (changed(2, "1.png,30,north,0,0"), "line 3: light_azimuth_deg must be a finite number; it is 'north'"),
        (changed(3, "2.png,nan,90,0,0"), "line 4: light_polar_deg must be a finite number; it is 'nan'"),
        (changed(2, '1.png,"30,5",90,0,0'), "line 3: light_polar_deg .* it is '30,5'. Write decimals with a point"),
        (changed(2, "\n\n1.png,-5,90,0,0"), "line 5: light_polar_deg must be an angle of 0 to 90 .* degrees; it is -5"),
        (changed(2, "1.png,95,90,0,0"), "line 3: light_polar_deg .*it is 95, azimuth 90"),
        (changed(2, "1.png,30,9000,0,0"), "line 3: .*azimuth 9000"),
        (changed(2, "1.png,30,90,90,0"), "1.png: the view direction must lie above the surface"),
        (changed(2, "gone.png,30,90,0,0"), "line 3: the file 'gone.png' must exist; it is not there. Put the"),
        (changed(2, ",30,90,0,0"), "line 3: the file '' must exist"),
        (changed(2, "0.png,30,90,0,0"), "line 3: the file '0.png' must be listed once; 0.png also stands at line 2"),
        (changed(2, "1.png,0,45,0,0"), "1.png: the directions must differ from every other's; it has those of 0.png"),
        (changed(2, "manifest.csv,30,90,0,0"), "manifest.csv: the image must be readable"),
        (changed(2, '1.png,30,90,0,"0'), "view_azimuth_deg must be a finite number; it is '0\\\\n2.png.*Fill in"),
        (usual().encode("latin-1") + b"\xe4", "manifest.csv: the text must be UTF-8; .*Save it as UTF-8"),
        (usual().encode("utf-16")[:-1], "manifest.csv: the text must be UTF-8"),
        (rows_of("file", "light_polar_rad", "light_azimuth_rad", "view_x", "view_y", "view_z").replace("rad", "deg"),
         "the light angles must be in degrees; .*radians: name the columns light_polar_rad, light_azimuth_rad"),
        (usual().replace("light_polar_deg,light_azimuth_deg", "light_polar_rad,light_azimuth_rad"),
         "line 3: light_polar_rad must be an angle of 0 to 90 degrees, in radians; it is 30.0"),
    ],
)
def test_refused(tmp_path, text, expected):
    with pytest.raises(DataError, match=expected) as caught:
        load_btf(with_text(tmp_path / "d", text))
    assert str(tmp_path / "d") in str(caught.value)


def test_two_units_at_once(tmp_path):
    text = rows_of("file", "light_x", "light_y", "light_z", "light_polar_rad", "light_azimuth_rad", "view_polar_deg",
                   "view_azimuth_deg")
    with pytest.raises(DataError, match="the light direction must have the columns.*Keep one unit only"):
        load_btf(with_text(tmp_path / "d", text))


def xyz(light: str) -> str:
    return f"file,light_x,light_y,light_z,view_x,view_y,view_z\n0.png,{light},0,0,1\n1.png,0.6,0,0.8,0,0,1\n"


@pytest.mark.parametrize(
    "light, expected",
    [
        ("0,0,2", "0.png: the light direction must be a unit vector; 1 of 2 are .* 2. .*normalise=True"),
        ("0,0,0", "0.png: the light direction .*length 0. It says nothing about a direction"),
        ("1e200,0,1e200", r"0.png: the light direction .*length 1.41421e\+200"),
        ("0,0,-1", "0.png: the light direction must lie above the surface; .*\\(0, 0, -1\\). z points away"),
        ("0.6,0,0.8", "1.png: the directions must differ"),
    ],
)
def test_vectors_refused(tmp_path, light, expected):
    with pytest.raises(DataError, match=expected):
        load_btf(with_text(tmp_path / "d", xyz(light)))


def test_positions_of_far_lights(tmp_path):
    btf = load_btf(with_text(tmp_path / "d", xyz("3,0,4")), normalise=True, duplicates="keep")
    assert_close(btf.light, [[0.6, 0, 0.8]] * 2, 1e-6)
    with pytest.raises(DataError, match="0.png: the light direction .*1 of 2 are not"):
        load_btf(with_text(tmp_path / "d", xyz("0,0,0")), normalise=True)
    far = load_btf(with_text(tmp_path / "e", xyz("3e200,0,4e200")), normalise=True, duplicates="keep")
    assert_close(far.light, [[0.6, 0, 0.8]] * 2, 1e-6)


def test_lengths_within_rounding_are_made_one(tmp_path):
    btf = load_btf(with_text(tmp_path / "d", xyz("0.577,0.577,0.577")))
    assert btf.light[0].tolist() == pytest.approx([1 / math.sqrt(3)] * 3)


def test_two_manifests(tmp_path):
    put_btf(tmp_path / "d" / "a")
    put_btf(tmp_path / "d" / "b")
    with pytest.raises(DataError, match="the only one; there are 2: a/manifest.csv, b/manifest.csv"):
        load_btf(tmp_path / "d")
    assert len(load_btf(tmp_path / "d" / "a")) == 4


def test_one_name_in_two_folders(tmp_path):
    for folder in ("a", "b"):
        put_image(tmp_path / "d" / folder / "0.png", random_codes(0))
    put_manifest(tmp_path / "d", ["0.png"])
    with pytest.raises(DataError, match="line 2: the file '0.png' must be one file; it may be a/0.png or b/0.png"):
        load_btf(tmp_path / "d")


@pytest.mark.parametrize(
    "options, error, text",
    [
        ({"kind": "bonn"}, RangeError, "kind must be one of 'manifest'"),
        ({"kind": "mainfest"}, RangeError, "Did you mean 'manifest'"),
        ({"encoding": "rgb"}, RangeError, "Did you mean 'srgb'"),
        ({"invalid": "ignore"}, RangeError, "invalid must be one of"),
        ({"duplicates": "drop"}, RangeError, "duplicates must be one of"),
        ({"exposure": 0}, RangeError, "exposure must be positive"),
        ({"exposure": math.nan}, RangeError, "exposure must be positive"),
        ({"exposure": math.inf}, RangeError, "exposure must be positive and finite"),
        ({"clipped_weight": 2}, RangeError, "clipped_weight must lie in"),
    ],
)
def test_options_refused(tmp_path, options, error, text):
    with pytest.raises(error, match=text) as caught:
        load_btf(put_btf(tmp_path / "d"), **options)
    assert isinstance(caught.value, TorchmatError)
    assert isinstance(caught.value, ValueError)


def test_encoding_and_exposure(tmp_path):
    folder = put_btf(tmp_path / "d")
    codes = torch.from_numpy(random_codes(1).transpose(2, 0, 1) / 255)
    assert_close(load_btf(folder, encoding="linear").image(1), codes)
    btf = load_btf(folder, exposure=0.5)
    assert_close(btf.image(1), srgb_decoded(codes) / 0.5, 1e-6)
    assert (btf.encoding, btf.exposure) == ("srgb", 0.5)
    floats = put_btf(tmp_path / "f", "float32", suffix="exr")
    expected = srgb_decoded(random_codes(2, dtype="float32")).transpose(2, 0, 1)
    assert_close(load_btf(floats, encoding="srgb").image(2), expected, 1e-6)
