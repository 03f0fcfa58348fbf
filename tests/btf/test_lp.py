"""RTI captures: .lp files in the forms that are about."""

from __future__ import annotations

import pytest
from tests.btf.files import either_way, put_image, random_codes, srgb_decoded
from tests.support import assert_close

from torchmat import DataError, load_btf

LIGHTS = [[0.0, 0.0, 1.0], [0.6, 0.0, 0.8], [0.0, -0.6, 0.8]]
XYZ = ["0 0 1", "0.6 0.0 0.8", "0 -6e-1 .8"]


def put_lp(folder, lines: list[str], names=("a.png", "b.png", "c.png"), lp: str = "dirs.lp", end: str = "\n"):
    for seed, name in enumerate(names):
        put_image(folder / name, random_codes(seed))
    (folder / lp).parent.mkdir(parents=True, exist_ok=True)
    (folder / lp).write_bytes((end.join(lines) + end).encode())
    return folder


def plain(names=("a.png", "b.png", "c.png")) -> list[str]:
    return [f"{name} {xyz}" for name, xyz in zip(names, XYZ, strict=True)]


@either_way
@pytest.mark.parametrize(
    "lines",
    [
        plain(),
        ["3", *plain()],
        ["3 ", *plain(), "", ""],
        [f"{xyz} {name}" for name, xyz in zip("abc", XYZ, strict=True) for name in [f"{name}.png"]],
        [f"{n} {line}" for n, line in enumerate(plain(), 1)],
        [f"{n} {xyz} {name}" for n, (name, xyz) in enumerate(zip(("a.png", "b.png", "c.png"), XYZ, strict=True))],
        [line.replace(" ", "\t") for line in plain()],
        [line.replace(" ", ", ") for line in plain()],
        ["# by hand", "", "3", *plain()],
        [line.replace(".png", ".PNG") for line in plain()],
        [f"C:\\captures\\coin one\\{line}" for line in plain()],
        [f"/captures/coin one/{line}" for line in plain()],
        ["\ufeff3", *plain()],
        [f'"{line.replace(" ", chr(34) + " ", 1)}' for line in plain()],
    ],
    ids=["plain", "count", "count, blank", "xyz first", "numbered", "numbered, xyz first", "tabs", "commas", "comments",
         "other case", "windows path", "absolute path", "bom", "quotes"],
)
def test_forms(tmp_path, pack, lines):
    btf = load_btf(pack(put_lp(tmp_path / "coin", lines)))
    assert (btf.source.kind, len(btf), len(btf.views)) == ("rti", 3, 1)
    assert_close(btf.light, LIGHTS, 1e-6)
    assert btf.view.tolist() == [[0, 0, 1]] * 3
    for sample in range(3):
        assert_close(btf.image(sample), srgb_decoded(random_codes(sample).transpose(2, 0, 1) / 255), 1e-6)


@pytest.mark.parametrize(
    "names",
    [("a b.png", "a  c.png", "a, d.png"), ("1 a.png", "2 a.png", "3 a.png"), ("1", "2", "3"),
     ("ä.png", "布.png", "ß.png")],
)
def test_names(tmp_path, names):
    for seed, name in enumerate(names):
        put_image(tmp_path / "d" / f"{seed}.png", random_codes(seed)).rename(tmp_path / "d" / name)
    (tmp_path / "d" / "dirs.lp").write_text("\r\n".join(plain(names)), encoding="utf-8")
    btf = load_btf(tmp_path / "d")
    assert btf.source.files == names
    assert_close(btf.light, LIGHTS, 1e-6)


@pytest.mark.parametrize("lp", ["dirs.lp", "jpg/dirs.LP", "light positions/dirs.lp"])
@pytest.mark.parametrize("prefix", ["", "jpg/", "jpg\\", "../jpg/"])
def test_images_in_a_folder(tmp_path, lp, prefix):
    folder = put_lp(tmp_path / "d", [prefix + line for line in plain()], ("jpg/a.png", "jpg/b.png", "jpg/c.png"), lp)
    assert load_btf(folder).source.files == ("jpg/a.png", "jpg/b.png", "jpg/c.png")


def test_images_that_are_not_listed_do_not_matter(tmp_path):
    folder = put_lp(tmp_path / "d", plain())
    put_image(folder / "chart.png", random_codes(0, (2, 2, 3)))
    assert len(load_btf(folder)) == 3


@pytest.mark.parametrize(
    "lines, expected",
    [
        ([], "list at least one image; it lists none"),
        (["0"], "list at least one image"),
        (["4", *plain()], "the count line must match the lines below it; it says 4 and 3 follow. Complete the file"),
        (["2", *plain()], "it says 2 and 3 follow"),
        (["a file x y", *plain()], "line 1: the line must hold a name and x y z; it is 'a file x y'. Write"),
        (["3", "a.png 0 0", *plain()[1:]], "line 2: the line must hold a name"),
        (["a.png 0 0 nan"], "line 1: the line must hold a name"),
        (["0 0 1"], "the lights must be as many as the photographs; there are 1 lights and 3 photographs, a.png to c.png"),
        (["0 0"], "line 1: the line must hold a name"),
        (["²", *plain()], "line 1: the line must hold a name"),
        (["9" * 5000, *plain()], "line 1: the line must hold a name"),
        (["# lights", "gone.png 0 0 1"], "line 2: the file 'gone.png' must exist; it is not there"),
        ([*plain(), "a.png 0.8 0 0.6"], "line 4: the file 'a.png' must be listed once; a.png also stands at line 1"),
        (["a.png 0 0 1", "b.png 0 0 1"], "b.png: the directions must differ from every other's; it has those of a.png"),
        (["a.png 0 0 1.1"], "a.png: the light direction must be a unit vector; .*length 1.1"),
        (["a.png 0 0.6 -0.8"], "a.png: the light direction must lie above the surface"),
        (["a.png 0 0 0"], "a.png: the light direction must be a unit vector; .*length 0"),
    ],
)
def test_refused(tmp_path, lines, expected):
    with pytest.raises(DataError, match=expected) as caught:
        load_btf(put_lp(tmp_path / "d", lines))
    assert str(tmp_path / "d") in str(caught.value)


def test_two_light_files(tmp_path):
    folder = put_lp(tmp_path / "d", plain())
    (folder / "other.lp").write_text("a.png 0 0 1\n")
    with pytest.raises(DataError, match="an .lp file must be the only one; there are 2: dirs.lp, other.lp"):
        load_btf(folder)


def test_a_name_in_another_encoding(tmp_path):
    folder = put_lp(tmp_path / "d", plain())
    (folder / "dirs.lp").write_bytes("ä.png 0 0 1\n".encode("latin-1"))
    with pytest.raises(DataError, match="dirs.lp: the text must be UTF-8"):
        load_btf(folder)
