"""Rays that are followed once, and then moved along with the height as it changes a little."""

from __future__ import annotations

import torch
from torch import Tensor

from torchmat.geometry.rays import Obstacles, find_obstacles, look_up, ray_slope, texel_centres, trace_view
from torchmat.models.fine_relief import FineRays, coverage, edge_width, refined

_AT_A_TIME = 500_000  # rays
_FLATTEST = 0.1  # a ray that only just touches moves without bound: ten times as far as over a flat surface at most


class Followed:
    """What distinct `lights` [l, 3, 1, 1] and `views` [v, 3, 1, 1] meet on a fine relief.

    To first order the end of a ray moves by the change of the height there over how steeply the ray meets it; what a
    light's ray comes nearest to stays the same.
    """

    def __init__(self, height: Tensor, lights: Tensor, views: Tensor, tiles: bool) -> None:
        self.lights, self.views, self.tiles = lights, views, tiles
        self.follow(height)

    @torch.no_grad()
    def follow(self, height: Tensor) -> None:
        """Follow all rays anew."""
        fine = refined(height.detach(), self.tiles)
        some = max(1, _AT_A_TIME // fine.numel())
        parts = [find_obstacles(fine, part, self.tiles) for part in self.lights.split(some)]
        self.obstacles = Obstacles(*(torch.cat(planes) for planes in zip(*parts, strict=True)))
        every = torch.arange(len(self.lights)).split(some)
        self.width = torch.cat([edge_width(self.obstacles.clearance(fine, self.tiles, part), self.tiles) for part in every])
        self.root = torch.cat([trace_view(fine, part, tiles=self.tiles).height for part in self.views.split(some)])
        self.slope = ray_slope(self.views, *fine.shape[-2:])
        self.steepness = self._steepness(fine)

    def _steepness(self, fine: Tensor) -> Tensor:
        """Return how much faster rays fall than the surface where they end, [v, 1, h, w]."""
        step = 0.25 / fine.shape[-1] / (self.slope.norm(dim=1, keepdim=True) + 1)
        centres = texel_centres(fine.shape[-2], fine.shape[-1], fine.dtype)
        some = max(1, _AT_A_TIME // fine.numel())
        found = []
        for root, slope, near in zip(self.root.split(some), self.slope.split(some), step.split(some), strict=True):
            ahead, behind = (look_up(fine[None], centres + (root + side * near) * slope, self.tiles) for side in (1, -1))
            found.append(1 - (ahead - behind) / (2 * near))
        return torch.cat(found).clamp(min=_FLATTEST)

    def on(self, height: Tensor, light: Tensor, view: Tensor) -> FineRays:
        """Return what samples of these lights and views, by number [n], meet on a height that has changed a little."""
        fine = refined(height, self.tiles)
        (lights, light), (views, view) = (which.unique(return_inverse=True) for which in (light, view))
        lit = coverage(self.obstacles.clearance(fine, self.tiles, lights), self.width[lights])
        root, slope = self.root[views], self.slope[views]
        start = texel_centres(fine.shape[-2], fine.shape[-1], fine.dtype)
        gap = look_up(fine[None], start + root * slope, self.tiles) - root
        return FineRays(lit, light, start + (root + gap / self.steepness[views]) * slope, view)
