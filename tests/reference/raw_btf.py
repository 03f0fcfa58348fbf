"""Images between measured lights and views, pixel by pixel: the triangle is the face of the sphere's convex hull.

The code under test triangulates a disc; here three directions belong together when no other one lies beyond the plane
through them, seen from below the surface.
"""

from itertools import combinations

import numpy as np


def disc(direction):
    """Return the parabolic projection of one direction."""
    return np.array(direction[:2]) / (1 + direction[2])


def solve_triangle(corners, point):
    """Return the barycentric weights of `point` among three points of the plane."""
    matrix = np.vstack((np.array(corners).T, np.ones(3)))
    return np.linalg.solve(matrix, np.append(point, 1.0))


def is_face(known, triple):
    """Tell whether all other directions lie on the side of the plane through three where the south pole is."""
    a, b, c = (known[i] for i in triple)
    normal = np.cross(b - a, c - a)
    side = np.sign(normal @ (np.array([0, 0, -1.0]) - a))
    return all(side * (normal @ (known[i] - a)) > 0 for i in range(len(known)) if i not in triple)


def around(known, wanted):
    """Return ({number: weight}, ratio of the cosines) of the known directions around `wanted`."""
    point = disc(wanted)
    for triple in combinations(range(len(known)), 3):
        weights = solve_triangle([disc(known[i]) for i in triple], point)
        if weights.min() >= 0 and is_face(known, triple):
            return dict(zip(triple, weights, strict=True)), 1.0
    best = (np.inf, None, None)
    for pair in combinations(range(len(known)), 2):
        start, end = disc(known[pair[0]]), disc(known[pair[1]])
        share = np.clip((point - start) @ (end - start) / ((end - start) @ (end - start)), 0, 1)
        reached = start + share * (end - start)
        distance = np.linalg.norm(point - reached)
        if distance < best[0]:
            best = (distance, {pair[0]: 1 - share, pair[1]: share}, reached)
    squared = best[2] @ best[2]
    return best[1], wanted[2] / ((1 - squared) / (1 + squared))


def shaded(images, valid, lights, views, uv, light, view, tiles):
    """Return the value [3] of one point; `images` [light, view, 3, H, W], `valid` [light, view, H, W] of 0 and 1."""
    if light[2] <= 0 or view[2] <= 0:
        return np.zeros(3)
    (near_lights, ratio), (near_views, _) = around(lights, light), around(views, view)
    height, width = images.shape[-2:]
    x, y = uv[0] * width - 0.5, (1 - uv[1]) * height - 0.5
    total, counted = np.zeros(3), 0.0
    for number, light_weight in near_lights.items():
        for other, view_weight in near_views.items():
            for row in (int(np.floor(y)), int(np.floor(y)) + 1):
                for column in (int(np.floor(x)), int(np.floor(x)) + 1):
                    share = (1 - abs(y - row)) * (1 - abs(x - column)) * light_weight * view_weight
                    at = (row % height, column % width) if tiles else (
                        min(max(row, 0), height - 1), min(max(column, 0), width - 1))
                    there = valid[number, other][at]
                    total += share * there * images[number, other][:, at[0], at[1]]
                    counted += share * there
    return ratio * total / counted if counted > 0 else total
