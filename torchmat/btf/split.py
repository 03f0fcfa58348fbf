"""Which samples a fit never sees: by pair, by light or by view, from a seed."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchmat.btf.btf import Btf
from torchmat.errors import RangeError, check_option, message

HOLDOUT_WAYS = ("pair", "light", "view")


class Split(NamedTuple):
    """Sample indices, ascending: `train` [n] and `held_out` [m]."""

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


def split_samples(btf: Btf, share: float = 0.2, by: str = "pair", seed: int = 0) -> Split:
    """Hold out `share` of the pairs, of the lights or of the views (`by`), chosen by `seed`.

    By light, every image under a held-out light is held out; by view alike. At least one group is held out and at
    least one kept; `share` 0 holds out nothing. Raises RangeError when the data has only one such group.
    """
    where = "split_samples"
    check_option(where, "by", by, HOLDOUT_WAYS)
    if not 0 <= share < 1:
        step = "It is the part that is held out; 0.2 is usual."
        raise RangeError(message(where, "share", "lie in [0, 1)", f"it is {share}", step))
    everything = torch.arange(len(btf))
    if share == 0:
        return Split(everything, everything[:0])
    group = {"pair": _pairs, "light": lambda data: data.light_index, "view": lambda data: data.view_index}[by](btf)
    count = int(group.max()) + 1
    if count < 2:
        step = "Hold out in another way, or pass holdout=0."
        raise RangeError(message(where, "the data", f"have at least two {by}s to hold one out", "it has one", step))
    generator = torch.Generator().manual_seed(seed)
    chosen = torch.randperm(count, generator=generator)[: min(max(1, round(share * count)), count - 1)]
    held = torch.isin(group, chosen)
    return Split(everything[~held], everything[held])
