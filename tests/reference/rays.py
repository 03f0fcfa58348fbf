"""Slow float64 oracles of the render room: plain loops over rays and triangles, sharing no code with the package."""

from __future__ import annotations

import math

import numpy as np


def meet(origin: np.ndarray, direction: np.ndarray, triangle: np.ndarray) -> tuple[float, np.ndarray] | None:
    """Return the distance to a triangle [3, 3] and its corners' shares, or None: a linear system of three unknowns."""
    a, b, c = triangle
    system = np.stack((b - a, c - a, -direction), axis=1)
    if abs(np.linalg.det(system)) < 1e-14:
        return None
    v, w, distance = np.linalg.solve(system, origin - a)
    share = np.array([1 - v - w, v, w])
    return (distance, share) if distance > 0 and share.min() >= 0 else None


def first_hit(origin: np.ndarray, direction: np.ndarray, triangles: np.ndarray) -> tuple[int, float, np.ndarray]:
    """Return the number (-1: none), distance and shares of the triangle of [F, 3, 3] that a ray meets first."""
    nearest = (-1, math.inf, np.zeros(3))
    for number, triangle in enumerate(triangles):
        found = meet(origin, direction, triangle)
        if found is not None and found[0] < nearest[1]:
            nearest = (number, *found)
    return nearest


def crossings(point: np.ndarray, triangles: np.ndarray, direction: np.ndarray) -> int:
    """Return how often a ray from a point leaves the surface less how often it enters: 1 inside of a closed one."""
    total = 0
    for triangle in triangles:
        if meet(point, direction, triangle) is not None:
            normal = np.cross(triangle[1] - triangle[0], triangle[2] - triangle[0])
            total += 1 if normal @ direction > 0 else -1
    return total
