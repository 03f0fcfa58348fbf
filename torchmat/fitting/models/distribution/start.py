"""What is known of each texel before the fit of the distribution material."""

from __future__ import annotations

import torch
from torch import Tensor

from torchmat.btf.lambert import lights_of
from torchmat.fitting.models.distribution.parameters import anisotropy, sample_runs
from torchmat.fitting.relief.surface import Surface
from torchmat.geometry import photometric_stereo, slopes_from_normals
from torchmat.repeatable import one_thread


def find_starts(surface: Surface, level: float) -> dict[str, Tensor]:
    """Return what is known of each texel before the fit: mean colour, slopes, direction of anisotropy, features."""
    training = surface.training
    btf, dtype = training.btf, training.dtype
    mean, weight = torch.zeros(3, btf.height, btf.width, dtype=dtype), torch.zeros(1, btf.height, btf.width, dtype=dtype)
    for run in sample_runs(btf):
        values, valid = surface.values(run)
        mean += (values * valid).sum(dim=0)
        weight += valid.sum(dim=0)
    mean = mean / weight.clamp(min=1e-6)
    slopes = _start_slopes(surface)
    starts = {"mean": mean.clamp(min=1e-3 * level), "slopes": slopes}
    return starts | anisotropy(surface, starts["mean"], slopes)


def _start_slopes(surface: Surface) -> Tensor:
    """Return slopes by photometric stereo from the most frontal view, or else those of the height, a flat one's 0."""
    source = surface.source
    btf, dtype = source.btf, source.dtype
    rows = (source.used & (btf.view_index == int(btf.view_index[source.used].min()))).nonzero()[:, 0]
    light = btf.light[rows].to(dtype)
    spread = torch.linalg.eigvalsh((light.T @ light).double())
    if len(rows) < 6 or float(spread[0]) < 1e-2 * float(spread[-1]):
        return surface.slopes
    with one_thread():
        found = photometric_stereo(btf.images(rows, dtype), lights_of(btf, rows, dtype), btf.weights(rows))
    return torch.where(found.confidence > 0, slopes_from_normals(found.normal), surface.slopes)
