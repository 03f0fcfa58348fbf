"""True results of the elementary functions, to any precision, from their definitions; `info` are the dtype's limits."""

from __future__ import annotations

import mpmath
import torch
from mpmath import cos, mpf, pi, sin
from mpmath import sqrt as root

MAP = ((0.25, 1.0, -0.5), (0.75, 0.0, 0.5))  # what look_up reads
HEIGHT = 0.375
_SOFTNESS = 0.05
_OPPOSITE = 1e-5
_WIDTH_OVER_HEIGHT = 2
_BALL = (mpf(0.25), mpf(-0.5), mpf(2))


def sqrt(info, x):
    return (root(x) if x > 0 else mpf(0),)


def divide(info, a, b):
    return (a / b if abs(b) >= info.tiny else mpf(0),)


def normalise(info, *vector):
    if max(abs(x) for x in vector) < info.tiny:
        return [mpf(0)] * len(vector)
    length = root(sum(x * x for x in vector))
    return [x / length for x in vector]


def acos(info, x):
    return (mpmath.acos(min(max(x, -1), 1)),)


def power(info, base, exponent):
    if base < info.tiny:
        return (mpf(1) if exponent == 0 else mpf(0),)
    logarithm = exponent * mpmath.log(base)
    return (mpmath.exp(logarithm) if logarithm < 1e5 else mpf(10) ** 40000,)


def from_polar(info, polar, azimuth):
    return sin(polar) * cos(azimuth), sin(polar) * sin(azimuth), cos(polar)


def to_polar(info, x, y, z):
    radius = root(x * x + y * y)
    if max(abs(x), abs(y)) < info.tiny:
        return mpmath.atan2(0, z), mpf(1), mpf(0)
    return mpmath.atan2(radius, z), x / radius, y / radius


def half_vector(info, *both):
    return normalise(info, *(both[k] + both[k + 3] for k in range(3)))


def tangent_frame(info, x, y, z):
    if z <= -1:
        return None
    shared = 1 / (1 + z)
    return 1 - x * x * shared, -x * y * shared, -x, -x * y * shared, 1 - y * y * shared, -y


def _rounded(info, number):
    """Return a threshold as the dtype holds it: at its one neighbour the other branch would be true."""
    return mpf(float(torch.tensor(number, dtype=getattr(torch, info.dtype))))


def srgb_to_linear(info, x):
    return (((x + mpf("0.055")) / mpf("1.055")) ** mpf("2.4") if x > _rounded(info, 0.04045) else x / mpf("12.92"),)


def linear_to_srgb(info, x):
    return (mpf("1.055") * x ** (1 / mpf("2.4")) - mpf("0.055") if x > _rounded(info, 0.0031308) else mpf("12.92") * x,)


def display(info, x):
    return linear_to_srgb(info, min(max(x, mpf(0)), mpf(1)))


def luminance(info, red, green, blue):
    return (mpf("0.2126") * red + mpf("0.7152") * green + mpf("0.0722") * blue,)


def srgb_to_lab(info, *encoded):
    """With the rounded matrix, white and threshold that sRGB's first edition prints."""
    linear = [srgb_to_linear(info, x)[0] for x in encoded]
    rows = (
        ("0.412453", "0.357580", "0.180423"),
        ("0.212671", "0.715160", "0.072169"),
        ("0.019334", "0.119193", "0.950227"),
    )
    scaled = []
    for row, white in zip(rows, ("0.95047", "1", "1.08883"), strict=True):
        t = sum(mpf(a) * b for a, b in zip(row, linear, strict=True)) / mpf(white)
        scaled.append(t ** (mpf(1) / 3) if t > mpf("0.008856") else mpf("7.787") * t + mpf(4) / 29)
    x, y, z = scaled
    return 116 * y - 16, 500 * (x - y), 200 * (y - z)


def ciede2000(info, *both):
    """Sharma, Wu, Dalal 2005, equations 2 to 22."""
    l_1, a_1, b_1, l_2, a_2, b_2 = both
    if any(0 < max(abs(a), abs(b)) < 2 * info.tiny for a, b in ((a_1, b_1), (a_2, b_2))):
        return None  # counts as grey
    seventh = ((root(a_1**2 + b_1**2) + root(a_2**2 + b_2**2)) / 2) ** 7
    stretch = 1 + (1 - root(seventh / (seventh + mpf(25) ** 7))) / 2
    a_1, a_2 = a_1 * stretch, a_2 * stretch
    c_1, c_2 = root(a_1**2 + b_1**2), root(a_2**2 + b_2**2)
    h_1, h_2 = (mpmath.atan2(b, a) % (2 * pi) if c else mpf(0) for a, b, c in ((a_1, b_1, c_1), (a_2, b_2, c_2)))
    turn = h_2 - h_1
    if abs(abs(turn) - pi) < _OPPOSITE and c_1 * c_2 > 0:
        return None  # the mean of opposite hues jumps in the formula itself
    turn = turn - 2 * pi if turn > pi else turn + 2 * pi if turn < -pi else turn
    if c_1 * c_2 == 0:
        turn, hue = mpf(0), h_1 + h_2
    elif abs(h_1 - h_2) <= pi:
        hue = (h_1 + h_2) / 2
    else:
        hue = (h_1 + h_2 + (2 * pi if h_1 + h_2 < 2 * pi else -2 * pi)) / 2
    if min(abs(hue), abs(2 * pi - hue)) < _OPPOSITE and c_1 * c_2 > 0:
        return None  # and its rotation term does where hues come round to 0
    return (
        _difference((l_1 + l_2) / 2, (c_1 + c_2) / 2, hue, l_2 - l_1, c_2 - c_1, 2 * root(c_1 * c_2) * sin(turn / 2)),
    )


def _difference(lightness, chroma, hue, d_lightness, d_chroma, d_hue):
    deg = pi / 180
    t = 1 - mpf("0.17") * cos(hue - 30 * deg) + mpf("0.24") * cos(2 * hue)
    t += mpf("0.32") * cos(3 * hue + 6 * deg) - mpf("0.20") * cos(4 * hue - 63 * deg)
    s_l = 1 + mpf("0.015") * (lightness - 50) ** 2 / root(20 + (lightness - 50) ** 2)
    s_c, s_h = 1 + mpf("0.045") * chroma, 1 + mpf("0.015") * chroma * t
    turn = 30 * deg * mpmath.exp(-(((hue / deg - 275) / 25) ** 2))
    rotation = -sin(2 * turn) * 2 * root(chroma**7 / (chroma**7 + mpf(25) ** 7))
    light, vivid, turned = d_lightness / s_l, d_chroma / s_c, d_hue / s_h
    return root(max(light**2 + vivid**2 + turned**2 + rotation * vivid * turned, mpf(0)))


def nine_times(info, x):
    return [x] * 9


def sobel(info, *patch):
    a, b, c, d, _, f, g, h, i = patch
    return (c + 2 * f + i) - (a + 2 * d + g), (a + 2 * b + c) - (g + 2 * h + i)


def normals_from_slopes(info, x, y):
    return normalise(info, -x, -y, mpf(1))


def normals_from_height(info, *patch):
    return normals_from_slopes(info, *(2 * x for x in sobel(info, *patch)))


def slopes_from_normals(least):
    return lambda info, x, y, z: (-x / max(z, mpf(least)), -y / max(z, mpf(least)))


def look_up():
    """Return the bilinear value of MAP, which tiles; u to the right, v up."""

    def exact(info, u, v):
        rows, columns = len(MAP), len(MAP[0])
        x, y = u * columns - mpf("0.5"), (1 - v) * rows - mpf("0.5")
        left, top = mpmath.floor(x), mpmath.floor(y)
        total = mpf(0)
        for row, down in ((top, 1 - (y - top)), (top + 1, y - top)):
            for column, across in ((left, 1 - (x - left)), (left + 1, x - left)):
                total += down * across * MAP[int(row) % rows][int(column) % columns]
        return (total,)

    return exact


def _slope(flattest, x, y, z):
    """Return du, dv over the height's change with a texture width for a unit of u: none without a direction."""
    radius = root(x * x + y * y)
    if radius == 0:
        return mpf(0), mpf(0)
    rise = max(z, radius / mpf(flattest))
    return x / rise, y / rise


def ray_slope(flattest):
    def exact(info, x, y, z):
        across, up = _slope(flattest, x, y, z)
        return across, up * _WIDTH_OVER_HEIGHT

    return exact


def trace_view(flattest):
    def exact(info, x, y, z):
        across, up = _slope(flattest, x, y, z)
        return mpf(0.5) + HEIGHT * across, mpf(0.5) + HEIGHT * up * _WIDTH_OVER_HEIGHT, mpf(HEIGHT)

    return exact


def clearance(flattest):
    """On a flat surface the ray rises by one over the distance that it moves in uv."""

    def exact(info, x, y, z):
        across, up = ray_slope(flattest)(info, x, y, z)
        return (1 / max(root(across * across + up * up), mpf("1e-6")),)

    return exact


def soft_shadow(flattest):
    def exact(info, x, y, z):
        if z <= 0:
            return (mpf(0),)
        return (min(clearance(flattest)(info, x, y, z)[0] / mpf(_SOFTNESS) + mpf("0.5"), mpf(1)),)

    return exact


def lights_from_ball(info, column, row):
    x, y = (column - _BALL[0]) / _BALL[2], -(row - _BALL[1]) / _BALL[2]
    z = root(1 - x * x - y * y)
    return 2 * z * x, 2 * z * y, 2 * z * z - 1
