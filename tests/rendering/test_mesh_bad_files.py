"""Mesh files that are broken: an error that names the file, what is wrong with it, and what to do."""

from __future__ import annotations

import re

import numpy as np
import pytest
from tests.rendering.mesh_files import SQUARE, SQUARE_UV, TWO, glb_of, put_obj, put_ply, put_stl

from torchmat.errors import DataError
from torchmat.rendering.as_mesh import as_mesh
from torchmat.rendering.mesh import load_mesh


def assert_refused(path, words: str) -> None:
    with pytest.raises(DataError, match=words) as caught:
        load_mesh(path)
    text = str(caught.value)
    assert text.startswith(f"{path}: ")
    # a requirement, a fact, and a next step
    assert re.fullmatch(r".+ must .+; .+\. .+\.", text), text


def whole(kind: str, folder) -> bytes:
    path = folder / f"whole.{kind.removesuffix('_ascii')}"
    if kind == "stl":
        return put_stl(path, SQUARE, TWO).read_bytes()
    if kind == "glb":
        return glb_of([{"position": SQUARE, "faces": TWO, "uv": SQUARE_UV}], [{"mesh": 0}])
    if kind == "obj":
        return put_obj(path, SQUARE, TWO, SQUARE_UV).read_bytes()
    return put_ply(path, SQUARE, TWO, SQUARE_UV, binary=kind == "ply").read_bytes()


@pytest.mark.parametrize("kind", ["stl", "ply", "ply_ascii", "glb", "obj"])
def test_a_file_that_is_cut_anywhere_is_refused(kind, tmp_path):
    data = whole(kind, tmp_path)
    path = tmp_path / f"cut.{kind.removesuffix('_ascii')}"
    path.write_bytes(data)
    assert len(load_mesh(path).faces) == 2
    # An OBJ does not say how long it is: what ends with a face is whole, and so is a last line without its end.
    lengths = {"obj": range(len(data) - 12, len(data) - 3), "ply_ascii": range(0, len(data) - 2, 7)}
    for length in lengths.get(kind, range(0, len(data), 7)):
        path.write_bytes(data[:length])
        assert_refused(path, "the mesh file|faces must|corners of")


@pytest.mark.parametrize(("kind", "length"), [("stl", 184), ("glb", 808)])
def test_a_short_file_is_told_by_its_length(kind, length, tmp_path):
    path = tmp_path / f"short.{kind}"
    path.write_bytes(whole(kind, tmp_path)[:length - 9])
    assert_refused(path, f"be complete; it has {length - 9} of the {length} bytes that its head tells")


def test_a_ply_of_polygons_without_its_last_row_is_refused(tmp_path):
    path = put_ply(tmp_path / "quads.ply", SQUARE, [[0, 1, 2]])
    text = path.read_text().replace("element face 1", "element face 3").replace("3 0 1 2\n", "4 0 1 2 3\n" * 2)
    path.write_text(text)
    assert_refused(path, "be complete; it has 6 of the 7 rows that its head tells")
    path.write_text(text + "4 0 1 2 3\n")
    assert len(load_mesh(path).faces) == 6


@pytest.mark.parametrize("kind", ["obj", "ply", "stl", "glb", "gltf", "off"])
@pytest.mark.parametrize("text", ["", "first of all, this is a text\nfull of v and f\n", "\0\0\0\0"])
def test_a_text_or_nothing_under_a_meshs_name_is_refused(kind, text, tmp_path):
    path = tmp_path / f"letter.{kind}"
    path.write_text(text)
    assert_refused(path, "the mesh file must")


@pytest.mark.parametrize(("name", "words"), [
    ("a.blend", "be one of .glb, .gltf, .obj, .off, .ply, .stl; its suffix is '.blend'"), ("a", "it has no suffix"),
    ("a.zip", "its suffix is '.zip'"), ("a.xyz", "its suffix is '.xyz'"),
])
def test_a_file_that_is_no_mesh_by_its_suffix_is_refused(name, words, tmp_path):
    (tmp_path / name).write_text("x")
    assert_refused(tmp_path / name, words)


def test_a_missing_file_and_a_folder_are_refused(tmp_path):
    assert_refused(tmp_path / "gone.obj", "the mesh file must exist; there is none")
    (tmp_path / "folder.obj").mkdir()
    assert_refused(tmp_path / "folder.obj", "it is a folder")


@pytest.mark.parametrize(("number", "count"), [(np.nan, "1 of 4"), (np.inf, "1 of 4"), (1e30, "1 of 4")])
def test_vertices_that_are_not_finite_are_refused(number, count, tmp_path):
    position = SQUARE.copy()
    position[2, 1] = number
    assert_refused(
        put_ply(tmp_path / "a.ply", position, TWO, binary=True),
        f"vertices must be finite and below 1e.15; {count} hold NaN, Inf or more, first number 2",
    )


def test_normals_and_texture_coordinates_that_are_not_finite_are_refused(tmp_path):
    broken = SQUARE_UV.copy()
    broken[3] = np.nan
    path = put_ply(tmp_path / "uv.ply", SQUARE, TWO, broken)
    assert_refused(path, r"texture coordinates must be finite.*first number 3\. Give uv='box' to do without")
    assert load_mesh(path, uv="box").mapping == "box"
    assert_refused(put_ply(tmp_path / "n.ply", SQUARE, TWO, None, SQUARE + np.nan), "normals must be finite")


@pytest.mark.parametrize("corner", [4, -1, 2**31 - 1])
def test_corners_that_are_no_vertices_are_refused(corner, tmp_path):
    path = put_ply(tmp_path / "a.ply", SQUARE, [[0, 1, 2], [0, 1, corner]], binary=True)
    assert_refused(path, rf"be vertices 0 to 3; 1 of 2 are not, first number 1: \[0, 1, {corner}\]")
    glb = tmp_path / "a.glb"
    glb.write_bytes(glb_of([{"position": SQUARE, "faces": np.array([[0, 1, abs(corner) + 3]])}], [{"mesh": 0}]))
    assert_refused(glb, "corners of triangles must be vertices 0 to 3")


@pytest.mark.parametrize(("face", "words"), [
    ("f 1 2 9", "out of bounds"), ("f -5 -2 -1", "out of bounds"), ("f 1 2 0", "count from 1; line 6 has a 0"),
    ("f 1/1 0/1 3/1", "count from 1"), ("f 1 2", "three corners"), ("f 1 two 3", "be whole numbers; line 6 has '1 two 3'"),
])
def test_faces_of_an_obj_that_mean_no_vertices_are_refused(face, words, tmp_path):
    path = put_obj(tmp_path / "a.obj", SQUARE, [[0, 1, 2]])
    lines = path.read_text().split("\n")
    path.write_text("\n".join([*lines[:5], face, *lines[5:]]))
    assert_refused(path, words)


def test_faces_of_an_obj_that_hold_the_digit_0_are_not_refused(tmp_path):
    path = tmp_path / "ten.obj"
    path.write_text("".join(f"v {k} {k * k} 0\n" for k in range(10)) + "f 10 9 8\nf -10 10 -2\n")
    assert len(load_mesh(path).faces) == 2


def test_vertices_of_two_numbers_are_refused(tmp_path):
    path = tmp_path / "flat.obj"
    path.write_text("v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n")
    assert_refused(path, "numbers of a vertex must be three; they are 2")


def test_points_and_lines_alone_are_refused(tmp_path):
    points = tmp_path / "points.obj"
    points.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\n")
    assert_refused(points, "hold triangles; it holds no triangles but points and lines")
    assert_refused(put_ply(tmp_path / "a.ply", SQUARE, np.zeros((0, 3), dtype=int)), "but points and lines")
    lines = tmp_path / "lines.glb"
    lines.write_bytes(glb_of([{"position": SQUARE, "mode": 1}], [{"mesh": 0}]))
    assert_refused(lines, "holds no triangles but lines")
    unused = tmp_path / "unused.glb"
    unused.write_bytes(glb_of([{"position": SQUARE, "faces": TWO}], []))
    assert_refused(unused, "it holds no triangles")


@pytest.mark.parametrize("change", [{"scale": [1e300, 1, 1]}, {"translation": [0, 1e30, 0]}, {"scale": [0, 0, 0]}])
def test_nodes_that_move_a_mesh_out_of_reach_are_refused(change, tmp_path):
    path = tmp_path / "far.glb"
    path.write_bytes(glb_of([{"position": SQUARE, "faces": TWO}], [{"mesh": 0} | change]))
    assert_refused(path, "vertices must be finite|triangles must have area")
    inside = SQUARE.copy()
    inside[0, 0] = np.inf
    path.write_bytes(glb_of([{"position": inside, "faces": TWO}], [{"mesh": 0, "scale": [2, 0, 1]}]))
    assert_refused(path, "vertices must be finite")


def test_only_triangles_without_area_are_refused(tmp_path):
    line = np.array([[0, 0, 0], [1, 1, 1], [2, 2, 2], [3, 3, 3.0]])
    assert_refused(put_obj(tmp_path / "line.obj", line, TWO), "triangles must have area; none of its 2 has any")
    assert_refused(put_stl(tmp_path / "point.stl", line * 0, TWO), "triangles must have area")


def test_a_compressed_gltf_is_refused(tmp_path):
    path = tmp_path / "packed.glb"
    path.write_bytes(glb_of(
        [{"position": SQUARE, "faces": TWO}], [{"mesh": 0}], extensionsRequired=["KHR_draco_mesh_compression"]
    ))
    assert_refused(path, "be uncompressed; it needs KHR_draco_mesh_compression")


def test_a_broken_mesh_of_trimesh_is_refused():
    import trimesh

    for position, faces in [(SQUARE, [[0, 1, 9]]), (SQUARE * np.nan, TWO), (SQUARE, np.zeros((0, 3), dtype=int))]:
        with pytest.raises(DataError, match="^as_mesh: .* must "):
            as_mesh(trimesh.Trimesh(position, faces, process=False))
