"""Moving least squares over projected directions: the plane through the nearest neighbours, in value form.

The code under test turns the same plane into weights; here the plane itself is fitted and evaluated.
"""

import numpy as np

NEIGHBOURS, DAMPING = 12, 0.05


def plane_value(known, table, query):
    """Return the interpolated row of `table` [n, C] at `query` [4], from values known at `known` [n, 4]."""
    squared = [sum((query[k] - row[k]) ** 2 for k in range(4)) for row in known]
    nearest = sorted(range(len(known)), key=lambda i: squared[i])[:NEIGHBOURS]
    farthest = max(squared[nearest[-1]], 1e-12)
    weight = np.array([(1 - 0.999 * squared[i] / farthest) / (squared[i] / farthest + 1e-7) for i in nearest])
    weight /= weight.sum()
    points, values = known[nearest], table[nearest]
    centre, mean = weight @ points, weight @ values
    moment, cross = np.zeros((4, 4)), np.zeros((4, table.shape[1]))
    for share, point, value in zip(weight, points, values, strict=True):
        moment += share * np.outer(point - centre, point - centre)
        cross += share * np.outer(point - centre, value)
    damped = moment + (DAMPING * np.trace(moment) + 1e-6 * farthest) * np.eye(4)
    return mean + (query - centre) @ np.linalg.solve(damped, cross)
