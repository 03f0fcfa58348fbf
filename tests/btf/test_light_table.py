"""Tables of lights in every form that is about, one reader for all."""

from __future__ import annotations

import pytest
import torch
from tests.support import assert_close

from torchmat import DataError
from torchmat.btf.light_table import lp_text, parse_intensities, parse_lights
from torchmat.btf.listing import natural

NAMES = ("photo 1.tif", "photo 2.tif", "photo 10.tif")
LIGHT = torch.tensor([[-0.001936, -0.147205, 0.989104], [0.6, 0.0, 0.8], [0.0, -0.5, 0.866025]], dtype=torch.float64)
NUMBERS = ["-0.001936 -0.147205 0.989104", "0.6 0 0.8", "0 -0.5 0.866025"]


def named(join=" ", change=lambda text: text) -> list[str]:
    return [name + join + change(numbers.replace(" ", join)) for name, numbers in zip(NAMES, NUMBERS, strict=True)]


def parse(lines, end="\n", **options):
    return parse_lights("t.lp", end.join(lines) + end, **options)


@pytest.mark.parametrize(
    "lines",
    [
        named(), ["3", *named()], named("\t"), named(", "), named(";"), ["name,x,y,z", *named(",")],
        ["light_x;light_y;light_z;file", *[f"{n.replace(' ', ';')};{name}" for name, n in zip(NAMES, NUMBERS, strict=True)]],
        named("\t", lambda text: text.replace(".", ",")), named(";", lambda text: text.replace(".", ",")),
        [line.replace("tif -0.0", "tif,-0.0").replace("tif\t", "tif,") for line in named("\t", lambda text: text.replace(".", ","))],
        [f"{n.replace(' ', ';').replace('.', ',')};{name}" for name, n in zip(NAMES, NUMBERS, strict=True)],
        ["# RTIBuilder", "% and others", *named()],
    ],
    ids=["plain", "count", "tabs", "commas", "semicolons", "CSV header", "header, file last", "decimal commas, tabs",
         "decimal commas, semicolons", "decimal commas behind a comma", "decimal commas, file last", "comments"],
)
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_forms_with_names(lines, end):
    table = parse(lines, end)
    assert table.names == NAMES and table.intensity is None
    assert_close(table.light, LIGHT, 1e-9)
    assert bool(table.notes) == any("-0,001936" in line for line in lines)


@pytest.mark.parametrize(
    "lines",
    [NUMBERS, [n.replace(" ", ",") for n in NUMBERS], [f"{k} {n}" for k, n in enumerate(NUMBERS)],
     [f"{k}\t{n}" for k, n in enumerate(NUMBERS, 1)], ["3", *NUMBERS], ["x y z", *NUMBERS],
     [n.replace(" ", "\t").replace(".", ",") for n in NUMBERS]],
    ids=["plain", "commas", "numbered from 0", "numbered from 1", "count", "header", "decimal commas"],
)
def test_forms_without_names(lines):
    table = parse(lines, images=3)
    assert table.names is None and table.intensity is None
    assert_close(table.light, LIGHT, 1e-9)


def test_a_table_may_stand_turned():
    four = torch.cat((LIGHT, torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float64)))
    table = parse([" ".join(map(str, row)) for row in four.T.tolist()], images=4)
    assert_close(table.light, four, 1e-9)


@pytest.mark.parametrize(
    "more, wanted", [(["0.5", "1", "2"], [[0.5] * 3, [1.0] * 3, [2.0] * 3]),
                     (["1 2 3", "4 5 6", "7 8 9"], [[1, 2, 3], [4, 5, 6], [7, 8, 9]])],
)
@pytest.mark.parametrize("form", ["named", "numbers", "numbered", "header"])
def test_intensities_follow(form, more, wanted):
    lines = [f"{n} {i}" for n, i in zip(NUMBERS, more, strict=True)]
    if form == "named":
        lines = [f"{name} {line}" for name, line in zip(NAMES, lines, strict=True)]
    if form == "numbered":
        lines = [f"{k} {line}" for k, line in enumerate(lines)]
    if form == "header":
        heads = "x,y,z,intensity" if " " not in more[0] else "x,y,z,r,g,b"
        lines = [heads, *[line.replace(" ", ",") for line in lines]]
    table = parse(lines, known=NAMES.__contains__, images=3)
    assert_close(table.light, LIGHT, 1e-9)
    assert table.intensity.tolist() == wanted


def test_the_file_that_is_there_says_what_the_name_is():
    line = "a 1 0 0 1"
    assert parse([line], known={"a"}.__contains__).intensity is not None
    table = parse([line], known={"a 1"}.__contains__)
    assert table.names == ("a 1",) and table.intensity is None


@pytest.mark.parametrize(
    "lines, expected",
    [
        (["a.png,0,6,0,0,0,8"], "t.lp: line 1: the line must be readable in one way; .*Write decimals with a point"),
        (["1 0 0 1", "0 0 1"], "the lines must have one number of columns; some have 3 numbers and some 4"),
        (["1 0 0 1 5 6 7 8 9"], "must hold x y z for each photograph"),
        (["a.png 0 0 1", "b.png 0 0 1 2"], "all have as many numbers; some have intensities"),
        (["0 0 1 0", "0 0.6 0.8 1"], "intensities must be positive numbers.*1 are not, first is number 1"),
        (["x y z exposure gamma", "0 0 1 1 1"], "the header must name no other columns"),
        (["file,x,y,z", "a.png,0,0,one"], "line 2: the line must hold a finite number in each column"),
    ],
)
def test_refused(lines, expected):
    with pytest.raises(DataError, match=expected):
        parse(lines)


@pytest.mark.parametrize("text", ["1\n2\n4\n", "1 2 4\n", "1 1 1\n2 2 2\n4 4 4\n"])
def test_intensities_of_a_file(text):
    assert_close(parse_intensities("i.txt", text, 3).expand(-1, 3), [[1.0] * 3, [2.0] * 3, [4.0] * 3], 1e-9)


@pytest.mark.parametrize("text", ["", "1\n2\n", "1 2\n3 4\n5 6\n", "1\n0\n2\n", "1\nx\n2\n", "1\n2 3 4\n5\n"])
def test_intensities_refused(text):
    with pytest.raises(DataError, match=r"i\.txt"):
        parse_intensities("i.txt", text, 3)


def test_what_is_written_is_read():
    table = parse_lights("t.lp", lp_text(NAMES, LIGHT), known=NAMES.__contains__)
    assert table.names == NAMES
    assert_close(table.light, LIGHT, 1e-6)


def test_natural_order():
    names = ["img10.png", "img2.png", "IMG1.png", "gray.11.tga", "gray.9.tga", "b/a.png", "img02.png", "img.png"]
    assert sorted(names, key=natural) == [
        "b/a.png", "gray.9.tga", "gray.11.tga", "IMG1.png", "img02.png", "img2.png", "img10.png", "img.png",
    ]
