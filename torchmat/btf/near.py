"""Near lights and cameras: a position for each image in place of one direction, and so a direction for each texel."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from torch import Tensor

from torchmat.errors import RangeError, ShapeError, message

LIGHT, VIEW = "light", "view"
NEAREST = 1e-3  # widths of the texture: a position closer to a texel is in the sample, and has no direction there
_AGREE = 1e-2  # of a direction that is given beside its position


class Grid(NamedTuple):
    """Where texels lie in the plane of the texture, whose centre is the origin and whose width is 1; x right, y up.

    `left`, `top`: x and y of the centre of the first texel; `across`, `down`: from one to the next; `rows` x `columns` of them.
    """

    left: float
    top: float
    across: float
    down: float
    rows: int
    columns: int

    @classmethod
    def whole(cls, height: int, width: int) -> Grid:
        """Return the texels of a whole texture."""
        step = 1 / width
        return cls((step - 1) / 2, (height - 1) * step / 2, step, step, height, width)

    def window(self, rows: slice, columns: slice) -> Grid:
        """Return some of the texels, which stay where they are."""
        first, _, row_step = rows.indices(self.rows)
        start, _, column_step = columns.indices(self.columns)
        return Grid(
            self.left + start * self.across, self.top - first * self.down, self.across * column_step, self.down * row_step,
            len(range(*rows.indices(self.rows))), len(range(*columns.indices(self.columns))),
        )

    def resized(self, rows: int, columns: int) -> Grid:
        """Return other texels that cover the same part."""
        across, down = self.across * self.columns / columns, self.down * self.rows / rows
        return Grid(self.left + (across - self.across) / 2, self.top - (down - self.down) / 2, across, down, rows, columns)

    def places(self, dtype: torch.dtype) -> tuple[Tensor, Tensor]:
        """Return x [W] of the columns and y [H] of the rows."""
        x = self.left + self.across * torch.arange(self.columns, dtype=torch.float64)
        y = self.top - self.down * torch.arange(self.rows, dtype=torch.float64)
        return x.to(dtype), y.to(dtype)


@dataclass(frozen=True, eq=False)
class Near:
    """Where lights and cameras stand: `light`, `view` [sample, 3] or None where these are far, and the texels of the images.

    Positions are in widths of the whole texture from its centre, x right, y up, z along the normal. `falloff` says that the
    images are the darker the further a texel is from the light, as 1 / distance^2: read, they are brought to what the light
    would do everywhere at the distance that it has from the centre. `height` [H, W], in the same unit, is how far texels
    stand over the plane, None where that is not known: then directions are those in the plane.
    """

    light: Tensor | None
    view: Tensor | None
    grid: Grid
    falloff: bool = True
    height: Tensor | None = None

    def positions(self, which: str) -> Tensor | None:
        """Return the positions of "light" or "view"."""
        return self.light if which == LIGHT else self.view

    def check(self, where: str, count: int) -> None:
        """Raise ShapeError or RangeError, which name the sample, for positions that give no directions."""
        for which in (LIGHT, VIEW):
            position = self.positions(which)
            if position is not None:
                check_positions(where, which, position, count, self.grid)

    def centre(self, which: str) -> Tensor | None:
        """Return the unit directions [sample, 3] at the texture's centre, None of what is far."""
        position = self.positions(which)
        return None if position is None else unit(position)

    def directions(self, which: str, samples: Tensor, dtype: torch.dtype) -> Tensor | None:
        """Return the unit directions of samples [k], a plane for each texel: [k, 3, H, W]; None of what is far."""
        position = self.positions(which)
        if position is None:
            return None
        away, square = self._away(position[samples].to(dtype))
        return away.mul_(square.rsqrt_())

    def at(self, which: str, samples: Tensor, texels: Tensor, dtype: torch.dtype) -> Tensor | None:
        """Return the unit directions of samples [k] at texels of numbers [t], [k, 3, t]; None of what is far."""
        position = self.positions(which)
        if position is None:
            return None
        x, y = self.grid.places(dtype)
        z = torch.zeros_like(texels, dtype=dtype) if self.height is None else self.height.flatten()[texels].to(dtype)
        place = torch.stack((x[texels % self.grid.columns], y[texels // self.grid.columns], z))
        return unit(position[samples].to(dtype)[:, :, None] - place)

    def gain(self, samples: Tensor, dtype: torch.dtype) -> Tensor | None:
        """Return what images [k, 3, H, W] are multiplied with, [k, 1, H, W], which takes the fall-off out; None: nothing."""
        if self.light is None or not self.falloff:
            return None
        position = self.light[samples].to(dtype)
        _, square = self._away(position)
        return square.div_(position.square().sum(dim=1)[:, None, None, None])

    def _away(self, position: Tensor) -> tuple[Tensor, Tensor]:
        """Return vectors [k, 3, H, W] from the texels to positions [k, 3], and their squared lengths [k, 1, H, W]."""
        x, y = self.grid.places(position.dtype)
        away = position.new_empty(len(position), 3, self.grid.rows, self.grid.columns)
        across, up, rise = (position[:, axis, None, None] for axis in range(3))
        away[:, 0] = across - x
        away[:, 1] = up - y[:, None]
        away[:, 2] = rise if self.height is None else rise - self.height.to(position.dtype)
        return away, (away * away).sum(dim=1, keepdim=True)

    def picked(self, rows: Tensor) -> Near:
        """Return the positions of some samples."""
        light, view = (None if part is None else part[rows] for part in (self.light, self.view))
        return replace(self, light=light, view=view)

    def window(self, rows: slice, columns: slice) -> Near:
        """Return the same positions for some of the texels."""
        height = None if self.height is None else self.height[rows, columns]
        return replace(self, grid=self.grid.window(rows, columns), height=height)

    def resized(self, rows: int, columns: int) -> Near:
        """Return the same positions for images of another size, in which the fall-off is taken out."""
        return replace(self, grid=self.grid.resized(rows, columns), falloff=False, height=None)

    def raised(self, height: Tensor) -> Near:
        """Return the same positions for texels that stand `height` [1, H, W] over the plane, in widths of these images."""
        return replace(self, height=height[0] * (self.grid.across * self.grid.columns))

    def arrays(self) -> list[Tensor]:
        """Return what tells it from others."""
        parts = [torch.tensor([*self.grid, self.falloff], dtype=torch.float64), self.light, self.view, self.height]
        return [part for part in parts if part is not None]

    def sentence(self) -> str:
        """Return in words what is near, and how near."""
        found = [
            f"near {which}s, {span(position)} texture widths from the centre"
            for which, position in ((LIGHT, self.light), (VIEW, self.view)) if position is not None
        ]
        if self.light is not None:
            found.append("fall-off taken out" if self.falloff else "fall-off not in the images")
        return "; ".join(found)

    def figures(self) -> dict[str, object]:
        """Return what a report says of it."""
        spans = {
            f"{which}_distance": [float(end) for end in position.double().norm(dim=1).aminmax()]
            for which, position in ((LIGHT, self.light), (VIEW, self.view)) if position is not None
        }
        return {"near": {"meaning": self.sentence(), **spans, "falloff": self.falloff}}


def far_only(where: str, near: Near | None) -> None:
    """Raise RangeError, with the way on, where data is `near` and what is at work knows one direction for all texels alone."""
    if near is not None:
        step = "btf.far() takes the direction at the centre for all texels; on the command line leave --near or sample_width out."
        raise RangeError(message(where, "lights and cameras", "be far", near.sentence(), step))


def unit(position: Tensor) -> Tensor:
    """Return vectors [n, 3, ...] at length 1; of one that has none NaN."""
    scaled = position / position.abs().amax(dim=1, keepdim=True)  # or squares of what is far away leave the range of numbers
    return scaled / scaled.norm(dim=1, keepdim=True)


def span(position: Tensor) -> str:
    """Return the least and the greatest distance of positions [n, 3] in words."""
    low, high = position.double().norm(dim=1).aminmax()
    return f"{float(low):.3g}" if float(high - low) < 5e-3 * float(high) else f"{float(low):.3g} to {float(high):.3g}"


def check_positions(where: str, which: str, position: Tensor, count: int, grid: Grid) -> None:
    """Raise ShapeError or RangeError unless `position` [count, 3] are points above the plane, and outside of the sample."""
    name = f"{which}_position"
    if position.shape != (count, 3):
        fact = f"there are {count} images and it is {tuple(position.shape)}"
        raise ShapeError(message(where, name, "be [sample, 3]", fact, "Give one position for each image."))
    unknown = ~torch.isfinite(position).all(dim=1)
    _refuse(where, name, "be finite", unknown, position, "Measure those, or leave the images out.")
    step = "Positions are in widths of the texture from its centre, z away from the surface; check the unit and the origin."
    _refuse(where, name, "lie above the surface", position[:, 2] <= 0, position, step)
    size = torch.tensor([grid.across * grid.columns, grid.down * grid.rows], dtype=torch.float64)
    corner = torch.tensor([grid.left - grid.across / 2, grid.top + grid.down / 2 - size[1]], dtype=torch.float64)
    place = position.double()
    beside = torch.maximum(corner - place[:, :2], place[:, :2] - corner - size).clamp(min=0)
    inside = (beside.square().sum(dim=1) + place[:, 2].square()).sqrt() < NEAREST
    _refuse(where, name, f"be at least {NEAREST:g} widths from the sample", inside, position, step)


def _refuse(where: str, name: str, requirement: str, bad: Tensor, position: Tensor, step: str) -> None:
    if bool(bad.any()):
        first = int(bad.nonzero()[0, 0])
        x, y, z = position[first].tolist()
        fact = f"{int(bad.sum())} of {len(bad)} are not, first that of sample {first}: ({x:.4g}, {y:.4g}, {z:.4g})"
        raise RangeError(message(where, name, requirement, fact, step))


def with_centre(where: str, which: str, direction: Tensor | None, position: Tensor | None) -> Tensor:
    """Return the directions [n, 3] of positions [n, 3], or those that are given where there are none.

    Raises RangeError where both are there and differ, or neither is.
    """
    if position is None:
        if direction is None:
            raise RangeError(message(where, which, "be given", "it is None", f"Give {which}, or {which}_position."))
        return direction
    found = unit(position)
    if direction is not None and (direction.shape != found.shape or bool(((direction - found).norm(dim=1) > _AGREE).any())):
        fact = f"{which}_position says something else"
        raise RangeError(message(where, which, "point at the position", fact, f"Give {which}=None: it follows from the position."))
    return found
