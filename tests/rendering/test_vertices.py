"""Normals and tangents against slow loops: what is smoothed and joined, and what is not."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from tests.reference import mesh as oracle
from tests.rendering.mesh_files import CUBE, CUBE_FACES, SQUARE, SQUARE_UV, TWO, assert_frames_hold, bumpy, corners, put_obj

from torchmat.rendering import vertices
from torchmat.rendering.mesh import load_mesh


def smooth(position, faces, crease: float = 40) -> np.ndarray:
    """Return the normals [F, 3, xyz] of corners whose numbers tell their places."""
    normal, rows = vertices.smooth_normals(np.asarray(position, np.float64), faces, faces, math.radians(crease))
    return normal[rows]


@pytest.mark.parametrize("crease", [5, 30, 60, 170])
def test_smooth_normals_agree_with_the_oracle(crease):
    position, faces, _ = bumpy(seed=crease)
    found = smooth(position, faces, crease)
    assert np.abs(found - oracle.smooth_normals(position, faces, math.radians(crease))).max() < 1e-12


def test_a_cube_without_normals_has_hard_edges(tmp_path):
    mesh = load_mesh(put_obj(tmp_path / "cube.obj", CUBE, CUBE_FACES))
    assert len(mesh.position) == 24
    assert sorted(map(tuple, mesh.normal.unique(dim=0).tolist())) == [
        (-1, 0, 0), (0, -1, 0), (0, 0, -1), (0, 0, 1), (0, 1, 0), (1, 0, 0)
    ]


@pytest.mark.parametrize(("bend", "count"), [(39.9, 6), (40.1, 8)])
def test_an_edge_is_smooth_up_to_the_crease(bend, count, tmp_path):
    angle = math.radians(bend)
    position = np.array([[-1, 0, 0], [-1, 1, 0], [0, 0, 0], [0, 1, 0], [math.cos(angle), 0, -math.sin(angle)]])
    position = np.vstack((position, position[4] + (0, 1, 0)))
    faces = np.array([[0, 2, 3], [0, 3, 1], [2, 4, 5], [2, 5, 3]])
    mesh = load_mesh(put_obj(tmp_path / "bent.obj", position, faces), uv="planar")
    assert len(mesh.position) == count
    # u is x: on a flat piece the tangent runs down the slope, at the fold it does so only where that is hard.
    flat, slope = torch.tensor([1.0, 0, 0]), torch.tensor([math.cos(angle), 0, -math.sin(angle)])
    assert torch.allclose(mesh.tangent[mesh.faces[0, 0]], flat)
    assert torch.allclose(mesh.tangent[mesh.faces[2, 1]], slope)
    assert torch.allclose(mesh.tangent[mesh.faces[0, 1]], flat) == (count == 8)
    assert torch.allclose(mesh.tangent[mesh.faces[2, 0]], slope) == (count == 8)


def test_triangles_that_disagree_which_side_is_out_are_not_smoothed():
    faces = np.array([[0, 1, 2], [0, 3, 2]])
    normal = smooth(SQUARE * (1, 1, 0), faces)
    assert np.array_equal(normal[:, :, 2], [[1, 1, 1], [-1, -1, -1]])


def test_triangles_that_are_folded_onto_each_other_are_not_smoothed():
    position = np.array([[0, 0, 0], [1, 0, 0], [0.5, 1, 0], [0.5, 1, 0.2]])
    faces = np.array([[0, 1, 2], [0, 1, 3]])  # both go along the edge the same way
    normal = smooth(position, faces)
    assert np.array_equal(normal, np.repeat(vertices.face_normals(position[faces])[:, None], 3, axis=1))


def test_an_edge_of_three_triangles_is_hard():
    position = np.array([[0, 0, 0], [0, 1, 0], [-1, 0.5, 0], [1, 0.5, 0.1], [1, 0.5, -0.1]])
    faces = np.array([[0, 1, 2], [1, 0, 3], [1, 0, 4]])
    normal = smooth(position, faces)
    assert np.array_equal(normal, np.repeat(vertices.face_normals(position[faces])[:, None], 3, axis=1))


@pytest.mark.parametrize("scale", [1e-18, 1e-6, 1e6, 1e14])
def test_size_does_not_matter(scale, tmp_path):
    position, faces, uv = bumpy(amplitude=0.1)
    one = load_mesh(put_obj(tmp_path / "one.obj", position, faces, uv))
    other = load_mesh(put_obj(tmp_path / "other.obj", position * scale, faces, uv))
    # float32 rounds the scaled positions anew
    assert np.abs(corners(one, "normal") - corners(other, "normal")).max() < 2e-6
    assert np.abs(corners(one, "tangent") - corners(other, "tangent")).max() < 2e-6


def test_tangents_agree_with_the_oracle_on_both_sides_of_a_mirror(tmp_path):
    position, faces, uv = bumpy(amplitude=0.15)
    mesh = load_mesh(put_obj(tmp_path / "bumpy.obj", position, faces, uv))
    assert_frames_hold(mesh)
    normal = oracle.smooth_normals(position, faces, math.radians(40))
    tangent, side = oracle.tangents(position[faces], normal, uv[faces])
    assert set(side) == {1, -1}
    assert np.abs(corners(mesh, "tangent") - tangent).max() < 1e-6
    assert np.array_equal(mesh.handedness[mesh.faces].numpy(), np.repeat(side[:, None], 3, axis=1))


def test_tangents_are_shared_across_a_smooth_edge_and_not_across_a_seam(tmp_path):
    # three triangles round (0, 0, 0): the second shares the first's uv, the third has its own along the edge
    position = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0.1], [0, 1, 0], [-1, 0.5, 0]], dtype=np.float64)
    path = tmp_path / "seam.obj"
    lines = ["v " + " ".join(map(str, row)) for row in position]
    lines += ["vt 0 0", "vt 1 0", "vt 1 1", "vt 0.4 1", "vt 3 3", "vt 3 4", "vt 2 4"]
    path.write_text("\n".join([*lines, "f 1/1 2/2 3/3", "f 1/1 3/3 4/4", "f 1/5 4/6 5/7"]) + "\n")
    mesh = load_mesh(path)
    at_origin = mesh.faces[:, 0]
    assert at_origin[0] == at_origin[1] != at_origin[2]
    assert torch.equal(mesh.normal[at_origin[0]], mesh.normal[at_origin[2]])
    points, uv = corners(mesh, "position"), corners(mesh, "uv")
    first, second = oracle.face_frame(points[0], uv[0])[0], oracle.face_frame(points[1], uv[1])[0]
    between = mesh.tangent[at_origin[0]].double().numpy()
    # Neither triangle's own direction, but one in between.
    assert between @ oracle.unit(first) < 0.9999 and between @ oracle.unit(second) < 0.9999
    assert np.dot(np.cross(first, between), np.cross(between, second)) > 0


def test_a_mirrored_texture_is_told_by_the_handedness(tmp_path):
    uv = SQUARE_UV * (-1, 1)
    mesh = load_mesh(put_obj(tmp_path / "mirrored.obj", SQUARE, TWO, uv))
    assert mesh.handedness.tolist() == [-1] * 4
    bitangent = mesh.handedness[:, None] * torch.linalg.cross(mesh.normal, mesh.tangent)
    assert np.allclose(mesh.tangent, [[-math.sqrt(0.5), 0, -math.sqrt(0.5)]] * 4)
    assert np.allclose(bitangent, [[0, 1, 0]] * 4)


def test_vertices_are_not_joined_across_a_mirror(tmp_path):
    position = np.array([[-1, 0, 0], [0, 0, 0], [1, 0, 0], [0, 1, 0]], dtype=np.float64)
    uv = np.array([[1, 0], [0, 0], [1, 0], [0, 1]], dtype=np.float64)
    mesh = load_mesh(put_obj(tmp_path / "butterfly.obj", position, [[0, 1, 3], [1, 2, 3]], uv))
    assert len(mesh.position) == 6
    assert mesh.tangent[mesh.faces[0]].tolist() == [[-1, 0, 0]] * 3
    assert mesh.tangent[mesh.faces[1]].tolist() == [[1, 0, 0]] * 3
    assert mesh.handedness[mesh.faces].tolist() == [[-1] * 3, [1] * 3]


def test_a_triangle_without_texture_area_leaves_its_neighbours_alone(tmp_path):
    position, faces, uv = bumpy(amplitude=0.1)
    path = put_obj(tmp_path / "whole.obj", position, faces, uv)
    whole = load_mesh(path)
    # Added: a triangle all of whose corners have one uv, and one whose corners' uv lie in a line.
    lines = ["v 9 0 0", "v 9 1 0", "vt 5 5", "vt 6 6", "vt 7 7", "f 7/43 43/43 44/43", "f 14/43 44/44 43/45"]
    path.write_text(path.read_text() + "\n".join(lines) + "\n")
    more = load_mesh(path)
    assert_frames_hold(more)
    same = slice(0, len(whole.faces))
    assert np.array_equal(corners(more, "tangent")[same][:40], corners(whole, "tangent")[:40])


def test_a_triangle_without_texture_area_has_one_handedness(tmp_path):
    position = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0], [2, 1, 0], [1, 1, 0]], dtype=np.float64)
    path = tmp_path / "between.obj"
    lines = ["v " + " ".join(map(str, row)) for row in position]
    # a plain one, a mirrored one, and between them one that has a corner of each
    lines += ["vt 0 0", "vt 1 0", "vt 0 1", "vt 2 0"]
    lines += ["f 1/1 2/2 3/3", "f 2/2 4/1 5/3", "f 2/2 5/4 3/3", "f 2/2 5/3 6/3"]
    path.write_text("\n".join(lines) + "\n")
    mesh = load_mesh(path)
    assert_frames_hold(mesh)
    for face in mesh.handedness[mesh.faces].tolist():
        assert len(set(face)) == 1


@pytest.mark.parametrize("uv", [np.zeros((4, 2)), np.array([[0, 0], [1, 1], [2, 2], [3, 3.0]])])
def test_texture_coordinates_without_any_area_count_as_none(uv, tmp_path):
    mesh = load_mesh(put_obj(tmp_path / "flat.obj", SQUARE, TWO, uv))
    assert mesh.mapping == "box"
    assert_frames_hold(mesh)


@pytest.mark.parametrize("slip", [0, 1e-12, 1e-8, 1e-5, 1e-3])
def test_normals_along_the_tangent_of_the_texture_get_a_frame(slip, tmp_path):
    position = SQUARE * (1, 1, 0.3)
    normal = np.tile([1, slip, 0.3], (4, 1))  # the texture's u runs up the slope
    mesh = load_mesh(put_obj(tmp_path / "odd.obj", position, TWO, SQUARE_UV, normal))
    assert_frames_hold(mesh)
    # Less than a millionth off, the direction would be that of the rounding.
    if slip < 1e-6:
        assert np.abs(mesh.tangent.numpy() - vertices.fallback_tangent(mesh.normal.double().numpy())).max() < 1e-6


def test_fallback_tangents_are_frames_for_every_normal():
    normal = np.random.default_rng(0).normal(size=(2000, 3))
    normal = np.vstack((normal, np.eye(3), -np.eye(3), [[1e-9, 0, -1], [1e-5, -1e-5, -1], [0, 1e-30, -1]]))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    tangent = vertices.fallback_tangent(normal)
    assert np.abs((tangent * normal).sum(axis=1)).max() < 1e-14
    assert np.abs(np.linalg.norm(tangent, axis=1) - 1).max() < 1e-14


def test_triangles_without_area_are_left_out_and_counted(tmp_path):
    position = np.vstack((SQUARE, (SQUARE[0] + SQUARE[1]) / 2))
    faces = [*TWO, [0, 0, 1], [0, 4, 1], [2, 2, 2]]
    mesh = load_mesh(put_obj(tmp_path / "some.obj", position, faces))
    assert (len(mesh.faces), mesh.dropped, len(mesh.position)) == (2, 3, 4)
    assert_frames_hold(mesh)


def test_a_thin_triangle_stays(tmp_path):
    mesh = load_mesh(put_obj(tmp_path / "thin.obj", [[0, 0, 0], [1, 0, 0], [0.5, 1e-6, 0]], [[0, 1, 2]]))
    assert mesh.normal.tolist() == [[0, 0, 1]] * 3


def test_distinct_rows_agree_with_numpy():
    columns = np.random.default_rng(0).integers(-3, 3, (4, 500))
    first, group = vertices.distinct(*columns)
    rows = columns.T
    assert len(first) == len(np.unique(rows, axis=0)) == group.max() + 1
    assert np.array_equal(rows[first][group], rows)


def test_distinct_rows_whose_products_meet_are_told_apart():
    multiplier, shift = 0x9E3779B97F4A7C15, 29
    mixed = [(value * multiplier) % 2**64 for value in (1, 2)]
    # the second column makes up for the difference of the first
    differ = mixed[0] ^ (mixed[0] >> shift) ^ mixed[1] ^ (mixed[1] >> shift)
    second = np.array([0, differ, 0], dtype=np.uint64).astype(np.int64)
    first, group = vertices.distinct(np.array([1, 2, 1]), second)
    assert len(first) == 2 and group[0] == group[2] != group[1]
