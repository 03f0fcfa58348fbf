"""Each model's value, texel by texel, from plain arrays: the slow oracle of `Material.shade`."""

import math

import numpy as np
from tests.reference import brdf as reference_brdf
from tests.reference.bases import BASES, half_vector
from tests.reference.colour import decode
from tests.reference.interpolate import plane_value
from tests.reference.lobes import LOBES


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


def _in_space(options, values):
    """Return sums as linear light: a code below 0 is black, and above 1 the curve goes on."""
    return [decode(max(0.0, value)) for value in values] if options.get("space") == "srgb" else values


def _ptm(maps, options, light, view, row, column):
    return _in_space(options, _weighted(BASES["polynomial"](light, view), maps["polynomial"][:, row, column]))


def _lptm(maps, options, light, view, row, column):
    luminance = sum(t * a for t, a in zip(BASES["polynomial"](light, view), maps["luminance"][:, row, column], strict=True))
    return _in_space(options, [luminance * c for c in maps["chroma"][:, row, column]])


def _hsh(maps, options, light, view, row, column):
    terms = BASES[f"hsh{options.get('terms', 9)}"](light, view)
    return _in_space(options, _weighted(terms, maps["harmonic"][:, row, column]))


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


def _rbf(maps, options, light, view, row, column):
    """Cubed distances and a plane, in coordinates that spread the half vector: see `torchmat.models.rbf`."""

    def place(light, view):
        x, y, _ = half_vector(light, view)
        sine = math.hypot(x, y)
        spread = maps["half_scale"][0] * (math.asinh(10 * sine) / sine if sine > 0 else 10.0)
        return [spread * x, spread * y, *light, *view]

    here = place(light, view)
    bends = [math.dist(here, place(knot[:3], knot[3:])) ** 3 for knot in maps["knots"][:, 0].T]
    weights = [sum(t * w for t, w in zip([*bends, 1.0, *here], line, strict=True)) for line in maps["weight"][:, 0]]
    weights = [min(max(w, least), most) for w, (least, most) in zip(weights, maps["reach"][:, 0], strict=True)]
    return _in_space(options, _weighted(maps["component"][:, row, column], weights))


def _dot(one, other):
    return sum(a * b for a, b in zip(one, other, strict=True))


def _tilted_with(normal, vector):
    """Turn `vector` as the shortest rotation from +z to `normal` does (Rodrigues)."""
    x, y, z = normal
    sine = math.hypot(x, y)
    if sine == 0:
        return list(vector)
    axis = [-y / sine, x / sine, 0.0]
    across = [
        axis[1] * vector[2] - axis[2] * vector[1], axis[2] * vector[0] - axis[0] * vector[2],
        axis[0] * vector[1] - axis[1] * vector[0],
    ]
    along = _dot(axis, vector) * (1 - z)
    return [v * z + c * sine + a * along for v, c, a in zip(vector, across, axis, strict=True)]


def _on_parabolic_map(plane, u, v):
    """Return a square map's value at u (right), v (up) in [-1, 1]: bilinear between texel centres, constant beyond them."""
    size = len(plane)
    x = min(max((u + 1) / 2 * size - 0.5, 0.0), size - 1.0)
    y = min(max((1 - v) / 2 * size - 0.5, 0.0), size - 1.0)
    left, top = min(int(x), max(size - 2, 0)), min(int(y), max(size - 2, 0))
    right, below = min(left + 1, size - 1), min(top + 1, size - 1)
    fx, fy = x - left, y - top
    upper = plane[top, left] * (1 - fx) + plane[top, right] * fx
    lower = plane[below, left] * (1 - fx) + plane[below, right] * fx
    return upper * (1 - fy) + lower * fy


def _tilt_at(tilt, cosine):
    degrees = math.degrees(math.acos(min(max(cosine, -1.0), 1.0)))
    below = min(int(degrees), 89)
    share = degrees - below
    return 1 - (tilt[0, 0, below] * (1 - share) + tilt[0, 0, below + 1] * share)


def _smith_root(alpha, direction, tangent, bitangent, cosine):
    """Return cos (1 + 2 lambda) of a direction, lambda = (sqrt(1 + (alpha tan)^2) - 1) / 2 along its azimuth."""
    x, y = _dot(direction, tangent), _dot(direction, bitangent)
    if cosine <= 0:
        return math.hypot(alpha[0] * x, alpha[1] * y)
    return cosine * math.sqrt(1 + ((alpha[0] * x) ** 2 + (alpha[1] * y) ** 2) / cosine**2)


def _distribution(maps, options, light, view, row, column):
    """Liao 2011, eq. 3.1 as a value, with 1e-4 in its denominator; a part is there if its map is.

    With "masking" Smith's lambda of GGX (Heitz 2014, eq. 72) takes the place of D: 2 (n.l)(n.v) / G = 2 n.l n.v (1 + both lambdas).
    """
    texel = {key: value[:, row, column] for key, value in maps.items() if key not in ("specular", "tilt", "masking")}
    normal = texel.get("normal", np.array([0.0, 0.0, 1.0]))
    normal = normal / math.sqrt(_dot(normal, normal))
    n_dot_l, n_dot_v = max(0.0, _dot(normal, light)), max(0.0, _dot(normal, view))
    diffuse = [a * n_dot_l for a in texel["diffuse"]]
    lobes = options.get("lobes", 1)
    if lobes == 0:
        return diffuse
    tangent, bitangent = _tilted_with(normal, (1.0, 0.0, 0.0)), _tilted_with(normal, (0.0, 1.0, 0.0))
    if "rotation" in texel:
        length = math.hypot(*texel["rotation"])
        c, s = texel["rotation"][0] / length, texel["rotation"][1] / length
        tangent, bitangent = (
            [c * t + s * b for t, b in zip(tangent, bitangent, strict=True)],
            [-s * t + c * b for t, b in zip(tangent, bitangent, strict=True)],
        )
    half = half_vector(light, view)
    up = 1 + max(0.0, _dot(half, normal))
    u, v = _dot(half, tangent) / up, _dot(half, bitangent) / up
    if options.get("specular_spacing") == "dense":  # the root of the distance from the centre, but for a spot of 1 / 256 there
        u, v = (axis / (u * u + v * v + 1 / 65536) ** 0.25 for axis in (u, v))
    weight = texel["index"] if lobes > 1 else [1.0]
    colour = [sum(w * _on_parabolic_map(maps["specular"][3 * k + c], u, v) for k, w in enumerate(weight)) for c in range(3)]
    a, b = (_tilt_at(maps["tilt"], x) for x in (n_dot_l, n_dot_v)) if "tilt" in maps else (n_dot_l, n_dot_v)
    denominator = a + b - a * b
    if "masking" in maps:
        denominator = n_dot_l * _smith_root(maps["masking"], view, tangent, bitangent, n_dot_v)
        denominator += n_dot_v * _smith_root(maps["masking"], light, tangent, bitangent, n_dot_l)
    share = math.pi * n_dot_l / (denominator + 1e-4)
    if "fresnel" in texel:
        r0 = texel["fresnel"][0]
        share *= r0 + (1 - r0) * max(0.0, 1 - _dot(light, half)) ** options.get("fresnel_exponent", 5)
    mask = texel.get("specular_mask", [1.0])
    return [diffuse[c] + share * colour[c] * mask[c if len(mask) == 3 else 0] for c in range(3)]


def _cross(one, other):
    return [one[(k + 1) % 3] * other[(k + 2) % 3] - one[(k + 2) % 3] * other[(k + 1) % 3] for k in range(3)]


def _on_curve(curve, place):
    """Return a table over [-1, 1] at a place: linear between its samples."""
    if len(curve) == 1:
        return curve[0]
    position = (min(max(place, -1.0), 1.0) + 1) / 2 * (len(curve) - 1)
    below = min(int(position), len(curve) - 2)
    return curve[below] * (1 - position + below) + curve[below + 1] * (position - below)


def _sphere_look_up(image, normal, turn):
    """Return a picture [3, S, S] at a normal turned about Y, its z at least 0, shortened by 0.995."""
    x, y = normal[0] * math.cos(turn) + normal[2] * math.sin(turn), normal[1]
    if -normal[0] * math.sin(turn) + normal[2] * math.cos(turn) < 0:
        length = math.hypot(x, y)
        x, y = x / length, y / length
    return [_on_parabolic_map(plane, 0.995 * x, 0.995 * y) for plane in image]


def _sphere_images(maps, options, light, view, row, column):
    """Mihalik & Durikovic, eq. 4, in a frame made by hand: Z the view, the light in the half plane Y = 0, X > 0."""
    angles = [math.radians(a) for a in options["angles_deg"]]
    across = _cross(view, light)  # along Y
    sine = math.sqrt(_dot(across, across))
    phi = math.atan2(sine, _dot(light, view))
    y_axis = [a / sine for a in across]
    x_axis = _cross(y_axis, view)
    normal = [x_axis[2], y_axis[2], view[2]]
    images = maps["images"].reshape(len(angles), 3, *maps["images"].shape[1:])
    tint = maps["tint"][:, row, column]
    if phi >= angles[-1]:
        colour = _sphere_look_up(images[-1], normal, 0.75 * (angles[-1] - phi))
        return [a * b for a, b in zip(colour, tint, strict=True)]
    j = max(k for k in range(len(angles)) if angles[k] <= phi)
    half = [math.sin(phi / 2), math.cos(phi / 2)]
    place = (normal[0] * half[1] - normal[2] * half[0]) / math.hypot(normal[0], normal[2])
    turn = maps["turn"][0]
    k_lower, k_upper = (_on_curve(turn[0 if len(turn) == 1 else 2 * j + side], place) for side in (0, 1))
    lower = _sphere_look_up(images[j], normal, k_lower * (angles[j] - phi))
    upper = _sphere_look_up(images[j + 1], normal, k_upper * (angles[j + 1] - phi))
    t = (phi - angles[j]) / (angles[j + 1] - angles[j])
    return [(a * (1 - t) + b * t) * c for a, b, c in zip(lower, upper, tint, strict=True)]


def _shading_map(maps, options, light, view, row, column):
    """GPU Gems 2, ch. 11: the stack at r / a_max (N - 1); then sectors of the light's azimuth, which are ours."""
    name, count, azimuths = options.get("brdf", "phong"), options.get("slices", 8), options.get("azimuths", 1)
    if name == "table":
        table = maps["reflectance"].reshape(1, maps["reflectance"].shape[1], -1, 36)
        r = math.pi * light[2] * reference_brdf.merl_linear(table, light, view)[0]
    else:
        r = sum(reference_brdf.value(name, maps["lobe"], light, view)) / 3
    r, brightest = max(0.0, r) + options.get("ambient_level", 0.0), maps["brightest"][0]
    place = min(r / brightest, 1.0) * (count - 1)
    gain = max(r / brightest, 1.0) if options.get("overflow") == "scale" else 1.0
    sine, turn = math.hypot(light[0], light[1]), math.atan2(light[1], light[0]) / (2 * math.pi) * azimuths
    found = [0.0, 0.0, 0.0]
    for sector in range(azimuths):
        apart = (turn - sector) % azimuths
        near = max(0.0, 1 - min(apart, azimuths - apart))
        share = 1.0 if azimuths == 1 else (1 - sine) / azimuths + sine * near
        for layer in range(count):
            weight = gain * share * max(0.0, 1 - abs(place - layer))
            for c in range(3):
                found[c] += weight * maps["slices"][3 * (sector * count + layer) + c, row, column]
    return found


def _neural(maps, options, light, view, row, column):
    """A perceptron of latent numbers, light, view and the half vector's x, y; its output is the root of the value."""
    known = [*maps["latent"][:, row, column], *light, *view, *half_vector(light, view)[:2]]
    for number in range(options["layers"] + 1):
        if number > 0:
            known = [max(0.0, x) for x in known]
        known = [_dot(weights[:-1], known) + weights[-1] for weights in maps[f"layer_{number}"][0]]
    return [max(0.0, x) ** 2 for x in known]


def _ggx(alpha, light, view, half):
    """Return D G / (4 (n.l)(n.v)) of vectors in the texel's frame (Walter 2007, Heitz 2014), with 1e-4 of N.L + N.V's kind.

    The package adds 1e-4 to (n.l)(n.v) (1 + both lambdas) 2, and 1e-6 to the squares of alpha.
    """
    a, b = (math.sqrt(x * x + 1e-6) for x in alpha)
    slope = (half[0] / a) ** 2 + (half[1] / b) ** 2 + half[2] ** 2
    d = 1 / (math.pi * a * b * slope**2)
    roots = [math.sqrt((a * w[0]) ** 2 + (b * w[1]) ** 2 + w[2] ** 2) for w in (light, view)]
    return d / (2 * (max(0.0, light[2]) * roots[1] + max(0.0, view[2]) * roots[0] + 1e-4))


def _schlick(f0, f90, cosine):
    return f0 + (f90 - f0) * (1 - cosine) ** 5


def _grazing_of(f0):
    """Return F90 of F0, a number or one a channel: below 2 % less than 1."""
    return min(1.0, 50 * float(np.mean(f0)))


def _microfacet(maps, options, light, view, row, column):
    """Burley's parametrisation of GGX, a part at a time; a part is there if the options name it."""
    parts = options.get("parts", [])
    texel = {key: value[:, row, column] for key, value in maps.items() if key not in ("rolloff", "sheen_roughness")}
    normal = texel.get("normal", np.array([0.0, 0.0, 1.0]))
    normal = normal / math.sqrt(_dot(normal, normal))
    tangent, bitangent = _tilted_with(normal, (1.0, 0.0, 0.0)), _tilted_with(normal, (0.0, 1.0, 0.0))
    angle = math.atan2(texel["rotation"][1], texel["rotation"][0]) if "anisotropy" in parts else 0.0
    along = [math.cos(angle) * t + math.sin(angle) * b for t, b in zip(tangent, bitangent, strict=True)]
    across = [math.cos(angle) * b - math.sin(angle) * t for t, b in zip(tangent, bitangent, strict=True)]
    half = half_vector(light, view)
    l, v, h = ([_dot(axis, w) for axis in (along, across, normal)] for w in (light, view, half))
    n_l, n_v, h_l = max(0.0, l[2]), max(0.0, v[2]), _dot(half, light)
    alpha = [float(r) ** 2 for r in texel["roughness"]]
    lobe = math.pi * n_l * _ggx([alpha[0], alpha[-1]], l, v, h)
    f90 = _grazing_of(texel["specular_f0"]) * (texel["f90"][0] if "f90" in parts else 1.0)
    diffuse = [c * n_l for c in texel["diffuse"]]
    if "rolloff" in parts:
        for cosine in (n_l, n_v):
            curve = 1 + maps["rolloff"][0] * (1 - cosine) + maps["rolloff"][1] * (1 - cosine) ** 5
            diffuse = [c * max(0.0, curve) for c in diffuse]
    found = [0.0] * 3
    for c in range(3):
        f0 = texel["specular_f0"][c]
        cover, most = (texel["coat"][0], _grazing_of(texel["coat"])) if "coat" in parts else (f0, f90)
        through = (1 - _schlick(cover, most, n_l)) * (1 - _schlick(cover, most, n_v)) if "layered" in parts else 1.0
        specular = lobe * _schlick(f0, f90, h_l)
        found[c] = through * (diffuse[c] + specular) if "coat" in parts else through * diffuse[c] + specular
        if "coat" in parts:
            coat = float(texel["coat_roughness"][0]) ** 2
            found[c] += math.pi * n_l * _ggx([coat, coat], l, v, h) * _schlick(texel["coat"][0], _grazing_of(texel["coat"]), h_l)
        if "sheen" in parts:
            charlie = float(maps["sheen_roughness"][0]) ** 2
            d = (2 + 1 / charlie) * math.hypot(h[0], h[1]) ** (1 / charlie) / (2 * math.pi)
            found[c] += texel["sheen"][c] * math.pi * n_l * d / (4 * (n_l + n_v - n_l * n_v + 1e-4))
    return found


VALUES = {
    "texture": _texture, "lambert": _lambert, "ptm": _ptm, "lptm": _lptm, "hsh": _hsh, "phong_srf": _phong_srf,
    "pca": _pca, "local_pca": _local_pca, "rbf": _rbf, "distribution": _distribution,
    "sphere_images": _sphere_images, "shading_map": _shading_map, "neural": _neural,
    "microfacet": _microfacet,
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
