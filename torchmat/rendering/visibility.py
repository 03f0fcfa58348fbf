"""What a camera sees of a mesh: found once, then shaded under as many lights as are wanted."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import torch
from torch import Tensor

from torchmat import frames, safe
from torchmat.errors import RangeError, message
from torchmat.rendering.camera import Camera, Rays
from torchmat.rendering.lights import Light
from torchmat.rendering.mesh import Mesh

RAYS = (1, 4, 9, 16)
_INSIDE = 0.6  # winding number: 1 inside of a closed surface, 0 outside, half in the surface itself
_LIFT = 1e-4  # of the mesh's radius: how far off its surface a shadow ray starts
_ROUNDING = 4 * torch.finfo(torch.float32).eps  # of a coordinate, on its way through Embree
_BEND = math.radians(12.0)  # neighbouring rays whose normals differ more lie on an edge


@dataclass(frozen=True, eq=False)
class Visible:
    """The points of a mesh that a camera's rays meet, as planes of height 1 and width P.

    `pixel` [P] is where in the picture of `size` (rows, columns), row by row, each is seen, and `weight` [P] the share of
    the pixel that it stands for. `position` [3, 1, P] counts from the mesh's origin; `frame` [3, 3, 1, P] holds tangent,
    bitangent and normal as rows; `view` [3, 1, P] is the direction to the camera in that frame. `uv` [2, 1, P] counts
    textures, `footprint` [P] is how many of them lie across a pixel, where it is longest. `triangle` [P] of the mesh
    holds the point, `share` [3, P] is what its corners have of it.
    """

    size: tuple[int, int]
    mesh: Mesh
    pixel: Tensor
    weight: Tensor
    position: Tensor
    frame: Tensor
    view: Tensor
    uv: Tensor
    footprint: Tensor
    triangle: Tensor
    share: Tensor

    def resolve(self, values: Tensor) -> Tensor:
        """Return the picture [3, rows, columns] of values [3, 1, P]; black where nothing is seen."""
        rows, columns = self.size
        picture = torch.zeros(len(values), rows * columns, dtype=values.dtype)
        picture.index_add_(1, self.pixel, values[:, 0] * self.weight)
        return picture.reshape(-1, rows, columns)

    @property
    def coverage(self) -> Tensor:
        """Which share of each pixel shows the object, [1, rows, columns]: 1 inside of it, 0 beside it."""
        return self.resolve(torch.ones(1, 1, len(self.pixel), dtype=self.weight.dtype)).clamp(max=1)

    def reached_by(self, light: Light, which: Tensor) -> Tensor:
        """Return, as bool, which of the points numbered `which`, all facing a light, no part of the mesh hides."""
        start = self._shadow_starts[which]
        direction, _, distance = light.reach(start.T[:, None], self.mesh.origin)
        found = first_hits(self.mesh, start, direction[:, 0].T.expand(len(start), 3))
        reached = torch.ones(len(start), dtype=torch.bool)
        # What touches a point light does not hide it.
        reached[found.ray] = False if distance is None else found.distance > distance[0, found.ray] * (1 - _LIFT)
        return reached

    @cached_property
    def _shadow_starts(self) -> Tensor:
        """Where shadow rays start [P, 3], float64: on the round surface that the normals of flat triangles stand for.

        From the triangles themselves, rays that leave at a grazing angle run into their neighbours, and the border of
        the lit side is a sawtooth. The point moves to the mean of its projections onto the corners' tangent planes,
        where those lie above it (Hanika, "Hacking the Shadow Terminator", Ray Tracing Gems II, 2021).
        """
        corner = self.mesh.faces[self.triangle]
        normal = self.mesh.normal[corner].double()
        point = self.position[:, 0].double().T
        below = ((point[:, None] - self.mesh.position[corner].double()) * normal).sum(dim=2).clamp(max=0)
        rise = ((-below * self.share.double().T)[:, :, None] * normal).sum(dim=1)
        lift = _LIFT * self.mesh.radius + _ROUNDING * float(self.mesh.position.abs().max())
        return point + rise + lift * self.frame[2, :, 0].double().T


class Hits(NamedTuple):
    """Which rays [P] meet a `triangle` [P], the first on their way, its `distance` [P] and its corners' `share` [P, 3]."""

    ray: Tensor
    triangle: Tensor
    distance: Tensor
    share: Tensor


def _dot(one: Tensor, other: Tensor) -> Tensor:
    """Return the products [P] of vectors [P, 3]: column by column, where a sum over three is five times as slow."""
    (a, b, c), (d, e, f) = one.unbind(dim=1), other.unbind(dim=1)
    return torch.addcmul(torch.addcmul(a * d, b, e), c, f)


def first_hits(mesh: Mesh, origin: Tensor, direction: Tensor) -> Hits:
    """Return what rays from `origin`, from the mesh's, along `direction` [P, 3], unit, float64, meet first (Embree)."""
    if not len(origin):
        empty = origin.new_zeros(0)
        return Hits(empty.long(), empty.long(), empty, origin)
    # Embree has 24 bits, so the empty way to the mesh is gone before: from afar rays slip through between triangles.
    ahead = _dot(mesh.centre - mesh.offset - origin, direction).sub_(1.01 * mesh.radius).clamp_(min=0)
    origin = torch.addcmul(origin, ahead[:, None], direction)
    triangle = torch.from_numpy(mesh.first_met(origin.numpy(), direction.contiguous().numpy())).long()
    ray = (triangle >= 0).nonzero()[:, 0]
    triangle, origin, direction = triangle[ray], origin[ray], direction[ray]
    corner = mesh.position[mesh.faces[triangle]].double()
    first, second = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    # Moeller & Trumbore 1997, in double precision: Embree's own distances have 24 bits as well.
    across = torch.linalg.cross(direction, second)
    inverse = safe.divide(torch.ones((), dtype=torch.float64), _dot(first, across))
    offset = origin - corner[:, 0]
    u = _dot(offset, across) * inverse
    v = _dot(direction, torch.linalg.cross(offset, first)) * inverse
    # Embree's rounding may put a ray a hair's breadth outside of the triangle that it says, and far outside of one that
    # is seen edge-on: the point stays in the triangle.
    share = torch.stack((1 - u - v, u, v), dim=1).clamp(min=0)
    share = share / share.sum(dim=1, keepdim=True)
    way = share[:, 1:2] * first + share[:, 2:] * second - offset
    return Hits(ray, triangle, ahead[ray] + _dot(way, direction), share)


def winding_number(mesh: Mesh, point: Tensor) -> float:
    """Return how often the mesh surrounds `point` [3]: the solid angle of its triangles (van Oosterom & Strackee 1983).

    About 1 inside of a closed mesh whose triangles face outward, 0 outside, and in between where it is open; negative
    in front of an open mesh, or inside of one whose triangles face inward. A triangle in whose plane the point lies
    counts 0.
    """
    corner = mesh.position.double()[mesh.faces] - (point.double() - mesh.offset)
    a, b, c = corner.unbind(dim=1)
    la, lb, lc = corner.norm(dim=2).unbind(dim=1)
    volume = (a * torch.linalg.cross(b, c)).sum(dim=1)
    below = la * lb * lc + (a * b).sum(dim=1) * lc + (b * c).sum(dim=1) * la + (c * a).sum(dim=1) * lb
    return float(torch.where(volume == 0, 0.0, torch.atan2(volume, below)).sum() / (2 * math.pi))


def check_outside(mesh: Mesh, name: str, position: Sequence[float] | Tensor) -> None:
    """Raise RangeError when a camera or a light stands behind the mesh's surface on all sides: it sees none of it.

    Inside of a mesh that faces inward, a room, all of it is seen.
    """
    place = torch.as_tensor(position, dtype=torch.float64)
    if float((place - mesh.centre).norm()) > mesh.radius:
        return
    if winding_number(mesh, place) > _INSIDE:
        fact = f"it stands at {tuple(round(float(k), 6) for k in position)}, inside"
        step = f"Move it out: the mesh lies within {mesh.radius:.6g} of {tuple(round(float(k), 6) for k in mesh.centre)}."
        raise RangeError(message("render", name, f"lie outside of the mesh {mesh.name!r}", fact, step))


def see(
    mesh: Mesh, camera: Camera, size: int | tuple[int, int] = 512, rays: int = 4, edges_only: bool = False,
    repeat: float = 1.0, dtype: torch.dtype = torch.float32,
) -> Visible:
    """Return what `camera` sees of `mesh` in a picture of `size` (rows, columns, or one number for both).

    `rays` 1, 4, 9 or 16 go through a pixel, on a grid; with `edges_only` one through each and the others only where
    neighbours meet normals more than 12 degrees apart, or one behind the other, or only one of them the mesh. Texture
    coordinates are multiplied by `repeat`. Raises RangeError when the camera stands inside of the mesh.
    """
    rows, columns = picture_size(size, repeat, rays)
    check_outside(mesh, "the camera", camera.position)
    side = math.isqrt(rays)
    wanted = _may_show(mesh, camera, rows, columns, rays)
    if side == 1 or not edges_only:
        pixel, x, y = _grid(wanted, side)
        found = _meet(mesh, camera.rays(x, y, columns), side, repeat, dtype)
        return _visible((rows, columns), mesh, pixel, 1.0 / rays, found)
    pixel, x, y = _grid(wanted, 1)
    found = _meet(mesh, camera.rays(x, y, columns), 1, repeat, dtype)
    edge = _edges(found, pixel, (rows, columns))
    fine, x, y = _grid(edge.reshape(rows, columns), side)
    more = _meet(mesh, camera.rays(x, y, columns), side, repeat, dtype)
    coarse = _visible((rows, columns), mesh, pixel, 1.0, found, ~edge)
    return _joined(coarse, _visible((rows, columns), mesh, fine, 1.0 / rays, more))


def picture_size(size: int | tuple[int, int], repeat: float = 1.0, rays: int = 1) -> tuple[int, int]:
    """Return rows and columns; raises RangeError for a size, a repeat or a number of rays that cannot be."""
    numbers = (size, size) if isinstance(size, int) else size
    whole = isinstance(numbers, Sequence) and len(numbers) == 2 and all(isinstance(n, int) and n > 0 for n in numbers)
    if not whole or not 0 < repeat < math.inf:
        step = "A size is one whole number, or rows and columns."
        raise RangeError(message("render", "size and repeat", "be positive", f"they are {size} and {repeat}", step))
    if rays not in RAYS:
        raise RangeError(message("render", "rays", f"be one of {', '.join(map(str, RAYS))}", f"it is {rays!r}"))
    return numbers[0], numbers[1]


def _may_show(mesh: Mesh, camera: Camera, rows: int, columns: int, rays: int) -> Tensor:
    """Return which pixels, bool [rows, columns], may show the mesh: those that a triangle's rectangle in the picture meets.

    All of them where a triangle reaches behind the camera, and of a mesh of more triangles than rays, which would take longer.
    """
    every = torch.ones(rows, columns, dtype=torch.bool)
    if len(mesh.faces) > rays * rows * columns:
        return every
    x, y, ahead = camera.place(mesh.position.double() + mesh.offset)
    if not bool((ahead > 0).all()):
        return every
    count = torch.zeros(rows + 1, columns + 1, dtype=torch.int32)
    across, down = (x + 1) / 2 * columns, (1 - y * columns / rows) / 2 * rows
    # A pixel more on all sides: the search for what rays meet rounds.
    ends = [part[mesh.faces] for part in (down, across)]
    low = [(part.amin(dim=1).floor() - 1).clamp(0, most).long() for part, most in zip(ends, (rows, columns), strict=True)]
    high = [(part.amax(dim=1).floor() + 2).clamp(0, most).long() for part, most in zip(ends, (rows, columns), strict=True)]
    # How many rectangles cover a pixel is the sum of what begins and ends above and to the left of it.
    for (row, column), step in (((low[0], low[1]), 1), ((low[0], high[1]), -1), ((high[0], low[1]), -1), ((high[0], high[1]), 1)):
        count.view(-1).index_add_(0, row * (columns + 1) + column, torch.full((), step, dtype=torch.int32).expand(len(row)))
    return count.cumsum(0).cumsum(1)[:rows, :columns] > 0


def _grid(wanted: Tensor, side: int) -> tuple[Tensor, Tensor, Tensor]:
    """Return each ray's pixel and its place in half widths from the picture's centre; `side` squared rays a `wanted` pixel [h, w]."""
    rows, columns = wanted.shape
    down, across = wanted.repeat_interleave(side, 0).repeat_interleave(side, 1).nonzero().unbind(dim=1)
    x = (across.double() + 0.5) / (columns * side) * 2 - 1
    y = (1 - (down.double() + 0.5) / (rows * side) * 2) * (rows / columns)
    return (down // side) * columns + across // side, x, y


@dataclass(frozen=True)
class _Met:
    """What rays meet: `which` [P] of them do, where, in what frame."""

    which: Tensor
    position: Tensor
    frame: Tensor
    view: Tensor
    uv: Tensor
    footprint: Tensor
    triangle: Tensor
    share: Tensor


def _meet(mesh: Mesh, rays: Rays, side: int, repeat: float, dtype: torch.dtype) -> _Met:
    origin = rays.origin - mesh.offset
    which, triangle, distance, share = first_hits(mesh, origin, rays.direction)
    share, corner = share.to(dtype), mesh.faces[triangle]

    def between(values: Tensor) -> Tensor:
        return (values.to(dtype)[corner] * share[:, :, None]).sum(dim=1).T[:, None].contiguous()

    frame = _frames(between(mesh.normal), between(mesh.tangent), between(mesh.handedness[:, None]))
    view = -rays.direction[which].T[:, None].to(dtype)
    local = (frame * view).sum(dim=1)
    position = (origin[which] + rays.direction[which] * distance[:, None]).T[:, None].to(dtype)
    width = (rays.width_at_origin + rays.width_per_distance * distance).to(dtype) / side
    # A pixel covers the longer a stretch of the surface the more obliquely it is seen; past 20 times as long it stays so.
    footprint = width * repeat * mesh.textures_per_length(triangle).to(dtype) / local[2, 0].clamp(min=0.05)
    return _Met(which, position, frame, local, between(mesh.uv) * repeat, footprint, triangle, share.T)


def _frames(normal: Tensor, tangent: Tensor, handedness: Tensor) -> Tensor:
    """Return orthonormal frames [3, 3, 1, P] of interpolated normals and tangents."""
    normal = safe.normalise(normal)
    tangent = safe.normalise(tangent - normal * (tangent * normal).sum(dim=0))
    cancelled = ~tangent.any(dim=0)
    if bool(cancelled.any()):  # between corners whose tangents are opposite
        tangent = torch.where(cancelled, frames.tangent_frame(normal)[0], tangent)
    bitangent = torch.linalg.cross(normal, tangent, dim=0) * torch.where(handedness < 0, -1, 1)
    return torch.stack((tangent, bitangent, normal))


def _visible(
    size: tuple[int, int], mesh: Mesh, pixel: Tensor, weight: float, met: _Met, wanted: Tensor | None = None
) -> Visible:
    """Return met points as Visible; `wanted` bool [pixel] leaves out those of other pixels."""
    pixel = pixel[met.which]
    kept = slice(None) if wanted is None else wanted[pixel].nonzero()[:, 0]
    pixel = pixel[kept]
    share = torch.full((len(pixel),), weight, dtype=met.position.dtype)
    planes = (met.position, met.frame, met.view, met.uv, met.footprint, met.triangle, met.share)
    return Visible(size, mesh, pixel, share, *(plane[..., kept] for plane in planes))


def _joined(one: Visible, other: Visible) -> Visible:
    names = ("pixel", "weight", "position", "frame", "view", "uv", "footprint", "triangle", "share")
    both = (torch.cat((getattr(one, name), getattr(other, name)), dim=-1) for name in names)
    return Visible(one.size, one.mesh, *both)


def _edges(met: _Met, pixel: Tensor, size: tuple[int, int]) -> Tensor:
    """Return which pixels, bool [rows * columns], differ from a neighbour in what they show; `pixel` is each ray's."""
    planes = torch.zeros(7, size[0] * size[1], dtype=met.frame.dtype)
    planes[:, pixel[met.which]] = torch.cat((met.frame[2, :, 0], met.position[:, 0], torch.ones_like(met.position[:1, 0])))
    planes = planes.reshape(7, *size)
    edge = torch.zeros(size, dtype=torch.bool)
    for dim in (0, 1):
        near, far = (slice(None),) * dim + (slice(0, -1),), (slice(None),) * dim + (slice(1, None),)
        pair = (planes[(slice(None), *side)].split((3, 3, 1)) for side in (near, far))
        (normal, place, hit), (other, there, met_too) = pair
        step = there - place
        # On one smooth surface the way from point to point lies across the normals.
        behind = (step * (normal + other)).sum(dim=0).abs() > 2 * math.sin(_BEND) * step.norm(dim=0)
        bent = (normal * other).sum(dim=0) < math.cos(_BEND)
        apart = (hit != met_too)[0] | ((hit[0] > 0) & (bent | behind))
        edge[near] |= apart
        edge[far] |= apart
    return edge.flatten()
