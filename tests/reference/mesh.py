"""Normals and tangents of a mesh by loops over triangles and pairs of corners, float64: slow and plain."""

from __future__ import annotations

import math

import numpy as np


def unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)


def face_normal(points: np.ndarray) -> np.ndarray:
    return unit(np.cross(points[1] - points[0], points[2] - points[0]))


def angle_at(points: np.ndarray, corner: int) -> float:
    one, other = unit(points[(corner + 1) % 3] - points[corner]), unit(points[(corner + 2) % 3] - points[corner])
    return math.acos(max(-1.0, min(1.0, float(one @ other))))


def smooth_normals(position: np.ndarray, faces: np.ndarray, crease: float) -> np.ndarray:
    """Return normals [F, 3, xyz]: the mean over triangles that smooth edges connect about the corner's point."""
    place = [[tuple(position[vertex]) for vertex in face] for face in faces]
    edges: dict[frozenset, list[tuple[int, int]]] = {}
    for number, face in enumerate(place):
        for corner in range(3):
            edges.setdefault(frozenset((face[corner], face[(corner + 1) % 3])), []).append((number, corner))
    normals = [face_normal(position[face]) for face in faces]
    beside: dict[int, list[tuple[int, frozenset]]] = {}
    for edge, both in edges.items():
        if len(both) != 2:
            continue
        (one, first), (other, second) = both
        if place[one][first] == place[other][second] or normals[one] @ normals[other] < math.cos(crease):
            continue
        beside.setdefault(one, []).append((other, edge))
        beside.setdefault(other, []).append((one, edge))
    result = np.empty((len(faces), 3, 3))
    for number, face in enumerate(place):
        for corner, point in enumerate(face):
            fan, waiting = {number}, [number]
            while waiting:
                for other, edge in beside.get(waiting.pop(), ()):
                    if point in edge and other not in fan:
                        fan.add(other)
                        waiting.append(other)
            total = sum(angle_at(position[faces[k]], place[k].index(point)) * normals[k] for k in fan)
            result[number, corner] = unit(total)
    return result


def face_frame(points: np.ndarray, uv: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return dP/du and dP/dv of a triangle, by solving for them."""
    edges, steps = (points[1:] - points[0]).T, (uv[1:] - uv[0]).T
    along = edges @ np.linalg.inv(steps)
    return along[:, 0], along[:, 1]


def tangents(points: np.ndarray, normal: np.ndarray, uv: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return tangent [F, 3, xyz] and handedness [F] for corners of triangles whose uv all have area.

    Summed by angle over corners that share position, normal, uv and handedness.
    """
    sides = np.array([
        np.sign(np.dot(np.cross(*face_frame(p, t)), face_normal(p))) for p, t in zip(points, uv, strict=True)
    ])
    totals: dict[tuple, np.ndarray] = {}
    keys = {}
    for number in range(len(points)):
        along = face_frame(points[number], uv[number])[0]
        for corner in range(3):
            n = normal[number, corner]
            # rounded: one normal summed in another order differs in its last digit
            key = (*points[number, corner], *np.round(n, 9), *uv[number, corner], sides[number])
            keys[number, corner] = key
            laid = unit(along - (along @ n) * n)
            totals[key] = totals.get(key, 0) + angle_at(points[number], corner) * laid
    result = np.array([[unit(totals[keys[number, corner]]) for corner in range(3)] for number in range(len(points))])
    return result, sides
