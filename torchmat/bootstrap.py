"""How far an error could have come out otherwise, had other images been measured: the bootstrap of a ratio of sums."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

RESAMPLES = 2000
_COVERED = (2.5, 97.5)  # percentiles, of an interval of 95 %
_SEED = 0
_DRAWN = 1_000_000  # images that are drawn at a time: what that takes is bounded, whatever their number


def ratio_interval(error: ArrayLike, energy: ArrayLike) -> tuple[float, float] | None:
    """Return the 95 % interval of sum(error) / sum(energy) over images, by drawing them anew with replacement.

    A relative error is a ratio of sums, and squares make its sums those of the brightest few: ten images of a near-mirror
    can decide it, so that a difference between two models may be the luck of which of them were held out. Whole images are
    drawn, for the values of one are alike; both sums of an image go together. The percentiles of 2000 such ratios, from a
    fixed seed: the same images give the same interval. Images under one light, or of one view, count as independent, which
    they are not quite: with few lights or views held out the interval is too narrow (Efron and Tibshirani 1993, chapter 13).

    Args:
        error: summed squared error of each image [n].
        energy: summed squared truth of each image [n], at least 0.

    Returns None where there is no such interval: fewer than two images, all black, or values that are not finite.
    """
    both = np.stack([np.asarray(error, np.float64), np.asarray(energy, np.float64)], axis=1)
    count = len(both)
    if count < 2 or not np.isfinite(both).all():
        return None
    random = np.random.default_rng(_SEED)
    sums, step = [], max(1, _DRAWN // count)
    for start in range(0, RESAMPLES, step):
        sums.append(both[random.integers(0, count, (min(step, RESAMPLES - start), count))].sum(axis=1))
    found = np.concatenate(sums)
    found = found[found[:, 1] > 0]  # a draw of black images alone has no ratio
    if not len(found):
        return None
    low, high = np.percentile(found[:, 0] / found[:, 1], _COVERED)
    return (float(low), float(high)) if math.isfinite(high) else None
