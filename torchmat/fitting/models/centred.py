"""Images of near lights and cameras brought to the directions at the centre, for fits that need one direction an image.

A texel's own value is kept, and changed by what a smooth function of direction that is fitted to the texel says of the way from
its direction to that of the centre. What is smooth in a texel is then right; how a highlight sharper than that moves is not.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch

from torchmat.btf import Btf
from torchmat.btf.decode import Decoder
from torchmat.btf.store import CLIPPED, INVALID, summarise
from torchmat.fitting.models.by_texel import fit_texels
from torchmat.fitting.relief.surface import space_for
from torchmat.fitting.training import Fitted, Training
from torchmat.models.base import combine
from torchmat.models.bases import BASES

_RIDGE = 1e-3  # samples that lie close together must not decide what is far from them
_SAMPLES = 2  # for each term at least: else a smoother function
_OF_VIEWS, _OF_LIGHTS = ("quadratic", "half_light", "polynomial"), ("hsh9", "polynomial")


def centred(training: Training) -> tuple[Training, str]:
    """Return the training with images as they would be under the directions at the centre, and in words how that was told."""
    btf, name = training.btf, _basis_for(training)
    terms, evaluate = BASES[name]
    coefficients = fit_texels(training, len(terms), evaluate, _RIDGE).fit.coefficients
    pixels = space_for((len(btf), 3, btf.height, btf.width), np.float64 if training.dtype == torch.float64 else np.float32)
    flags = space_for((len(btf), btf.height, btf.width), np.uint8)
    for block in btf.blocks(None, training.dtype, training.progress):
        rows = slice(block.samples.start, block.samples.stop)
        run = torch.arange(rows.start, rows.stop)
        own = combine(evaluate(*btf.directions(run, training.dtype)), coefficients)
        at_centre = combine(evaluate(*(one[run, :, None, None].to(training.dtype) for one in (btf.light, btf.view))), coefficients)
        pixels[rows] = (block.images + at_centre - own).clamp_(min=0).numpy()
        weight = torch.ones(len(run), 1, btf.height, btf.width) if block.weight is None else block.weight
        marks = torch.where(weight <= 0, INVALID, torch.where(weight < 1, CLIPPED, 0))
        flags[rows] = marks[:, 0].to(torch.uint8).numpy()
    decoder = Decoder(pixels.dtype, "linear", 1.0)
    far = Btf(summarise(pixels, flags), btf.light, btf.view, decoder, btf.source, btf.clipped_weight, mask=btf.mask)
    said = f"images were brought to the directions at the centre, by the {name} function of each texel"
    return replace(training, btf=far), said


def _basis_for(training: Training) -> str:
    """Return the richest of some bases for which there are samples enough."""
    count = int(training.used.sum())
    names = _OF_VIEWS if len(training.btf.views) > 1 else _OF_LIGHTS
    return next((name for name in names if count >= _SAMPLES * len(BASES[name].terms)), "cosine")


def fit_centred(fit: Callable[..., Fitted]) -> Callable[..., Fitted]:
    """Return the fit of what is brought to the centre first, where lights or cameras are near; its figures say so."""

    def found(training: Training, **options: object) -> Fitted:
        if training.btf.near is None:
            return fit(training, **options)
        training, said = centred(training)
        fitted = fit(training, **options)
        return replace(fitted, figures={**fitted.figures, "near": said})

    return found
