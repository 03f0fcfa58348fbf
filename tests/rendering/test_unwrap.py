"""Texture coordinates for meshes that have none: nothing smeared, mirrored or torn inside of a triangle."""

from __future__ import annotations

import math

import numpy as np
import pytest
from tests.reference import mesh as oracle
from tests.rendering.mesh_files import CUBE, CUBE_FACES, assert_frames_hold, bumpy, corners, put_obj

from torchmat.rendering import vertices
from torchmat.rendering.mesh import load_mesh
from torchmat.rendering.shapes import make_mesh
from torchmat.rendering.unwrap import PROJECTIONS, project


@pytest.mark.parametrize("kind", PROJECTIONS)
def test_a_projection_takes_the_place_of_a_files_coordinates(kind, tmp_path):
    ball = make_mesh("sphere", segments=24)
    path = put_obj(tmp_path / "ball.obj", ball.position.double().numpy(), ball.faces.numpy(), ball.uv.double().numpy())
    mesh = load_mesh(path, uv=kind)
    assert mesh.mapping == kind
    assert_frames_hold(mesh)
    if kind != "planar":
        # Seen from outside no texture is mirrored, and none jumps inside of a triangle.
        assert bool((mesh.handedness == 1).all())
        assert np.ptp(corners(mesh, "uv"), axis=1).max() < 0.45


def test_the_spherical_projection_is_the_spheres_own(tmp_path):
    ball = make_mesh("sphere", segments=24)
    mesh = load_mesh(put_obj(tmp_path / "ball.obj", ball.position.double().numpy(), ball.faces.numpy()), uv="spherical")
    difference = corners(mesh, "uv") - corners(ball, "uv")
    assert np.abs(difference[..., 1]).max() < 1e-6
    assert np.abs(difference[..., 0] - 4 * np.round(difference[..., 0] / 4)).max() < 1e-5


def test_the_cylindrical_projection_closes_and_keeps_the_aspect(tmp_path):
    turn = np.arange(16) * math.pi / 8
    ring = np.stack((0.5 * np.sin(turn), np.zeros(16), 0.5 * np.cos(turn)), axis=1)
    position = np.vstack((ring, ring + (0, 2.0, 0)))
    side = np.arange(16)
    after = (side + 1) % 16
    lower, upper = np.stack((side, after, after + 16), axis=1), np.stack((side, after + 16, side + 16), axis=1)
    faces = np.concatenate((lower, upper))
    mesh = load_mesh(put_obj(tmp_path / "tube.obj", position, faces), uv="cylindrical")
    # pi round, and the largest extent is 2: two repeats, each pi / 2 wide; so the height of 2 is 4 / pi of them
    assert np.ptp(corners(mesh, "uv")[..., 0], axis=1) == pytest.approx(np.full(32, 2 / 16), abs=1e-6)
    assert float(mesh.uv[:, 1].max()) == pytest.approx(4 / math.pi)
    assert float(mesh.uv[:, 1].min()) == 0


def test_the_box_projection_by_hand(tmp_path):
    mesh = load_mesh(put_obj(tmp_path / "brick.obj", CUBE * (4, 2, 1), CUBE_FACES))
    # 1 of uv is the largest extent of 4; u to the right and v up as seen from outside, y up
    expected = {
        (0, 0, 1): lambda p: (p[0], p[1]), (0, 0, -1): lambda p: (4 - p[0], p[1]),
        (1, 0, 0): lambda p: (1 - p[2], p[1]), (-1, 0, 0): lambda p: (p[2], p[1]),
        (0, 1, 0): lambda p: (p[0], 1 - p[2]), (0, -1, 0): lambda p: (p[0], p[2]),
    }
    for position, normal, uv in zip(mesh.position.tolist(), mesh.normal.tolist(), mesh.uv.tolist(), strict=True):
        assert uv == pytest.approx([k / 4 for k in expected[tuple(round(k) for k in normal)](position)])


def test_no_texture_of_the_box_projection_is_smeared_or_mirrored():
    position, faces, _ = bumpy(amplitude=1.5, seed=4)
    uv = project("box", position, faces, faces, vertices.face_normals(position[faces]))
    extent = np.ptp(position, axis=0).max()
    for points, texture in zip(position[faces], uv, strict=True):
        along, up = oracle.face_frame(points, texture)
        assert max(np.linalg.norm(along), np.linalg.norm(up)) <= 3 * extent * (1 + 1e-9)
        assert np.cross(along, up) @ oracle.face_normal(points) > 0


def test_bumps_between_two_sides_do_not_scatter_the_box_projection():
    # A slope of 45 degrees, lifted at random: half of its triangles would be seen from above, half from the front.
    position, faces, _ = bumpy(rows=12, columns=12, amplitude=0.1)
    rise = np.array([[1, 0, 0], [0, math.sqrt(0.5), -math.sqrt(0.5)], [0, math.sqrt(0.5), math.sqrt(0.5)]])
    position = position @ rise
    flat = vertices.face_normals(position[faces])
    assert 0.3 < (np.abs(flat[:, 1]) > np.abs(flat[:, 2])).mean() < 0.7
    uv = project("box", position, faces, faces, flat)
    extent, top, low = np.ptp(position, axis=0).max(), position[:, 2].max(), position[:, 1].min()
    from_front = np.isclose(uv[..., 1] * extent, position[faces][..., 1] - low).all(axis=1)
    from_above = np.isclose(uv[..., 1] * extent, top - position[faces][..., 2]).all(axis=1)
    assert (from_front ^ from_above).all()

    def seams(side: np.ndarray) -> int:
        of_edge: dict[frozenset, set] = {}
        for face, value in zip(faces.tolist(), side.tolist(), strict=True):
            for start, end in zip(face, face[1:] + face[:1], strict=True):
                of_edge.setdefault(frozenset((start, end)), set()).add(value)
        return sum(len(values) > 1 for values in of_edge.values())

    # Measured 50 against 111.
    assert seams(from_front) < 0.6 * seams(np.abs(flat[:, 1]) < np.abs(flat[:, 2]))
