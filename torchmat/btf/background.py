"""An object told from a dark background: a guess that is made when it is asked for, and suggested where it may help."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from torchmat import colour
from torchmat.btf.btf import Btf
from torchmat.errors import DataError, message

_SOME = 16  # photographs by which a dark border is suggested to be background
_LOOKED_AT = 65536  # texels of each
_DARK, _BORDER = 0.05, 0.5  # of the bright texels' value; of the border's texels
_SPECK = 1e-3  # of the image: smaller pieces beside larger ones are noise of the background
_BINS = 256


def without_background(btf: Btf) -> tuple[np.ndarray, str]:
    """Return what is not background, bool [H, W], and how it was told: what is dark in every image, joined to the border.

    What is dark is told by Otsu's threshold (1979) on the display value of each texel's brightest image. Raises DataError
    where that takes nothing, or all, for background.
    """
    from scipy import ndimage

    brightest = _brightest(btf)
    shown = colour.display((brightest / max(1.0, float(brightest.max()))).expand(3, -1, -1))[0].numpy()
    dark = shown <= otsu(shown)
    labels, _ = ndimage.label(dark)
    rim = np.unique(np.concatenate((labels[0], labels[-1], labels[:, 0], labels[:, -1])))
    mask = ~np.isin(labels, rim[rim > 0])
    if mask.all() or not mask.any():
        fact = "no texel of the border is dark in all photographs" if mask.all() else "all texels are dark"
        step = "Paint a mask, white on the object, and give it: --mask FILE (mask=FILE)."
        raise DataError(message(btf.source.path, "the background", "be told from the object by its darkness", fact, step))
    labels, count = ndimage.label(mask)
    sizes = np.bincount(labels.ravel(), minlength=count + 1)
    sizes[0] = 0
    kept = sizes >= min(_SPECK * mask.size, sizes.max())
    darkest = float(brightest[torch.from_numpy(dark)].max())
    how = f"texels of at most {darkest:.3g} in every photograph, joined to the border by such"
    return kept[labels], f"the mask is a guess: it leaves out {how}. Compare its picture"


def _brightest(btf: Btf) -> Tensor:
    """Return the mean of the channels of each texel's brightest image, [H, W]."""
    found = torch.zeros(btf.height, btf.width)
    for block in btf.blocks():
        found = torch.maximum(found, block.images.mean(dim=1).amax(dim=0))
    return found


def otsu(values: np.ndarray) -> float:
    """Return the threshold that parts values into two classes of least spread (Otsu 1979); the lower class includes it."""
    counts, edges = np.histogram(values, bins=_BINS)
    below, total = np.cumsum(counts).astype(float), np.cumsum(counts * (edges[:-1] + edges[1:]) / 2)
    between = (total * below[-1] - total[-1] * below) ** 2 / np.maximum(below * (below[-1] - below), 1)
    best = np.flatnonzero(between >= between.max() * (1 - 1e-12))
    return float(edges[best[len(best) // 2] + 1])  # in an empty gap all thresholds do alike: its middle


def dark_border(btf: Btf) -> str | None:
    """Return a line that suggests a mask where most of the border is dark in all photographs of one view, else None."""
    if len(btf.views) > 1 or min(btf.height, btf.width) < 3:
        return None
    step = max(1, int((btf.height * btf.width / _LOOKED_AT) ** 0.5))
    small = btf.window(0, 0, btf.height, btf.width, step)
    rows = torch.linspace(0, len(btf) - 1, min(len(btf), _SOME)).round().long().unique()
    brightest = small.images(rows).mean(dim=1).amax(dim=0)
    bright = brightest.flatten().sort().values[int(0.9 * (brightest.numel() - 1))]
    rim = torch.cat((brightest[0], brightest[-1], brightest[1:-1, 0], brightest[1:-1, -1]))
    share = float((rim < _DARK * bright).double().mean())
    if share < _BORDER:
        return None
    return (
        f"{100 * share:.0f} % of the border is dark in all photographs: if that is no part of the object, leave it out with "
        "--mask background (mask=\"background\") or a mask of your own"
    )


