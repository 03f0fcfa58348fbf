"""Newell's teapot: the published control points, the surface they define, and no cracks between patches."""

from __future__ import annotations

import numpy as np
import pytest
from tests.rendering.mesh_files import corners, open_edges
from tests.support import shared_path

from torchmat.rendering import teapot
from torchmat.rendering.shapes import make_mesh


def published_patches(path) -> np.ndarray:
    lines = path.read_text().split()
    count = int(lines[0])
    numbers = np.array([[int(k) - 1 for k in line.split(",")] for line in lines[1:1 + count]])
    points = np.array([[float(k) for k in line.split(",")] for line in lines[2 + count:]])
    assert int(lines[1 + count]) == len(points)
    return points[numbers].reshape(count, 4, 4, 3)


def de_casteljau(points: np.ndarray, t: float) -> np.ndarray:
    while len(points) > 1:
        points = (1 - t) * points[:-1] + t * points[1:]
    return points[0]


def surface(patch: np.ndarray, t: float, s: float) -> np.ndarray:
    """Return a point of a patch [4, 4, 3]; t runs along rows, s along columns."""
    return de_casteljau(np.array([de_casteljau(row, s) for row in patch]), t)


def in_scene(vector: np.ndarray) -> np.ndarray:
    """Turn z up into y up."""
    return np.stack((vector[..., 0], vector[..., 2], -vector[..., 1]), axis=-1)


def test_control_points_are_the_published_ones_to_the_bit():
    published = published_patches(shared_path("meshes/teapot/newell_patches_teapot.txt"))
    ours = list(teapot.control_points())
    assert len(published) == len(ours) == teapot.PATCHES
    for patch in published:
        found = [number for number, other in enumerate(ours) if np.array_equal(patch, other)]
        assert len(found) == 1
        ours.pop(found[0])


def test_a_few_control_points_by_hand():
    points = teapot.control_points()
    assert points[0, 0].tolist() == [[1.4, 0, 2.4], [1.4, -0.784, 2.4], [0.784, -1.4, 2.4], [0, -1.4, 2.4]]
    assert points[1, 3].tolist() == [[0, -1.5, 2.4], [-0.84, -1.5, 2.4], [-1.5, -0.84, 2.4], [-1.5, 0, 2.4]]
    assert points[20, 3].tolist() == [[1.5, 0, 0.15], [1.5, 0.84, 0.15], [0.84, 1.5, 0.15], [0, 1.5, 0.15]]
    assert points[31, 3].tolist() == [[3.2, 0, 2.4], [3.2, 0.15, 2.4], [2.8, 0.15, 2.4], [2.8, 0, 2.4]]


def test_patches_with_a_pole_are_those_whose_first_row_is_one_point():
    points = teapot.control_points()
    assert {k for k in range(32) if (points[k, 0] == points[k, 0, 0]).all()} == teapot.WITH_POLE


def test_positions_lie_on_the_surface_and_normals_across_it():
    segments, step = 4, 1e-5
    position, normal, uv, tangent = teapot.patches(segments)
    points = teapot.control_points()
    exact = np.array([
        [[in_scene(surface(patch, 1 - v / segments, 1 - u / segments)) for u in range(5)] for v in range(5)]
        for patch in points
    ])
    tip = max(surface(points[30], t, 1.0)[0] for t in np.linspace(0.4, 0.42, 2001))
    middle, width = np.array([(tip - 3) / 2, 3.15 / 2, 0]), tip + 3
    assert np.abs(position - (exact - middle) * 2 / width).max() < 1e-9
    for number, patch in enumerate(points):
        for row, column in [(1, 1), (2, 3), (3, 2), (1, 0), (2, 4)]:
            t, s = 1 - row / segments, 1 - column / segments
            along = in_scene(surface(patch, t, s - step) - surface(patch, t, s + step))
            up = in_scene(surface(patch, t - step, s) - surface(patch, t + step, s))
            across = np.cross(along, up)
            assert np.abs(normal[number, row, column] - across / np.linalg.norm(across)).max() < 1e-8
            assert np.abs(tangent[number, row, column] - along / np.linalg.norm(along)).max() < 1e-8


def test_normals_at_the_poles_are_the_limit():
    position, normal, _, tangent = teapot.patches(8)
    for number in teapot.WITH_POLE:
        up = 1.0 if position[number, -1, 0, 1] > 0 else -1.0
        assert np.abs(normal[number, -1] - [0, up, 0]).max() < 1e-12
        # Tangents there go on from those of the ring below, a quarter turn about the pole for each patch.
        assert ((tangent[number, -1, 1:] * tangent[number, -2, 1:]).sum(-1) > 0.99).all()
        assert np.abs(position[number, -1, :, [0, 2]].T - position[number, -1, 0, [0, 2]]).max() == 0


def test_patches_meet_to_the_last_bit_of_float64():
    position = teapot.patches(13)[0]
    edge = np.concatenate([position[:, 0], position[:, -1], position[:, :, 0], position[:, :, -1]]).reshape(-1, 3)
    assert len(np.unique(edge, axis=0)) == len(np.unique(edge.round(9) + 0.0, axis=0)) < 0.6 * len(edge)


def test_a_corner_at_a_pole_lies_in_the_middle_of_its_column():
    mesh = make_mesh("teapot", segments=4)
    points, uv = corners(mesh, "position"), corners(mesh, "uv")
    axis = points[np.abs(points[..., 1]).argmax() // 3].copy()[:, [0, 2]].min(axis=0)  # of the pot, at the knob's top
    at_pole = (np.abs(points[..., [0, 2]] - axis).max(axis=-1) < 1e-6) & (np.abs(points[..., 1]) > 0.48)
    assert at_pole.sum() == 8 * 4
    others = np.where(at_pole[..., None], 0, uv).sum(axis=1)[at_pole.any(axis=1)] / 2
    assert np.allclose(uv[at_pole][:, 0], others[:, 0])
    assert (uv[at_pole][:, 1] == 1).all()


def test_only_the_published_gaps_are_open():
    mesh = make_mesh("teapot", segments=8)
    edges = open_edges(mesh)
    follow: dict[bytes, bytes] = dict(edges)
    assert len(follow) == len(edges)
    loops = []
    while follow:
        start, point = next(iter(follow.items()))
        loop = [follow.pop(start)]
        while loop[-1] != start:
            loop.append(follow.pop(loop[-1]))
        loops.append(np.array([np.frombuffer(point, dtype=np.float32) for point in loop]))
    # Four quarters of 8 steps: the rim's inside, the lid's edge. Two halves: the two ends of the handle and the spout.
    assert sorted(len(loop) for loop in loops) == [16, 16, 16, 16, 32, 32]
    lid_and_rim = [loop for loop in loops if len(loop) == 32]
    assert all(np.ptp(loop[:, 1]) == 0 for loop in lid_and_rim)


def test_the_teapot_stands_upright_with_its_spout_to_the_right():
    mesh = make_mesh("teapot")
    low, high = mesh.bounds
    # The handle ends at -3 of the data; 32 steps along a patch miss the spout's outermost point by 6e-6.
    assert (high - low).tolist() == pytest.approx([2, 2 * 3.15 / 6.434036, 2 * 4 / 6.434036], rel=1e-5)
    at_tip, at_handle = mesh.position[mesh.position[:, 0].argmax()], mesh.position[mesh.position[:, 0].argmin()]
    assert float(at_tip[1]) > 0.2 > float(at_handle[1])
    bottom = mesh.position[:, 1] == low[1]
    assert bool((mesh.normal[bottom][:, 1] < -0.999).all())


def test_each_patch_has_a_whole_texture_that_rises_on_the_body():
    mesh = make_mesh("teapot", segments=4)
    # 32 triangles a patch, but 28 where they meet in a pole.
    ends = np.cumsum([28 if number in teapot.WITH_POLE else 32 for number in range(32)])[:-1]
    textures = np.split(corners(mesh, "uv"), ends)
    for number, uv in enumerate(textures):
        one, other = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
        area = (one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]) / 2
        assert (area > 0).all()
        # At a pole half of the last row of 4 is the other, empty triangle of each column.
        assert area.sum() == pytest.approx(0.875 if number in teapot.WITH_POLE else 1)
    up = np.cross(corners(mesh, "normal"), corners(mesh, "tangent"))[..., 1]
    assert (np.concatenate(np.split(up, ends)[4:12]) > 0.1).all()
