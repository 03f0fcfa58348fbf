"""OBJ files as programs write them: indices, blanks, line ends, polygons, and what stands beside the triangles."""

from __future__ import annotations

import numpy as np
import pytest
from tests.rendering.mesh_files import SQUARE, SQUARE_UV, TWO, corners, put_obj
from tests.rendering.test_mesh_bad_files import assert_refused

from torchmat.rendering import mesh_obj
from torchmat.rendering.mesh import load_mesh
from torchmat.rendering.mesh_file import read_triangles

STRIP = "".join(
    f"v {x} 0 0\nv {x + 1} 0 0\nv {x + 1} 1 0\nv {x} 1 0\nvt 0 0\nvt 1 0\nvt 1 .5\nvt 0 .5\nvn 0 0 1\n"
    "f -4/-4/-1 -3/-3/-1 -2/-2/-1 -1/-1/-1\n"
    for x in range(5)
)


def put(folder, text: str):
    path = folder / "a.obj"
    path.write_bytes(text.encode())
    return path


def area(mesh) -> float:
    a, b, c = corners(mesh, "position").transpose(1, 0, 2)
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


@pytest.mark.parametrize("block", [64, 1 << 23])
def test_negative_indices_count_from_the_line_that_they_stand_in(block, tmp_path, monkeypatch):
    monkeypatch.setattr(mesh_obj, "BLOCK", block)
    mesh = load_mesh(put(tmp_path, STRIP))
    assert len(mesh.faces) == 10 and area(mesh) == pytest.approx(5)
    assert mesh.bounds.tolist() == [[0, 0, 0], [5, 1, 0]]
    points, uv = corners(mesh, "position"), corners(mesh, "uv")
    assert np.allclose(uv[..., 0], points[..., 0] - np.repeat(np.arange(5), 2)[:, None])
    assert np.allclose(uv[..., 1], points[..., 1] / 2)


def test_negative_and_positive_indices_may_be_mixed(tmp_path):
    text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 -2 3\nv 1 1 0\nf 2 -1 -2\n"
    assert load_mesh(put(tmp_path, text)).bounds.tolist() == [[0, 0, 0], [1, 1, 0]]
    assert area(load_mesh(put(tmp_path, text))) == pytest.approx(1)


@pytest.mark.parametrize("line", ["f -1 -2 -4", "f 1 2 4", "f 1/1 2/1 3/1", "f 1//1 2//1 3//1", "f -1/-1 -2/-1 -3/-1"])
def test_indices_that_reach_out_of_the_file_are_refused(line, tmp_path):
    text = f"v 0 0 0\nv 1 0 0\nv 0 1 0\n# here\n{line}\n"
    assert_refused(put(tmp_path, text), r"corners of faces, their \w.*, must be in the file; line 5 has one out of bounds")


def test_a_concave_polygon_keeps_its_area_and_its_side(tmp_path):
    text = "v 0 0 0\nv 2 0 0\nv 2 1 0\nv 1 1 0\nv 1 2 0\nv 0 2 0\n"
    for first in range(6):
        mesh = load_mesh(put(tmp_path, text + "f " + " ".join(str((first + k) % 6 + 1) for k in range(6)) + "\n"))
        assert (len(mesh.faces), area(mesh)) == (4, pytest.approx(3))
        assert mesh.normal.tolist() == [[0, 0, 1]] * 6


BLANKS = {
    "tabs": lambda text: text.replace(" ", "\t"), "two blanks": lambda text: text.replace(" ", "  "),
    "indented": lambda text: text.replace("\n", "\n \t"), "behind": lambda text: text.replace("\n", " \t\n"),
    "CRLF": lambda text: text.replace("\n", "\r\n"), "CR": lambda text: text.replace("\n", "\r"),
    "mark": lambda text: "\ufeff" + text, "no last end": lambda text: text.rstrip("\n"),
    "empty lines": lambda text: text.replace("\n", "\n\n"), "comments": lambda text: text.replace("\n", " # v 1 2\n#f 1\n"),
    "continued": lambda text: text.replace(" ", " \\\n", 3).replace("f 1/1 ", "f \\\n1/1 \\\r\n "),
    "capital exponents": lambda text: text.replace("1.0", "+1.0E0"),
    "colours": lambda text: "".join(
        line + (" 0.5 0.5 0.25" if line.startswith("v ") else "") + "\n" for line in text.splitlines()),
    "weights": lambda text: "".join(
        line + (" 1.0" if line[:2] in ("v ", "vt") else "") + "\n" for line in text.splitlines()),
    "groups": lambda text: text.replace("f ", "g left\nusemtl red\ns 1\no \u00e9\nf ") + "l 1 2\np 1\n",
}


@pytest.mark.parametrize("block", [40, 1 << 23])
@pytest.mark.parametrize("how", BLANKS)
def test_blanks_line_ends_and_what_is_passed_over(how, block, tmp_path, monkeypatch):
    monkeypatch.setattr(mesh_obj, "BLOCK", block)
    text = put_obj(tmp_path / "plain.obj", SQUARE, TWO, SQUARE_UV, SQUARE + 1).read_text()
    changed = BLANKS[how](text)
    assert changed != text
    mesh, plain = load_mesh(put(tmp_path, changed)), load_mesh(tmp_path / "plain.obj")
    for what in ("position", "uv", "normal"):
        assert np.array_equal(corners(mesh, what), corners(plain, what)), what


def test_an_obj_in_utf_16(tmp_path):
    put_obj(tmp_path / "a.obj", SQUARE, TWO, SQUARE_UV)
    (tmp_path / "a.obj").write_bytes((tmp_path / "a.obj").read_text().encode("utf-16"))
    assert np.array_equal(corners(load_mesh(tmp_path / "a.obj"), "position"), SQUARE[TWO])


def test_corners_without_texture_or_normal(tmp_path):
    head = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nvn 0 0.6 0.8\n"
    mesh = load_mesh(put(tmp_path, head + "f 1/1/1 2/2/1 3/3/1\nf 2 4 3\n"))
    assert mesh.mapping == "file and box"
    normal = corners(mesh, "normal")
    assert np.allclose(normal[0], [0, 0.6, 0.8], atol=1e-7) and np.array_equal(normal[1], [[0, 0, 1]] * 3)
    assert np.array_equal(corners(mesh, "uv")[0], [[0, 0], [1, 0], [0, 1]])
    lines = {"f 1//1 2//1 3//1": "box", "f 1/1/ 2/2/ 3/3/": "file", "f 1// 2// 3//": "box", "f 1/1 2/2 3/3": "file"}
    for line, mapping in lines.items():
        assert load_mesh(put(tmp_path, head + line + "\n")).mapping == mapping


def test_a_texture_of_one_number(tmp_path):
    text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0.25\nvt 1 0.5\nvt 0 1\nf 1/1 2/2 3/3\n"
    assert corners(load_mesh(put(tmp_path, text)), "uv")[0].tolist() == [[0.25, 0], [1, 0.5], [0, 1]]


@pytest.mark.parametrize(("line", "words"), [
    ("f 1/1 2/2 3", "told alike; line 5 has others"), ("f /1 /2 /3", "a vertex each"), ("f 1/2/3/4 2 3", "a fourth number"),
    ("f 1.5 2 3", r"be whole numbers; line 5 has '1\.5 2 3'"), ("v 0 1,5 2", "must be numbers; line 5 has '0 1,5 2'"),
    ("v 0 0x10 2", "must be numbers; line 5 has"), ("vn 0 1", "numbers of a normal must be three; they are 2 in line 5"),
    ("vt", "numbers of a texture coordinate must be one at least; they are 0 in line 5"),
    ("f 1 2", "three corners; line 5 has 2"),
])
@pytest.mark.parametrize("block", [20, 1 << 23])
def test_lines_that_cannot_be_read_are_named(line, words, block, tmp_path, monkeypatch):
    monkeypatch.setattr(mesh_obj, "BLOCK", block)
    text = f"v 0 0 0\nv 1 0 \\\n0\nv 0 1 0\n{line}\nvt 0 0\nvt 0 0\nvt 0 0\nf 1 2 3\n"
    assert_refused(put(tmp_path, text), words)


def test_names_of_materials_are_kept_once(tmp_path):
    text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl old leather\nf 1 2 3\nusemtl wool\nf 3 2 1\nusemtl old leather\r\nf 1 2 3\n"
    assert read_triangles(put(tmp_path, text)).materials == ("old leather", "wool")


@pytest.mark.parametrize("line", ["x", "usemtl{} ", " ", "\\", "a ", "#"], ids=repr)
def test_a_line_of_millions_of_letters_is_passed_over(line, tmp_path):
    head, _, letters = line.rpartition("{}")
    line = head + letters * 2_000_000
    text = f"v 0 0 0\nv 1 0 0\nv 0 1 \\\n0\n{line}\n\nf 1 2 3\n"
    assert len(load_mesh(put(tmp_path, text)).faces) == 1
