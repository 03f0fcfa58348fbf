"""Each model's value, texel by texel, from plain arrays: the slow oracle of `Material.shade`."""

import math

import numpy as np
from reference.bases import BASES
from reference.interpolate import plane_value
from reference.lobes import LOBES


def _weighted(terms, coefficients):
    """Return sum_k terms[k] * coefficients[3 k + c] for each channel c."""
    return [sum(t * coefficients[3 * k + c] for k, t in enumerate(terms)) for c in range(3)]


def _texture(maps, options, light, view, row, column):
    return [a * light[2] for a in maps["albedo"][:, row, column]]


def _lambert(maps, options, light, view, row, column):
    normal = maps["normal"][:, row, column]
    length = math.sqrt(sum(n * n for n in normal))
    n_dot_l = sum(n * k for n, k in zip(normal, light, strict=True)) / length if length > 0 else 0.0
    return [a * max(0.0, n_dot_l) for a in maps["albedo"][:, row, column]]


def _ptm(maps, options, light, view, row, column):
    return _weighted(BASES["polynomial"](light, view), maps["polynomial"][:, row, column])


def _lptm(maps, options, light, view, row, column):
    luminance = sum(t * a for t, a in zip(BASES["polynomial"](light, view), maps["luminance"][:, row, column], strict=True))
    return [luminance * c for c in maps["chroma"][:, row, column]]


def _hsh(maps, options, light, view, row, column):
    return _weighted(BASES[f"hsh{options.get('terms', 9)}"](light, view), maps["harmonic"][:, row, column])


def _phong_srf(maps, options, light, view, row, column):
    lobe = LOBES[options.get("base", "phong")](maps["lobe"], light, view)
    residual = _weighted(BASES[options.get("residual", "half")](light, view), maps["residual"][:, row, column])
    return [a + b for a, b in zip(lobe, residual, strict=True)]


def _projected(light, view):
    return np.array([light[0], light[1], view[0], view[1]])


def _pca(maps, options, light, view, row, column):
    weight = plane_value(maps["directions"][:, 0].T, maps["weight"][:, 0].T, _projected(light, view))
    return _weighted(weight, maps["component"][:, row, column])


def _local_pca(maps, options, light, view, row, column):
    cluster = int(maps["cluster"][0, row, column])
    curves = plane_value(maps["directions"][:, 0].T, maps["reflectance"][:, cluster].T, _projected(light, view))
    return _weighted([1.0, *maps["weight"][:, row, column]], curves)


VALUES = {
    "texture": _texture, "lambert": _lambert, "ptm": _ptm, "lptm": _lptm, "hsh": _hsh, "phong_srf": _phong_srf,
    "pca": _pca, "local_pca": _local_pca,
}


def shade(name, maps, options, light, view, height, width):
    """Return [3, H, W] for `light`, `view` [3, 1, 1] or [3, H, W]; 0 below the horizon, never negative."""
    light, view = (np.broadcast_to(d, (3, height, width)) for d in (light, view))
    picture = np.zeros((3, height, width))
    for row in range(height):
        for column in range(width):
            one, other = light[:, row, column], view[:, row, column]
            if one[2] > 0 and other[2] > 0:
                value = VALUES[name](maps, options, one, other, row, column)
                picture[:, row, column] = [max(0.0, v) for v in value]
    return picture
