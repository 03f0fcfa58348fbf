"""The table of the sweeps: how each public function is called on columns of floats, and what is true.

A text in place of an entry says why a function is not one of single numbers. The oracles are written from the
definitions, in mpmath; what a docstring promises beyond them (a denormal divisor counts as 0) is part of the truth.
"""

from __future__ import annotations

import math

import torch
from tests.hard_cases import oracles as exact
from tests.hard_cases.sweeps import Entry, Interval

from torchmat import colour, frames, safe
from torchmat.geometry import normals, rays
from torchmat.geometry.photometric_stereo import lights_from_ball

ANY, UNIT = Interval(), Interval(-1, 1)
COLOUR = Interval(0, 1, (0.04045, 0.0031308))
_STEEPEST = math.cos(math.radians(84.0))
_FLATTEST = math.tan(math.radians(88.0))


def _planes(*columns):
    """Return columns [n] as vectors on dimension -3: [k, n, 1]."""
    return torch.stack(columns)[..., None]


def _flat(planes):
    return planes[..., 0]


def _units(columns):
    """Scale every three columns to vectors of length 1 within rounding; what is all 0 becomes the pole."""
    found = []
    for first in range(0, len(columns), 3):
        vector = torch.stack(columns[first : first + 3]).double()
        largest = vector.abs().amax(dim=0)
        vector = torch.where(
            largest > 0, vector / torch.where(largest > 0, largest, 1.0), vector.new_tensor([[0.0], [0], [1]])
        )
        found += list((vector / vector.norm(dim=0)).to(columns[0].dtype))
    return found


def _half(light_x, light_y, light_z, *view):
    return _flat(frames.half_vector(_planes(light_x, light_y, light_z), _planes(*view)))


def _patches(*columns):
    """Return nine columns [n] as a map [1, 3, 3n] of patches of 3 x 3 texels beside each other."""
    return torch.stack(columns).reshape(3, 3, -1).permute(0, 2, 1).reshape(1, 3, -1)


def _middles(planes):
    return planes[:, 1, 1::3]


def _look_up(u, v):
    maps = torch.tensor(exact.MAP, dtype=u.dtype)[None, None]
    return rays.look_up(maps, torch.stack((u, v), dim=1)[:, :, None, None])[:, 0, 0, 0][None]


def _rays(call):
    """Return `call` on rays over the flat height of the oracles, one for each row of columns x, y, z."""

    def called(*columns):
        direction = torch.stack(columns, dim=1)[:, :, None, None]
        height = torch.full((1, 2, 4), exact.HEIGHT, dtype=columns[0].dtype)
        uv = torch.full((2, 1, 1), 0.5, dtype=columns[0].dtype)
        return call(height, direction, uv)

    return called


def _traced(height, view, uv):
    hits = rays.trace_view(height, view, uv)
    return torch.cat((hits.uv, hits.height), dim=1)[:, :, 0, 0].T


def _visible(height, view, uv):
    return rays.visible(height, view)[:, 0, 0, :1].T.to(height.dtype)


def _angles(*columns):
    polar, azimuth = frames.to_polar(_planes(*columns), dim=0)
    return torch.stack((polar[:, 0], torch.cos(azimuth[:, 0]), torch.sin(azimuth[:, 0])))


def _azimuth_in_range(columns, outputs):
    azimuth = frames.to_polar(torch.stack(columns), dim=0)[1]
    return "" if bool(((azimuth >= 0) & (azimuth < 2 * torch.pi)).all()) else "an azimuth outside [0, 2 pi)"


def _unit_or_zero(columns, outputs):
    length = outputs.double().norm(dim=0)
    off = torch.minimum((length - 1).abs(), length).max()
    return "" if float(off) < 8 * torch.finfo(outputs.dtype).eps else f"a length off by {float(off):.2g}"


def _monotone(function):
    def check(columns, outputs):
        ordered = function(columns[0].sort().values)
        return "" if bool((ordered.diff() >= 0).all()) else "not monotone"

    return check


def _falling(columns, outputs):
    return "" if bool((safe.acos(columns[0].sort().values).diff() <= 0).all()) else "not monotone"


def _odd(columns, outputs):
    turned = safe.divide(-columns[0], columns[1])
    return "" if torch.equal(torch.nan_to_num(turned), torch.nan_to_num(-outputs[0])) else "not odd"


def _symmetric_difference(columns, outputs):
    other = colour.ciede2000(_planes(*columns[3:]), _planes(*columns[:3]))[:, 0]
    bound = 1e4 * torch.finfo(other.dtype).eps * (1 + outputs[0])
    return "" if bool(((other - outputs[0]).abs() <= bound).all()) else "not symmetric"


def _channels(function):
    """Return `function` of planes [3, n, 1] on one column, which all channels hold."""
    return lambda x: _flat(function(x.expand(3, -1)[..., None]))[:1]


def _ball(x, y):
    return lights_from_ball(torch.stack((x, y), dim=1), (0.25, -0.5), 2.0).T


_LAB = (Interval(0, 100), Interval(-128, 128), Interval(-128, 128))
# x^2.4 and x^(1 / 2.4) far beyond 1: the rounding of the exponent counts log x times. Within [0, 1] see `display`.
_POWER = (2.5, 2.5)
_ABOVE = (UNIT, UNIT, Interval(0, 1))

ENTRIES: dict[str, Entry | str] = {
    "safe.sqrt": Entry(lambda x: safe.sqrt(x)[None], exact.sqrt, (ANY,), check=_monotone(safe.sqrt)),
    "safe.divide": Entry(lambda a, b: safe.divide(a, b)[None], exact.divide, (ANY, ANY), check=_odd),
    "safe.normalise": Entry(
        lambda *v: _flat(safe.normalise(_planes(*v))),
        exact.normalise,
        (ANY,) * 3,
        gradient_scale="largest",
        check=_unit_or_zero,
    ),
    "safe.acos": Entry(lambda x: safe.acos(x)[None], exact.acos, (Interval(kinks=(1.0, -1.0)),), check=_falling),
    "safe.power": Entry(
        lambda a, b: safe.power(a, b)[None],
        exact.power,
        (Interval(-math.inf, math.inf, (1.0,)), Interval(0, math.inf)),
        scale="terms",
        gradient_scale="terms",
    ),
    "frames.spiral": "takes a whole number",
    "frames.from_polar": Entry(
        lambda a, b: frames.from_polar(a, b, dim=0),
        exact.from_polar,
        (Interval(0, math.pi, (math.pi / 2, math.pi)), Interval(-8, 8)),
        scale="terms",
        gradient_scale="largest",
    ),
    "frames.to_polar": Entry(
        _angles,
        exact.to_polar,
        (UNIT,) * 3,
        scale="largest",
        gradient_scale="largest",
        check=_azimuth_in_range,
        prepare=_units,
    ),
    "frames.half_vector": Entry(
        _half,
        exact.half_vector,
        (UNIT,) * 6,
        scale="terms",
        gradient_scale="largest",
        check=_unit_or_zero,
        share=0.3,
        prepare=_units,
    ),
    "frames.tangent_frame": Entry(
        lambda *n: torch.cat([_flat(one) for one in frames.tangent_frame(_planes(*n))]),
        exact.tangent_frame,
        (UNIT, UNIT, Interval(-1, 1, (-1.0,))),
        scale="terms",
        gradient_scale="largest",
        share=0.5,
        prepare=_units,
    ),
    "colour.srgb_to_linear": Entry(
        _channels(colour.srgb_to_linear), exact.srgb_to_linear, (Interval(kinks=(0.04045,)),), *_POWER
    ),
    "colour.linear_to_srgb": Entry(
        _channels(colour.linear_to_srgb), exact.linear_to_srgb, (Interval(kinks=(0.0031308,)),), *_POWER
    ),
    "colour.luminance": Entry(
        lambda *c: colour.luminance(_planes(*c))[None, :, 0],
        exact.luminance,
        (ANY,) * 3,
        scale="terms",
    ),
    "colour.display": Entry(_channels(colour.display), exact.display, (Interval(kinks=(0.0031308, 1.0)),)),
    "colour.srgb_to_lab": Entry(
        lambda *c: _flat(colour.srgb_to_lab(_planes(*c))),
        exact.srgb_to_lab,
        (COLOUR,) * 3,
        2.0,
        scale="one",
        gradient_scale="largest",
        share=0.3,  # a is 500 times a difference
    ),
    "colour.ciede2000": Entry(
        lambda *c: colour.ciede2000(_planes(*c[:3]), _planes(*c[3:]))[None, :, 0],
        exact.ciede2000,
        (*_LAB, *_LAB),
        2.0,
        3.0,
        scale="one",
        gradient_scale="largest",
        share=0.1,
        check=_symmetric_difference,
    ),
    "geometry.normals.check_height": "a check",
    "geometry.normals.check_height_scale": "a check",
    "geometry.normals.pad_border": Entry(
        lambda x: normals.pad_border(x[:, None, None, None], True).reshape(len(x), 9).T,
        exact.nine_times,
        (ANY,),
        0,
        0,
        share=0.2,
    ),
    "geometry.normals.sobel": Entry(
        lambda *x: _middles(normals.sobel(_patches(*x), tiles=False)),
        exact.sobel,
        (ANY,) * 9,
        scale="terms",
        share=0.2,
    ),
    "geometry.normals.slopes_from_height": Entry(
        lambda *x: _middles(normals.slopes_from_height(_patches(*x), 8 / (3 * len(x[0])), tiles=False)),
        exact.sobel,
        (ANY,) * 9,
        scale="terms",
        share=0.2,
    ),
    "geometry.normals.normals_from_slopes": Entry(
        lambda *x: _flat(normals.normals_from_slopes(_planes(*x))),
        exact.normals_from_slopes,
        (ANY, ANY),
        gradient_scale="largest",
        check=_unit_or_zero,
    ),
    "geometry.normals.slopes_from_normals": Entry(
        lambda *n: _flat(normals.slopes_from_normals(_planes(*n))),
        exact.slopes_from_normals(_STEEPEST),
        (UNIT, UNIT, Interval(-1, 1, (_STEEPEST,))),
        gradient_scale="largest",
        prepare=_units,
    ),
    "geometry.normals.normals_from_height": Entry(
        lambda *x: _middles(normals.normals_from_height(_patches(*x), 2.0, tiles=False)),
        exact.normals_from_height,
        (Interval(0, 1),) * 9,
        scale="terms",
        gradient_scale="largest",
        share=0.2,
        check=_unit_or_zero,
    ),
    "geometry.normals.flip_green": Entry(
        lambda *n: _flat(normals.flip_green(_planes(*n))),
        lambda info, x, y, z: (x, -y, z),
        (ANY,) * 3,
        0,
        0,
    ),
    "geometry.rays.texel_centres": "takes whole numbers",
    "geometry.rays.look_up": Entry(
        _look_up,
        exact.look_up(),
        (ANY, ANY),
        value=1.2,  # just below 0 wraps to just below 1 and is rounded as that, which the terms do not know: measured 0.93
        scale="terms",
        gradient=None,
    ),
    "geometry.rays.ray_slope": Entry(
        lambda *d: _flat(rays.ray_slope(_planes(*d), 2, 4)),
        exact.ray_slope(_FLATTEST),
        _ABOVE,
        scale="largest",
        gradient_scale="largest",
        prepare=_units,
    ),
    "geometry.rays.trace_view": Entry(
        _rays(_traced),
        exact.trace_view(_FLATTEST),
        _ABOVE,
        scale="largest",
        gradient_scale="largest",
        share=0.5,
        prepare=_units,
    ),
    "geometry.rays.clearance": Entry(
        _rays(lambda h, d, uv: rays.clearance(h, d, uv)[:, 0, 0].T),
        exact.clearance(_FLATTEST),
        _ABOVE,
        gradient_scale="value",
        share=0.5,
        prepare=_units,
    ),
    "geometry.rays.soft_shadow": Entry(
        _rays(lambda h, d, uv: rays.soft_shadow(h, d, uv=uv)[:, 0, 0].T),
        exact.soft_shadow(_FLATTEST),
        (UNIT, UNIT, UNIT),
        share=0.5,
        gradient_scale="value",
        prepare=_units,
    ),
    "geometry.rays.find_obstacles": "where what clearance finds is found, without gradients",
    "geometry.rays.visible": Entry(_rays(_visible), lambda info, *d: (1,), _ABOVE, 0, None, share=0.5),
    "geometry.integrate.frankot_chellappa": "solves for a whole map: conditioning.py",
    "geometry.integrate.poisson": "solves for a whole map: conditioning.py",
    "geometry.photometric_stereo.check_lights": "a check",
    "geometry.photometric_stereo.photometric_stereo": "solves for each texel: conditioning.py",
    "geometry.photometric_stereo.lights_from_ball": Entry(
        _ball,
        exact.lights_from_ball,
        (Interval(-1.1, 1.6), Interval(-1.9, 0.9)),
        scale="largest",
        gradient_scale="largest",
    ),
    "geometry.photometric_stereo.find_highlight": "searches a picture",
    "geometry.photometric_stereo.shading_weights": "an iteration from ranks: photometric_stereo",
    "geometry.from_photographs.check_integration": "a check",
    "geometry.from_photographs.relief_from_photographs": "a chain of the others",
    "geometry.from_photographs.relief_from_stereo": "a chain of the others",
    "geometry.from_photographs.relief_from_picture": "a chain of the others",
}
