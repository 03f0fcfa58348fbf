"""The values of a sample's texels: each photograph corrected, rectified, and divided by what its lamp sent there."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from torchmat.capturing.rectify import Grid, Rectified, rectify
from torchmat.capturing.scene import Photometry, Scene

_CLIPPED = 0.05  # share of a texel that may be clipped pixels: more and it is not valid


def texels_of(scene: Scene, photometry: Photometry, index: int, grid: Grid, shift: np.ndarray | None = None) -> Rectified:
    """Return a photograph on the texels; where it is clipped, does not show the sample, or has no light, it is not valid."""
    one = scene.photographs[index].developed()
    planes = torch.cat((photometry.correct(index, one.linear), one.clipped[None].float()))
    found = rectify(planes, scene.cameras[index], scene.poses[index], grid, scene.board, shift)
    light = torch.from_numpy(np.moveaxis(np.asarray(photometry.irradiance(index, grid.points()), np.float32), -1, 0))
    lit = (light > 0).all(0)
    values = found.values[:-1] / torch.where(lit, light, 1.0)
    return Rectified(_finite(values), found.valid & lit & (found.values[-1] < _CLIPPED), found.density)


def _finite(values: Tensor) -> Tensor:
    """Return values that a half float holds; cubic interpolation goes a little below black beside highlights."""
    return values.clamp(0, 65504)
