"""The two global lobes at one light and view, from the papers, in scalar arithmetic."""

import math

from tests.reference.bases import half_vector


def phong(parameters, light, view):
    """Ma et al. 2004, eq. 2, with N = z: k_d (N.L) + k_s (N.H)^n."""
    n_dot_h = max(0.0, half_vector(light, view)[2])
    lobe = n_dot_h ** math.exp(parameters[6])
    return [parameters[c] * light[2] + parameters[3 + c] * lobe for c in range(3)]


def ashikhmin_shirley(parameters, light, view):
    """k_d cos + pi cos rho_s, rho_s of Ashikhmin & Shirley 2000, eq. 4; u and v turned by the axis."""
    n_u, n_v, axis = math.exp(parameters[6]), math.exp(parameters[7]), parameters[8]
    h = half_vector(light, view)
    u, v = (math.cos(axis), math.sin(axis), 0.0), (-math.sin(axis), math.cos(axis), 0.0)

    def dot(a, b):
        return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]

    exponent = 0.0
    if h[2] < 1:
        exponent = (n_u * dot(h, u) ** 2 + n_v * dot(h, v) ** 2) / (1 - h[2] ** 2)
    h_dot_k = dot(h, light)
    found = []
    for c in range(3):
        r_s = parameters[3 + c]
        fresnel = r_s + (1 - r_s) * (1 - h_dot_k) ** 5  # eq. 5
        rho = (
            math.sqrt((n_u + 1) * (n_v + 1)) / (8 * math.pi) * h[2] ** exponent
            / (h_dot_k * max(light[2], view[2])) * fresnel
        )
        found.append(parameters[c] * light[2] + math.pi * light[2] * rho)
    return found


LOBES = {"phong": phong, "ashikhmin_shirley": ashikhmin_shirley}
