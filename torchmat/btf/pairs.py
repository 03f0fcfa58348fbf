"""The measured pairs of light and view around any other pair."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from torchmat.btf.btf import unique_directions
from torchmat.btf.neighbours import Triangulation, nearest_pairs, to_disc
from torchmat.errors import DataError, message

_LARGEST_GRID = 1_000_000  # lights x views; a thousand of each is far beyond any gantry


@dataclass(frozen=True, eq=False)
class MeasuredPairs:
    """Known lights and views, triangulated, and the `sample` [lights, views] of each pair of them.

    A pair that was not measured has the nearest pair that was, times `factor` [lights, views], the ratio of the lights'
    cosines; None where all were measured.
    """

    lights: Triangulation
    views: Triangulation
    sample: Tensor
    factor: Tensor | None

    def combined(self, light: Tensor, light_weight: Tensor, view: Tensor, view_weight: Tensor) -> tuple[Tensor, Tensor]:
        """Return numbers [P, k] into the flat grid of pairs and weights, from those of lights and views [P, .]."""
        pair = (light[:, :, None] * self.sample.shape[1] + view[:, None]).flatten(1)
        return pair, (light_weight[:, :, None] * view_weight[:, None]).flatten(1)


def measured_pairs(where: str, light: Tensor, view: Tensor) -> MeasuredPairs:
    """Return the pairs of samples with `light` and `view` [sample, 3].

    Of a pair measured twice the first sample counts. Lights below the surface take no part. Raises DataError, naming
    `where`, when no light stands above it, or when lights and views are scattered over more than a million pairs.
    """
    above = (light[:, 2] > 0).nonzero()[:, 0]
    if not len(above):
        step = "Check that light directions point away from the surface."
        raise DataError(message(where, "a light", "stand above the surface", "none does", step))
    lights, row = unique_directions(light[above])
    views, column = unique_directions(view)
    rows, columns = len(lights), len(views)
    if rows * columns > _LARGEST_GRID:
        fact = f"{rows} lights and {columns} views make {rows * columns} pairs, of which {len(light)} were measured"
        step = "Choose fewer lights and views when loading, or fit a material and render that."
        requirement = f"form a grid of at most {_LARGEST_GRID} pairs"
        raise DataError(message(where, "lights and views", requirement, fact, step))
    missing = len(light)
    sample = torch.full((rows * columns,), missing)
    sample.scatter_reduce_(0, row * columns + column[above], above, reduce="amin")
    gaps = (sample == missing).nonzero()[:, 0]
    factor = None
    if len(gaps):
        there = (sample != missing).nonzero()[:, 0]
        place = torch.cat((to_disc(lights).repeat_interleave(columns, dim=0), to_disc(views).repeat(rows, 1)), dim=1)
        nearest = there[nearest_pairs(place[there], place[gaps])]
        factor = torch.ones(rows * columns, dtype=lights.dtype)
        factor[gaps] = lights[gaps // columns, 2] / lights[nearest // columns, 2]
        sample[gaps] = sample[nearest]
        factor = factor.reshape(rows, columns)
    return MeasuredPairs(Triangulation(lights), Triangulation(views), sample.reshape(rows, columns), factor)
