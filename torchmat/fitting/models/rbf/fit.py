"""Principal images in one colour, from a randomised SVD of the photographs' channels, and splines through their weights."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from torchmat.errors import check_option
from torchmat.fitting.models.image_matrix import OVERSAMPLING, ImageMatrix, leading, range_finder, require_at_most
from torchmat.fitting.models.linear import encoded
from torchmat.fitting.models.rbf.spline import best_scale, reach_of, smooth
from torchmat.fitting.shared import Shared
from torchmat.fitting.training import Fitted, Training
from torchmat.models.linear import SPACES, SRGB
from torchmat.models.rbf import Rbf, coordinates
from torchmat.repeatable import add_product, product


@dataclass(frozen=True)
class RbfShared(Shared):
    """What texels share besides the tables: the `weights` [3 samples, components] whose products with a texel's values are its own."""

    weights: Tensor | None = None


def fit_rbf(
    training: Training, *, components: int = 18, space: str = SRGB, smoothing: float | Literal["auto"] = "auto", storage: str = "half",
) -> Fitted:
    """Truncated SVD of the matrix whose rows are the red, green and blue of all photographs, and splines through its left vectors.

    Not centred: the first component is about the mean of all.

    Args:
        components: grey textures, at least 1 and at most three times as many as there are images, or as texels.
        space: "srgb" fits the codes of a screen, as RTI tools do: nearer to what is seen; "linear" the light itself: nearer in highlights.
        smoothing: penalty on the bending of the splines as a share of the largest square, 0 to pass through all weights; "auto" takes for each
            spline the one that foretells photographs which are left out best.
    """
    check_option("fit rbf", "space", space, SPACES)
    known = training.shared_as(RbfShared)
    images = ImageMatrix(training, keep=known is None, encode=encoded if space == SRGB else None)
    if known is None or known.weights is None:
        require_at_most("components", components, min(3 * len(images.rows), images.texels))
        known = _shared(training, images, components, None if isinstance(smoothing, str) else smoothing)
    assert known.weights is not None
    component = torch.zeros(components, images.texels, dtype=training.dtype)
    for rows, part in images.runs():
        add_product(component, known.weights.unflatten(0, (-1, 3))[rows].flatten(0, 1), part.flatten(0, 1))
    maps = {"component": component.reshape(-1, training.btf.height, training.btf.width), **known.tables}
    return Fitted(Rbf(maps, components=components, space=space, storage=storage), shared=known)


def _shared(training: Training, images: ImageMatrix, components: int, penalty: float | None) -> RbfShared:
    """Return the weights of the leading components, and the splines through them."""
    rows = 3 * len(images.rows)

    def times(right: Tensor) -> Tensor:
        return torch.cat([product(part.flatten(0, 1), right) for _, part in images.runs()])

    def transposed(left: Tensor) -> Tensor:
        total = torch.zeros(images.texels, left.shape[1], dtype=left.dtype)
        for run, part in images.runs():
            add_product(total, part.flatten(0, 1), left.unflatten(0, (-1, 3))[run].flatten(0, 1))
        return total

    rank = min(components + OVERSAMPLING, rows, images.texels)
    generator = torch.Generator().manual_seed(training.seed)
    found, rest = range_finder(times, transposed, images.texels, rank, generator, training.dtype)
    along = leading(rest, components)
    left, size = product(found, along), product(along.T, rest).square().sum(dim=1).sqrt()
    # Of two vectors that differ in their sign alone, the one whose largest number is positive.
    sign = left.gather(0, left.abs().argmax(dim=0, keepdim=True)).sign()
    left = left * torch.where(sign == 0, torch.ones_like(sign), sign)
    scale = size / images.texels**0.5  # values of components are then about 1
    scale = torch.where(scale > 0, scale, torch.ones_like(scale))
    values = images.plain((left * scale).unflatten(0, (-1, 3))).transpose(1, 2).flatten(1)
    return RbfShared(_tables(training, images, values.double(), penalty), weights=left / scale)


def _tables(training: Training, images: ImageMatrix, values: Tensor, penalty: float | None) -> dict[str, Tensor]:
    """Return the tables of the splines through weights [samples, 3 components]."""
    light, view = (one[images.rows].double() for one in (training.btf.light, training.btf.view))
    root = images.weighed(torch.ones(len(light), 1, dtype=training.dtype)).double()
    scale = best_scale(light, view, values, root, penalty, training.seed)
    spline = smooth(coordinates(light, view, scale), values, root, penalty)
    found = {
        "weight": spline.table.T[:, None], "reach": reach_of(values)[:, None],
        "knots": torch.cat((light, view), dim=1)[spline.knots].clamp(-1, 1).T[:, None],  # of length 1 but for rounding
        "half_scale": scale,
    }
    return {name: table.to(training.dtype).contiguous() for name, table in found.items()}
