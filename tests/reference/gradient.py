"""Derivatives of scalar functions by central differences."""

import numpy as np


def central(function, point, step=1e-6):
    """Return d function / d point, an array of the shape of `point`."""
    point = np.array(point, dtype=np.float64)
    found = np.zeros_like(point)
    for index in np.ndindex(point.shape):
        kept = point[index]
        point[index] = kept + step
        above = function(point.copy())
        point[index] = kept - step
        below = function(point.copy())
        point[index] = kept
        found[index] = (above - below) / (2 * step)
    return found
