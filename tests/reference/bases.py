"""Terms of the linear models at one light and view, written out from the papers in scalar arithmetic."""

import math


def half_vector(light, view):
    """Return (light + view) / |light + view|, or zeros where they are opposite."""
    total = [light[k] + view[k] for k in range(3)]
    length = math.sqrt(sum(t * t for t in total))
    return [t / length for t in total] if length > 0 else [0.0, 0.0, 0.0]


def half(light, view):
    return half_vector(light, view)


def half_light(light, view):
    return [*half_vector(light, view), light[0], light[1], light[2], 1.0]


def quadratic(light, view):
    a, b, c, d = light[0], light[1], view[0], view[1]
    return [1.0, a, b, c, d, a * a, a * b, a * c, a * d, b * b, b * c, b * d, c * c, c * d, d * d]


def polynomial(light, view):
    """Malzbender et al. 2001, eq. 1: a0 lu^2 + a1 lv^2 + a2 lu lv + a3 lu + a4 lv + a5."""
    u, v = light[0], light[1]
    return [u * u, v * v, u * v, u, v, 1.0]


def cosine(light, view):
    return [light[2]]


def _legendre(degree, order, x, s):
    """Closed forms without the Condon-Shortley phase (a table, not the recurrence of the code under test); s is sqrt(1 - x^2)."""
    return {
        (0, 0): 1.0,
        (1, 0): x, (1, 1): s,
        (2, 0): (3 * x * x - 1) / 2, (2, 1): 3 * x * s, (2, 2): 3 * s * s,
        (3, 0): (5 * x**3 - 3 * x) / 2, (3, 1): 1.5 * (5 * x * x - 1) * s, (3, 2): 15 * x * s * s, (3, 3): 15 * s**3,
    }[degree, order]


def hemispherical(terms):
    """Gautron et al. 2004, eqs. 3 and 4: real harmonics with the Legendre argument 2 cos(theta) - 1."""

    def evaluate(light, view):
        azimuth = math.atan2(light[1], light[0])
        sine = 2 * math.sqrt(max(0.0, light[2] * (1 - light[2])))  # of x itself it would be 0 near the horizon
        found = []
        for degree in range(math.isqrt(terms)):
            for order in range(-degree, degree + 1):
                m = abs(order)
                scale = math.sqrt(
                    (2 * degree + 1) * math.factorial(degree - m) / (2 * math.pi * math.factorial(degree + m))
                )
                turn = 1.0
                if order > 0:
                    turn = math.sqrt(2) * math.cos(m * azimuth)
                elif order < 0:
                    turn = math.sqrt(2) * math.sin(m * azimuth)
                found.append(scale * turn * _legendre(degree, m, 2 * light[2] - 1, sine))
        return found

    return evaluate


BASES = {
    "half": half, "half_light": half_light, "quadratic": quadratic, "polynomial": polynomial, "cosine": cosine,
    "hsh4": hemispherical(4), "hsh9": hemispherical(9), "hsh16": hemispherical(16),
}
