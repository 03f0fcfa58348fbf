"""A lit sphere seen from afar: where a surface point stands on it, and which of its pictures to look up where.

The formulas of Mihálik & Ďurikovič, "Image-based BRDF Representation", for planes of light and view.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchmat import safe

SHORTENED = 0.995  # the paper's: filtering near the rim must not reach outside the disc
TURN_BEYOND = 0.75  # the paper's k, for lights beyond the last picture
_RIM = math.sin(math.radians(88.0))


class SpherePlace(NamedTuple):
    """A surface point as the sphere shows it: angle between light and view, and the `normal`'s x, y, z in the view's
    frame, where the light lies in the plane Y = 0 with X > 0. Each [..., 1, h, w]."""

    angle: Tensor
    x: Tensor
    y: Tensor
    z: Tensor


def place_on_sphere(light: Tensor, view: Tensor) -> SpherePlace:
    """Return where a sphere seen along `view` and lit from `light` has the normal +z.

    Both are unit vectors [..., 3, h, w]. Where they coincide the frame may turn about the view: X is put under
    the normal. There a picture is symmetric, so the frame, which rounding decides near it, has no gradient.
    """
    (lx, ly, lz), (vx, vy, vz) = (d.split(1, dim=-3) for d in (light, view))
    # The cross product keeps digits that the arc cosine of nearly parallel directions loses.
    wx, wy, wz = ly * vz - lz * vy, lz * vx - lx * vz, lx * vy - ly * vx
    sine = torch.addcmul(torch.addcmul(wx * wx, wy, wy), wz, wz).clamp(min=1e-36).sqrt()
    across, up = vx * wy - vy * wx, -wz  # sine times the normal's x and y
    angle = torch.atan2(sine, torch.addcmul(torch.addcmul(lx * vx, ly, vy), lz, vz))
    close = sine < torch.finfo(sine.dtype).eps ** 0.5
    if not bool(close.any()):
        return SpherePlace(angle, across / sine, up / sine, vz)
    frame = safe.normalise(torch.cat(torch.broadcast_tensors(across, up), dim=-3).detach())
    fx, fy = frame.split(1, dim=-3)
    fx = torch.where((fx == 0) & (fy == 0), torch.ones_like(fx), fx)
    radius = safe.sqrt(vx * vx + vy * vy)
    sine = torch.where(close, torch.ones_like(sine), sine)
    x = torch.where(close, radius * fx, across / sine)
    return SpherePlace(angle, x, torch.where(close, radius * fy, up / sine), vz)


class Neighbours(NamedTuple):
    """The two pictures around each light: the lower and the upper on dimension 0 of `number` and `angle`.

    `lower` [..., 1, h, w] and `number` [2, ..., 1, h, w] (as floats) count pictures from 0; `angle` is theirs, in
    radians; `beyond` marks lights beyond the last picture, which then is both, or is None where there are none.
    """

    lower: Tensor
    number: Tensor
    angle: Tensor
    beyond: Tensor | None


class LookUps(NamedTuple):
    """Where in which two pictures to look: `number`, as in `Neighbours`, `x` to the right and `y` up in [-1, 1], each
    [2, ..., 1, h, w], and the `share` [..., 1, h, w] of the upper picture."""

    number: Tensor
    x: Tensor
    y: Tensor
    share: Tensor


def find_neighbours(angle: Tensor, angles: Sequence[float]) -> Neighbours:
    """Return the pictures at `angles` (ascending from 0, radians) around each `angle`."""
    last = len(angles) - 1
    lower = torch.zeros(angle.shape, dtype=torch.uint8)
    for boundary in angles[1:]:
        lower += (angle >= boundary).view(torch.uint8)
    pairs = [(number, min(number + 1, last)) for number in range(last + 1)]
    columns = torch.tensor([(*pair, *(angles[number] for number in pair)) for pair in pairs], dtype=angle.dtype).T
    index = lower.int()
    found = columns.index_select(1, index.flatten()).reshape(4, *angle.shape)
    beyond = lower == last
    return Neighbours(index, found[:2], found[2:], beyond if bool(beyond.any()) else None)


def find_look_ups(place: SpherePlace, near: Neighbours, k: Tensor) -> LookUps:
    """Return the look-ups of eq. 4 for the factors `k` [2 or 1, ..., 1, h, w]."""
    apart = near.angle - place.angle
    # The pictures lie 0.01 degrees or more apart; only beyond the last one do they coincide.
    share = -apart[0] / (near.angle[1] - near.angle[0]).clamp(min=1e-5)
    if near.beyond is not None:
        k = torch.where(near.beyond, torch.full((), TURN_BEYOND, dtype=k.dtype), k)
        share = torch.where(near.beyond, torch.zeros((), dtype=k.dtype), share)
    return LookUps(near.number, *_turned(place, k * apart), share)


def sine_to_half(place: SpherePlace) -> Tensor:
    """Return the signed sine of the angle between the half vector and (n_x, 0, n_z), positive toward the light."""
    half_angle = place.angle / 2
    # The bound matters within 1e-12 of n = Y, where nothing turns and the square of the length would underflow.
    shorten = torch.addcmul(place.z * place.z, place.x, place.x).clamp(min=1e-24).rsqrt()
    return torch.addcmul(place.x * torch.cos(half_angle), place.z, torch.sin(half_angle), value=-1) * shorten


def find_knots(shape: tuple[int, int], sine: Tensor, lower: Tensor) -> tuple[list[Tensor], Tensor]:
    """Return between which two samples of a table [rows, K] k lies: the first's flat index, and the second's share.

    One index for each side, or one for both where they share a row. With K = 1 the first sample is all there is.
    """
    rows, count = shape
    position = torch.add(sine.clamp(-1, 1), 1) * ((count - 1) / 2)
    cell = position.detach().int().clamp(max=max(count - 2, 0))
    if rows == 1:
        return [cell], position - cell
    first = cell + lower.clamp(max=rows // 2 - 1) * (2 * count)
    return [first, first + count], position - cell


def find_turns(turn: Tensor, sine: Tensor, lower: Tensor) -> Tensor:
    """Return k of the table `turn` [1, rows, K] for either side, [2, ...], or [1, ...] where it is the same."""
    rows, count = turn.shape[1:]
    table = turn.flatten()
    starts, share = find_knots((rows, count), sine, lower)
    found = []
    for start in starts:
        ends = [table.index_select(0, start.flatten() + step).reshape(share.shape) for step in (0, min(1, count - 1))]
        found.append(torch.lerp(ends[0], ends[1], share))
    return torch.stack(found)


def _turned(place: SpherePlace, turn: Tensor) -> tuple[Tensor, Tensor]:
    """Return x and y, shortened, of the normal turned about Y by angles [2, ...]; at the rim where it turns away."""
    cosine, sine = torch.cos(turn), torch.sin(turn)
    x = torch.addcmul(place.x * cosine, place.z, sine)
    behind = torch.addcmul(place.z * cosine, place.x, sine, value=-1) < 0
    scale = torch.full((), SHORTENED, dtype=x.dtype)
    if bool(behind.any()):
        length = torch.addcmul(place.y * place.y, x, x).clamp(min=1e-12)
        scale = torch.where(behind, SHORTENED * torch.rsqrt(length), scale)
    return x * scale, (place.y * scale).expand_as(x)


def atlas_grid(look_ups: LookUps, count: int, size: int) -> Tensor:
    """Return `grid_sample` coordinates [2, ..., 1, h, w, 2] for `count` pictures of `size` texels below each other."""
    y, inside = look_ups.y, 1 - 1 / size  # the centres of the outermost texels
    if inside < SHORTENED:
        y = y.clamp(-inside, inside)  # or a neighbour in the atlas would be mixed in
    # Picture j begins j / count down the atlas, and (1 - y) / 2 of its height lie above the point.
    down = torch.add(look_ups.number, y, alpha=-0.5) * (2 / count) + (1 / count - 1)
    return torch.stack(torch.broadcast_tensors(look_ups.x, down), dim=-1)


def sphere_normals(size: int, dtype: torch.dtype = torch.float32, offset: tuple[float, float] = (0.0, 0.0)) -> Tensor:
    """Return the normals [3, S, S] that the texels of a sphere picture show; texels outside the disc show its rim.

    x to the right, y up, z toward the viewer. `offset`, in texels, moves the points right and down from the centres.
    The rim counts as 88 degrees, where a view still lies above the horizon.
    """
    across = (torch.arange(size, dtype=dtype) + 0.5 + offset[0]) / size * 2 - 1
    down = (torch.arange(size, dtype=dtype) + 0.5 + offset[1]) / size * 2 - 1
    y, x = torch.meshgrid(-down, across, indexing="ij")
    radius = torch.sqrt(x * x + y * y)
    shrink = torch.where(radius < _RIM, torch.ones_like(radius), _RIM / radius.clamp(min=_RIM))
    x, y = x * shrink, y * shrink
    return torch.stack((x, y, torch.sqrt((1 - x * x - y * y).clamp(min=0))))


def directions_on(normal: Tensor, angle: float | Tensor) -> tuple[Tensor, Tensor]:
    """Return light and view [3, ...] in the tangent frames of normals [3, ...] of a sphere seen along -Z.

    The light lies in the plane Y = 0, `angle` radians from Z toward X. Any tangent does for an isotropic surface.
    """
    x, y, z = normal
    angle = torch.as_tensor(angle, dtype=normal.dtype)
    sine, cosine = torch.sin(angle), torch.cos(angle)
    radius = torch.sqrt(x * x + y * y)
    # The tangent points away from the viewer's axis: the view is (-radius, 0, z) in its frame.
    ux, uy = torch.where(radius > 0, safe.divide(x, radius), torch.ones_like(x)), safe.divide(y, radius)
    light = torch.stack((sine * ux * z - cosine * radius, -sine * uy, sine * x + cosine * z))
    view = torch.stack((-radius, torch.zeros_like(z), z))
    return light, view
