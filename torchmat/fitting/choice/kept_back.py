"""What is kept back from the training samples, to judge candidates by: evenly chosen, with some of every highlight's images.

Of a smooth surface one image in fifty may show its highlight, and hold nearly all the energy. Drawn without regard to
that, one choice in six judged by no highlight at all. So images that hold most of what shines are drawn by themselves, and
count as many as they stand for.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from torchmat.fitting.training import Training

_SHARE, _FEWEST, _MOST = 0.1, 16, 128  # of the training samples are kept back
_MOST_VALUES = 40_000_000  # of all samples kept back of a surface whose rays are remembered
_LOOKED_AT, _VALUES = 256, 1_000_000  # texels of each image that tell where highlights are, and values read at a time
_BRIGHTEST, _MOSTLY = 0.8, 0.5  # shares of the energy: of all highlights in the brightest images, of an image in its highlights
_BRIGHT = 4  # of those images are kept back, unless they are few
_USUAL, _TIMES, _WHITE = 0.95, 2.0, 1.0
_ENERGY = 0.02  # of all values: what highlights hold less is noise, or does not matter


class KeptBack(NamedTuple):
    """Samples `rows` [n], ascending, how much each of them counts [n], 1 on average, and from where on a value is a highlight.

    `highlights_from` is None where the images show none.
    """

    rows: Tensor
    weight: Tensor
    highlights_from: float | None


def keep_back(training: Training) -> KeptBack:
    """Return the samples that are kept back: evenly from frontal to grazing ones, by the seed, and some that shine.

    Grazing samples are the hard ones; drawn without regard to that, few samples would say little of all.
    """
    btf = training.btf
    rows = training.used.nonzero()[:, 0]
    bound, shines = _shining(training, rows)
    if len(rows) < 2:
        return KeptBack(rows, torch.ones(len(rows)), bound)
    count = min(_MOST, max(_FEWEST, round(_SHARE * len(rows))), max(1, len(rows) // 5))
    most = max(_FEWEST, _MOST_VALUES // (3 * btf.height * btf.width))
    count = min(count, most)
    bright, others = rows[shines], rows[~shines]
    few = max(round(count * len(bright) / len(rows)), min(_BRIGHT, len(bright) // 2, count // 2))
    few = max(few, count - len(others))
    generator = torch.Generator().manual_seed(training.seed)
    found = [_evenly(training, some, number, generator) for some, number in ((others, count - few), (bright, few))]
    weight = torch.cat([torch.full((len(one),), len(some) / max(1, len(one))) for one, some in zip(found, (others, bright), strict=True)])
    chosen, order = torch.cat(found).sort()
    return KeptBack(chosen, weight[order] / weight.mean(), bound)


def _evenly(training: Training, rows: Tensor, count: int, generator: torch.Generator) -> Tensor:
    """Return `count` of the rows, one from each of as many parts between the most frontal and the most grazing."""
    if count == 0:
        return rows[:0]
    btf = training.btf
    grazing = (btf.light[rows, 2] * btf.view[rows, 2]).double()
    order = rows[grazing.argsort(stable=True)]
    ends = torch.linspace(0, len(order), count + 1).round().long()
    place = torch.rand(count, generator=generator, dtype=torch.float64)
    return order[ends[:-1] + (place * (ends[1:] - ends[:-1])).long()]


def _shining(training: Training, rows: Tensor) -> tuple[float | None, Tensor]:
    """Return the value from which on something is a highlight, and which `rows` show little else or most of what is, bool [n]."""
    btf = training.btf
    step = max(1, round(math.sqrt(btf.height * btf.width / _LOOKED_AT)))
    few = btf if step == 1 else btf.window(0, 0, btf.height, btf.width, step | 1)
    brightest, valid = [], []
    for part in rows.split(max(1, _VALUES // (3 * few.height * few.width))):
        brightest.append(few.images(part).amax(dim=1, keepdim=True))
        valid.append(few.valid(part))
    values, seen = torch.cat(brightest), torch.cat(valid)
    bound = highlights_from(values, seen)
    if bound is None:
        return None, torch.zeros(len(rows), dtype=torch.bool)
    shine = torch.where(seen & (values >= bound), values, torch.zeros(()))
    energy, every = (one.double().square().sum(dim=(1, 2, 3)) for one in (shine, torch.where(seen, values, torch.zeros(()))))
    order = energy.argsort(descending=True, stable=True)
    before = energy[order].cumsum(0) - energy[order]
    shines = energy > _MOSTLY * every
    shines[order[before < _BRIGHTEST * energy.sum()]] = True
    return bound, shines


def highlights_from(images: Tensor, valid: Tensor) -> float | None:
    """Return the value from which on a channel of `images` [k, c, H, W] is a highlight; None where there is none.

    It is twice what 95 % of the texels stay below in their brightest channel, or white, above which no matte surface
    comes and a display shows nothing; what is above must hold 2 % of the energy.
    """
    brightest = images.amax(dim=-3)[valid.all(dim=-3)].flatten()
    if not len(brightest):
        return None
    usual = float(brightest.kthvalue(max(1, math.ceil(_USUAL * len(brightest)))).values)
    bound = min(_WHITE, _TIMES * usual)
    energy = brightest.double().square()
    share = float(energy[brightest >= bound].sum()) / max(float(energy.sum()), 1e-300)
    return bound if bound > 0 and share >= _ENERGY else None
