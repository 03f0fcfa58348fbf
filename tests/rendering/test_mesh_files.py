"""Mesh files of every format there and back: positions, texture coordinates, normals, nodes and parts."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from tests.reference import mesh as oracle
from tests.rendering.mesh_files import CUBE, CUBE_FACES, SQUARE, SQUARE_UV, TWO, assert_frames_hold, bumpy, corners, glb_of
from tests.rendering.mesh_files import open_edges, put_obj, put_ply, put_stl

from torchmat.errors import DataError
from torchmat.rendering.mesh import load_mesh


def put_any(kind: str, folder, position, faces, uv=None, normal=None):
    """Write a mesh in a format; glTF's v runs down."""
    path = folder / f"mesh of wool ü.{kind.removesuffix('_ascii')}"
    if kind == "obj":
        return put_obj(path, position, faces, uv, normal)
    if kind == "glb":
        part = {"position": position, "faces": faces}
        part |= {} if uv is None else {"uv": np.asarray(uv) * (1, -1) + (0, 1)}
        path.write_bytes(glb_of([part | ({} if normal is None else {"normal": normal})], [{"mesh": 0}]))
        return path
    return put_ply(path, position, faces, uv, normal, binary=kind == "ply")


KINDS = ["obj", "ply", "ply_ascii", "glb"]


@pytest.mark.parametrize("kind", KINDS)
def test_a_file_comes_back(kind, tmp_path):
    position, faces, uv = bumpy()
    mesh = load_mesh(put_any(kind, tmp_path, position, faces, uv))
    assert_frames_hold(mesh)
    assert (mesh.name, mesh.mapping, mesh.dropped) == ("mesh of wool ü", "file", 0)
    assert np.array_equal(corners(mesh, "position"), position[faces])
    # 1 - v and back is rounded to float32 once
    assert np.abs(corners(mesh, "uv") - uv[faces]).max() < 1e-6


@pytest.mark.parametrize("kind", KINDS)
def test_normals_of_a_file_are_kept_scaled_to_length_one(kind, tmp_path):
    position, faces, uv = bumpy()
    given = np.random.default_rng(1).uniform(-0.3, 0.3, position.shape) + (0, 0, 1)
    mesh = load_mesh(put_any(kind, tmp_path, position, faces, uv, 3 * given))
    expected = given / np.linalg.norm(given, axis=1, keepdims=True)
    assert np.abs(corners(mesh, "normal") - expected[faces]).max() < 2e-7


@pytest.mark.parametrize("kind", KINDS)
def test_normals_that_a_file_leaves_zero_are_computed(kind, tmp_path):
    given = np.array([[0, 0, 1], [0, 0, 0], [0, 0, 1], [0, 0, 1.0]])
    mesh = load_mesh(put_any(kind, tmp_path, SQUARE, TWO, SQUARE_UV, given))
    normal = mesh.normal[mesh.position[:, 0] + 2 * mesh.position[:, 1] == 1]
    assert normal.tolist() == [pytest.approx([-math.sqrt(0.5), 0, math.sqrt(0.5)])]


def test_an_stl_is_joined_where_corners_meet(tmp_path):
    mesh = load_mesh(put_stl(tmp_path / "cube.stl", CUBE, CUBE_FACES))
    assert np.array_equal(corners(mesh, "position"), CUBE[CUBE_FACES])
    assert len(mesh.position) == 24 and mesh.mapping == "box"
    assert open_edges(mesh) == []


def test_a_polygon_and_windows_line_ends_and_a_missing_library_of_materials(tmp_path):
    path = put_obj(tmp_path / "a.obj", SQUARE, [[0, 1, 2, 3]], SQUARE_UV, before="mtllib gone.mtl\nusemtl red")
    path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))
    mesh = load_mesh(path)
    assert len(mesh.faces) == 2 and len(mesh.position) == 4 and mesh.mapping == "file"


def test_groups_and_materials_of_an_obj_become_one_mesh(tmp_path):
    path = tmp_path / "parts.obj"
    path.write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nv 5 0 0\nv 6 0 0\nv 5 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nvt 1 1\n"
        "o first\nusemtl a\nf 1/1 2/2 3/3\nf 2/2 4/4 3/3\no second\ng g2\nusemtl b\nf 5/1 6/2 7/3\n"
    )
    mesh = load_mesh(path)
    assert len(mesh.faces) == 3 and len(mesh.position) == 7
    assert float(mesh.bounds[1, 0]) == 6 and mesh.mapping == "file"


def test_parts_of_a_scene_stand_where_their_nodes_put_them(tmp_path):
    quarter = [0.0, math.sqrt(0.5), 0.0, math.sqrt(0.5)]  # a quarter turn about y: +z goes to +x
    flat = SQUARE * (1, 1, 0)
    parts = [{"position": flat, "faces": TWO, "uv": SQUARE_UV * (1, -1), "normal": np.tile([0.0, 0, 1], (4, 1))}]
    nodes = [
        {"mesh": 0}, {"mesh": 0, "rotation": quarter, "translation": [10, 0, 0], "scale": [2, 3, 1]},
        {"mesh": 0, "scale": [-1, 1, 1], "translation": [-5, 0, 0]},
    ]
    path = tmp_path / "scene.glb"
    path.write_bytes(glb_of(parts, nodes))
    mesh = load_mesh(path)
    assert_frames_hold(mesh)
    assert len(mesh.faces) == 6
    # by hand: from where to where in x, y and z, and the normal
    places = [
        ([0, 0, 0], [1, 1, 0], [0, 0, 1]), ([10, 0, -2], [10, 3, 0], [1, 0, 0]), ([-6, 0, 0], [-5, 1, 0], [0, 0, 1]),
    ]
    for low, high, normal in places:
        inside = (mesh.position[:, 0] > low[0] - 1e-5) & (mesh.position[:, 0] < high[0] + 1e-5)
        assert int(inside.sum()) == 4
        assert np.allclose(mesh.normal[inside], normal, atol=1e-6)
        assert np.allclose(mesh.position[inside].amin(dim=0), low, atol=1e-5)
        assert np.allclose(mesh.position[inside].amax(dim=0), high, atol=1e-5)
    points, given = corners(mesh, "position"), corners(mesh, "normal")
    # A mirror turns the triangles round, so that they still face the way of their normals, and mirrors the texture.
    assert all(oracle.face_normal(point) @ normal[0] > 0.99 for point, normal in zip(points, given, strict=True))
    assert sorted(mesh.handedness.tolist()) == [-1] * 4 + [1] * 8


def test_normals_stay_across_a_surface_that_a_node_scales_unevenly(tmp_path):
    part = {"position": SQUARE, "faces": TWO, "normal": np.tile([-1.0, 0, 1], (4, 1))}
    path = tmp_path / "stretched.glb"
    path.write_bytes(glb_of([part], [{"mesh": 0, "scale": [5, 1, -2]}]))
    mesh = load_mesh(path)
    for point, normal in zip(corners(mesh, "position"), corners(mesh, "normal"), strict=True):
        assert np.allclose(normal, oracle.face_normal(point), atol=1e-6)


def test_a_gltf_part_keeps_its_texture_coordinates_with_and_without_a_material(tmp_path):
    part = {"position": SQUARE, "faces": TWO, "uv": [[0, 1], [0.5, 1], [0.5, 0.75], [0, 0.75]]}
    for name, more in {"without": {}, "with": {"material": 0}}.items():
        path = tmp_path / f"{name}.glb"
        path.write_bytes(glb_of([part | more], [{"mesh": 0}], **({"materials": [{"name": "red"}]} if more else {})))
        mesh = load_mesh(path)
        assert mesh.mapping == "file"
        assert np.array_equal(corners(mesh, "uv"), SQUARE_UV[TWO])


def test_a_gltf_with_its_numbers_in_a_file_beside_it(tmp_path):
    glb = glb_of([{"position": SQUARE, "faces": TWO, "uv": SQUARE_UV * (1, -1) + (0, 1)}], [{"mesh": 0}])
    length = int.from_bytes(glb[12:16], "little")
    tree = json.loads(glb[20:20 + length])
    tree["buffers"][0]["uri"] = "numbers.bin"
    (tmp_path / "numbers.bin").write_bytes(glb[28 + length:])
    (tmp_path / "scene.gltf").write_text(json.dumps(tree))
    mesh = load_mesh(tmp_path / "scene.gltf")
    assert np.array_equal(corners(mesh, "position"), SQUARE[TWO])
    assert np.array_equal(corners(mesh, "uv"), SQUARE_UV[TWO])
    (tmp_path / "numbers.bin").unlink()
    with pytest.raises(DataError, match=r"scene\.gltf: the file of buffer 0 must exist; there is no 'numbers\.bin'"):
        load_mesh(tmp_path / "scene.gltf")


def test_points_and_lines_beside_triangles_are_left_out(tmp_path):
    points, lines = ({"position": SQUARE + 9, "mode": mode} for mode in (0, 1))
    parts = [points, {"position": SQUARE, "faces": TWO}, lines]
    path = tmp_path / "mixed.glb"
    path.write_bytes(glb_of(parts, [{"mesh": 0}, {"mesh": 1}, {"mesh": 2}]))
    assert load_mesh(path).bounds.tolist() == [[0, 0, 0], [1, 1, 1]]


def test_parts_without_texture_coordinates_get_the_projection(tmp_path):
    parts = [{"position": SQUARE, "faces": TWO, "uv": SQUARE_UV}, {"position": SQUARE + 9, "faces": TWO}]
    path = tmp_path / "half.glb"
    path.write_bytes(glb_of(parts, [{"mesh": 0}, {"mesh": 1}]))
    mesh = load_mesh(path)
    assert mesh.mapping == "file and box"
    assert_frames_hold(mesh)
