"""Domes of RelightLab beside photographs: directions, positions over the picture's width, and what is wrong with others."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch
from tests.btf.files import put_image, random_codes, zipped
from tests.support import assert_close

from torchmat import DataError, load_btf
from torchmat.btf.dome import parse_dome

LIGHT = np.array([[0, 0.6, 0.8], [0.6, 0, 0.8], [0, 0, 1.0]])
POSITIONS = np.array([[0, 60, 80], [90, 0, 120], [10, 0, 100.0]])


def entries(vectors):
    return [dict(zip("xyz", map(float, one), strict=True)) for one in vectors]


def put_dome(tmp_path, **fields):
    folder = tmp_path / "d"
    for number in (2, 10, 1):
        put_image(folder / f"img{number}.png", random_codes(number))
    (folder / "lab.dome").write_text(json.dumps({"label": "ours", "imageWidth": 0, **fields}))
    return folder


@pytest.mark.parametrize("pack", [lambda folder: folder, zipped, lambda folder: folder / "lab.dome"], ids=["folder", "zip", "file"])
def test_directions_go_with_photographs_in_their_order(tmp_path, pack):
    folder = put_dome(tmp_path, lightConfiguration="directional", directions=entries(LIGHT), domeDiameter=60, imageWidth=20)
    btf = load_btf(pack(folder), cache=False)
    assert [name.rpartition("/")[2] for name in btf.source.files] == ["img1.png", "img2.png", "img10.png"]
    assert_close(btf.light, LIGHT, 1e-6)
    assert btf.near is None and btf.source.kind == "rti"


@pytest.mark.parametrize(
    ("fields", "expected"),
    [({"lightConfiguration": "lights3d", "positions3d": entries(POSITIONS), "directions": entries(LIGHT)}, POSITIONS),
     ({"lightConfiguration": "spherical", "directions": entries(LIGHT), "domeDiameter": 200, "verticalOffset": -5}, LIGHT * 100 - [0, 0, 5]),
     ({"lightConfiguration": "spherical", "positionsSphere": entries(POSITIONS)}, POSITIONS),
     ({"diameter": 200, "positions": POSITIONS.tolist()}, POSITIONS)],
    ids=["positions", "on a sphere", "of a sphere", "before light configurations"],
)
def test_positions_stand_over_the_width_of_the_picture(tmp_path, fields, expected):
    folder = put_dome(tmp_path, **fields, imageWidth=40)
    btf = load_btf(folder, cache=False)
    assert_close(btf.light_position, expected / 40, 1e-6)
    assert_close(btf.light, expected / np.linalg.norm(expected, axis=1, keepdims=True), 1e-6)
    assert "positions over a sample 40 wide, as the dome says" in " ".join(btf.source.notes)
    assert_close(load_btf(folder, near=80, cache=False).light_position, expected / 80, 1e-6)  # the caller knows better


def test_positions_without_a_width_are_asked_for_it(tmp_path):
    folder = put_dome(tmp_path, lightConfiguration="lights3d", positions3d=entries(POSITIONS))
    with pytest.raises(DataError, match="positions of near lights must come with the width of the picture.*--near WIDTH"):
        load_btf(folder, cache=False)
    (folder / "lab.dome").rename(tmp_path / "elsewhere.dome")
    given = load_btf(folder, light_table=tmp_path / "elsewhere.dome", near=40, cache=False)
    assert_close(given.light_position, POSITIONS / 40, 1e-6)


def test_values_are_multiplied_as_the_dome_says(tmp_path):
    adjust = [dict(r=2, g=1, b=0.5), dict(r=1, g=1, b=1), dict(r=1, g=4, b=1)]
    plain = load_btf(put_dome(tmp_path / "a", directions=entries(LIGHT)), cache=False)
    adjusted = load_btf(put_dome(tmp_path / "b", directions=entries(LIGHT), ledAdjust=adjust), cache=False)
    factors = torch.tensor([[2, 1, 0.5], [1, 1, 1], [1, 4, 1]])
    for number in range(3):
        assert_close(adjusted.image(number), plain.image(number) * factors[number][:, None, None], 1e-6)


@pytest.mark.parametrize(
    ("fields", "expected"),
    [({"lightConfiguration": "ring", "directions": entries(LIGHT)}, "lightConfiguration must be directional, spherical or lights3d; it is 'ring'"),
     ({"lightConfiguration": "lights3d", "imageWidth": 5}, "the dome must hold directions or positions; it is lights3d and has imageWidth"),
     ({"directions": [[0, 0, 1], [0, 1]]}, "directions must be a list of x, y, z"),
     ({"directions": [[0, 0, 1], [0, 0, 0]]}, r"directions\[1\] is 0, 0, 0"),
     ({"directions": entries(LIGHT), "domeDiameter": "wide", "lightConfiguration": "spherical"}, "domeDiameter must be a length; it is 'wide'"),
     ({"directions": entries(LIGHT), "ledAdjust": [dict(r=0, g=1, b=1)] * 3}, "ledAdjust must be positive"),
     ({"directions": entries(LIGHT), "ledAdjust": [dict(r=1, g=1, b=1)] * 2}, "there are 2 for 3 lights")],
)
def test_bad_domes_are_named(fields, expected):
    with pytest.raises(DataError, match=f"lab.dome: .*{expected}"):
        parse_dome("lab.dome", json.dumps(fields))


def test_as_many_lights_as_photographs_and_nothing_else_than_json(tmp_path):
    folder = put_dome(tmp_path, directions=entries(LIGHT[:2]))
    with pytest.raises(DataError, match="lab.dome: the lights must be as many as the photographs; there are 2 lights and 3 photographs"):
        load_btf(folder, cache=False)
    (folder / "lab.dome").write_text("0 0 1\n")
    with pytest.raises(DataError, match="lab.dome: the dome must be a JSON table"):
        load_btf(folder, cache=False)
