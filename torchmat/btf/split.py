"""Which samples a fit never sees: by pair, by light, by view or by both, from a seed; or all but one arc of lights."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchmat import frames
from torchmat.btf.btf import Btf
from torchmat.errors import RangeError, check_option, message

BOTH, ARC = "both", "arc"
HOLDOUT_WAYS = ("pair", "light", "view", BOTH, ARC)
_ARC_VIEW_DEG, _ARC_LIGHT_DEG = 5.0, 1.0


class Split(NamedTuple):
    """Sample indices, ascending: `train` [n] and `held_out` [m]; by "both" some samples are in neither."""

    train: Tensor
    held_out: Tensor


def _pairs(btf: Btf) -> Tensor:
    """Return the number [sample] of each sample's pair of light and view, in the order in which pairs first occur.

    A pair that was measured twice has one number, or its second image would give away the first.
    """
    code = btf.light_index * len(btf.views) + btf.view_index
    _, inverse = torch.unique(code, return_inverse=True)
    first = torch.full((int(inverse.max()) + 1,), len(btf), dtype=torch.long)
    first.scatter_reduce_(0, inverse, torch.arange(len(btf)), reduce="amin")
    return first.argsort().argsort()[inverse]


def _arc(btf: Btf) -> Split:
    """Return the samples seen along the normal with the light at azimuth 0, and all others.

    The view lies within 5 degrees of the normal, the light within 1 degree of azimuth 0, or of the normal itself, where
    it has none; below the horizon it is on no arc.
    """
    polar, azimuth = (torch.rad2deg(angle) for angle in frames.to_polar(btf.light.double()))
    seen = torch.rad2deg(frames.to_polar(btf.view.double())[0]) <= _ARC_VIEW_DEG
    near = (torch.minimum(azimuth, 360 - azimuth) <= _ARC_LIGHT_DEG) | (polar <= _ARC_LIGHT_DEG)
    chosen = seen & near & (btf.light[:, 2] > 0)
    if int(chosen.sum()) < 2:
        fact = f"{int(chosen.sum())} of {len(btf)} samples are on it"
        step = "An arc has its view along the normal and its lights at azimuth 0; hold out in another way."
        raise RangeError(message("split_samples", "the data", "have at least two samples on the arc", fact, step))
    return Split(chosen.nonzero()[:, 0], (~chosen).nonzero()[:, 0])


def _chosen(group: Tensor, share: float, by: str, generator: torch.Generator) -> Tensor:
    """Return which samples, bool [n], are of the groups that are drawn to be held out."""
    count = int(group.max()) + 1
    if count < 2:
        step = "Hold out in another way, or pass holdout=0."
        raise RangeError(message("split_samples", "the data", f"have at least two {by}s to hold one out", "it has one", step))
    drawn = torch.randperm(count, generator=generator)[: min(max(1, round(share * count)), count - 1)]
    return torch.isin(group, drawn)


def _both(btf: Btf, share: float, generator: torch.Generator) -> Split:
    """Return the samples whose light and view are both kept, and those whose light and view are both held out."""
    light, view = (_chosen(group, share, by, generator) for group, by in ((btf.light_index, "light"), (btf.view_index, "view")))
    parts = (~light & ~view, light & view)
    if not all(bool(part.any()) for part in parts):
        fact = f"{int(parts[0].sum())} samples are of kept lights and views, {int(parts[1].sum())} of held-out ones"
        step = "Where few pairs were measured give another seed or a larger holdout, or hold out by light or by view."
        raise RangeError(message("split_samples", "the data", "have samples of both kinds", fact, step))
    return Split(*(part.nonzero()[:, 0] for part in parts))


def split_samples(btf: Btf, share: float = 0.2, by: str = "pair", seed: int = 0) -> Split:
    """Hold out some of the samples, so that a fit can be measured on what it never saw.

    At least one group is held out and at least one kept.

    Args:
        btf: the images.
        share: share of the groups to hold out, in [0, 1); 0 holds out nothing.
        by: what a group is: "pair", "light" (every image under it) or "view"; "both" holds out `share` of the lights and of the
            views: measured is where light and view are both new, fitted where neither is, and the rest is left out of both,
            so that of a full grid share^2 is measured and (1 - share)^2 fitted; "arc" keeps what a shading map is photographed
            from, one view along the normal under lights at azimuth 0, and holds out everything else, whatever `share` and
            `seed`, unless `share` is 0.
        seed: chooses the groups, from 0.

    Raises RangeError when the data has only one such group, no samples of both kinds, or fewer than two on the arc.
    """
    where = "split_samples"
    check_option(where, "by", by, HOLDOUT_WAYS)
    if not 0 <= share < 1:
        step = "It is the part that is held out; 0.2 is usual."
        raise RangeError(message(where, "share", "lie in [0, 1)", f"it is {share}", step))
    everything = torch.arange(len(btf))
    if share == 0:
        return Split(everything, everything[:0])
    if by == ARC:
        return _arc(btf)
    generator = torch.Generator().manual_seed(seed)
    if by == BOTH:
        return _both(btf, share, generator)
    group = {"pair": _pairs, "light": lambda data: data.light_index, "view": lambda data: data.view_index}[by](btf)
    held = _chosen(group, share, by, generator)
    return Split(everything[~held], everything[held])
