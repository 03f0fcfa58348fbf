"""Polygons cut into triangles: the same area, the same side, no corner lost."""

from __future__ import annotations

import math

import numpy as np
import pytest

from torchmat.rendering.polygons import triangulate

L_SHAPE = np.array([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2.0]])


def in_space(flat, turn: float = 0.7) -> np.ndarray:
    """Lay a polygon [n, 2] into a tilted plane."""
    right = np.array([math.cos(turn), 0, math.sin(turn)])
    up = np.array([0.3 * math.sin(turn), 1, -0.3 * math.cos(turn)])
    return np.asarray(flat, float) @ np.stack((right, up / np.linalg.norm(up)))


def areas(position: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return the areas of triangles, negative where they face away from the polygon."""
    normal = np.cross(position, np.roll(position, -1, axis=0)).sum(axis=0)
    a, b, c = position[triangles].transpose(1, 0, 2)
    return np.cross(b - a, c - a) @ (normal / np.linalg.norm(normal)) / 2


def cut(position: np.ndarray) -> np.ndarray:
    return triangulate(position, np.arange(len(position)), np.array([len(position)]))


@pytest.mark.parametrize("start", range(6))
@pytest.mark.parametrize("turn", [0, 0.7, 2.0, 4.0])
def test_an_l_shape_is_covered_once_from_whichever_corner(start, turn):
    position = in_space(np.roll(L_SHAPE, start, axis=0), turn)
    triangles = cut(position)
    found = areas(position, triangles)
    assert len(triangles) == 4 and set(triangles.reshape(-1).tolist()) == set(range(6))
    assert found.sum() == pytest.approx(3) and found.min() > 0


def test_a_fan_stays_a_fan_where_it_covers_the_polygon():
    square = in_space([[0, 0], [1, 0], [1, 1], [0, 1]])
    assert cut(square).tolist() == [[0, 1, 2], [0, 2, 3]]
    ring = np.stack((np.cos(np.arange(7)), np.sin(np.arange(7))), axis=1)[:6]
    assert cut(in_space(ring)).tolist() == [[0, k, k + 1] for k in range(1, 5)]


def test_an_arrow_is_cut_along_its_inner_diagonal():
    arrow = in_space([[0, 0], [2, -1], [0.5, 0], [2, 1]])  # corner 2 is drawn in
    position = np.roll(arrow, 1, axis=0)
    assert sorted(map(sorted, cut(position).tolist())) == [[0, 1, 3], [1, 2, 3]]
    assert areas(position, cut(position)).min() > 0


def test_corners_on_a_straight_edge_make_no_flat_triangle():
    position = in_space([[0, 0], [1, 0], [2, 0], [2, 2], [0, 2]])
    found = areas(position, cut(position))
    assert found.min() > 0.1 and found.sum() == pytest.approx(4)


@pytest.mark.parametrize("teeth", [3, 20, 60])
def test_a_comb_is_covered(teeth):
    x = np.arange(2 * teeth + 1)
    flat = np.vstack((np.stack((x[::-1], np.where(x[::-1] % 2, 3.0, 1.0)), axis=1), [[0, 0], [2 * teeth, 0]]))
    position = in_space(flat)
    triangles = cut(position)
    found = areas(position, triangles)
    expected = 0.5 * abs(np.sum(flat[:, 0] * np.roll(flat[:, 1], -1) - np.roll(flat[:, 0], -1) * flat[:, 1]))
    assert len(triangles) == len(flat) - 2
    assert found.min() > 0 and found.sum() == pytest.approx(expected)


def test_a_hole_that_a_bridge_joins_to_the_border():
    outer, hole = [[0, 0], [4, 0], [4, 4], [0, 4]], [[1, 1], [1, 3], [3, 3], [3, 1]]
    position = in_space([*outer, outer[0], *hole, hole[0]])
    found = areas(position, cut(position))
    assert found.sum() == pytest.approx(12) and found.min() > -1e-12


def test_a_polygon_out_of_its_plane_faces_one_way():
    flat = np.array([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2.0]])
    position = np.hstack((flat, 0.2 * np.sin(3 * flat[:, :1] + flat[:, 1:])))
    triangles = cut(position)
    seen = areas(np.hstack((flat, np.zeros((6, 1)))), triangles)
    assert seen.min() > 0 and seen.sum() == pytest.approx(3)


def test_sizes_may_be_mixed_and_triangles_keep_the_order_of_their_polygons():
    position = np.vstack((in_space(L_SHAPE), in_space([[9, 0], [9, 1], [8, 0]]), in_space([[5, 0], [6, 0], [6, 1], [5, 1]])))
    triangles = triangulate(position, np.arange(13), np.array([6, 3, 4]))
    assert [set(range(6)), {6, 7, 8}, set(range(9, 13))] == [
        set(triangles[part].reshape(-1).tolist()) for part in (slice(0, 4), slice(4, 5), slice(5, 7))
    ]


@pytest.mark.parametrize("flat", [
    np.zeros((5, 2)), np.stack((np.arange(6.0), np.arange(6.0)), axis=1), [[0, 0], [1, 1], [1, 0], [0, 1]],
    [[math.cos(0.8 * math.pi * k), math.sin(0.8 * math.pi * k)] for k in range(5)],
])
def test_what_has_no_right_answer_still_ends(flat):
    triangles = cut(in_space(flat))
    assert triangles.shape == (len(flat) - 2, 3)
    assert triangles.min() >= 0 and triangles.max() < len(flat)


def test_a_spiral_of_thousands_of_corners():
    angle = np.linspace(0, 40 * np.pi, 1500)
    arm = np.stack((angle * np.cos(angle), angle * np.sin(angle)), axis=1) + 1
    outer = np.stack(((angle + 3) * np.cos(angle), (angle + 3) * np.sin(angle)), axis=1) + 1
    flat = np.vstack((arm[::-1], outer))
    position = in_space(flat)
    found = areas(position, cut(position))
    assert np.abs(found).sum() == pytest.approx(abs(found.sum()), rel=1e-9)
