"""uncertainty: standard errors of the maps of a material, from the samples that it was fitted to."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from torchmat.btf import Btf
from torchmat.errors import ShapeError, message
from torchmat.fitting.certainty.information import covariance_of, noise_of
from torchmat.fitting.certainty.jacobian import Jacobian, jacobian_of
from torchmat.fitting.certainty.observed import Observed, observe
from torchmat.fitting.objective import Residual
from torchmat.fitting.recipe import RECIPES
from torchmat.fitting.training import make_training
from torchmat.models import Material
from torchmat.models.uncertainty import Uncertainty, check_sure
from torchmat.progress import progress as progress_bar

_WORK = 2_000_000  # samples times texels that are looked at
_FEWEST = 64  # photographs, and so many for each number of a texel
_OF_EACH = 6
_STRIP = 24_000_000  # numbers of the covariances of a strip


def uncertainty(
    material: Material, btf: Btf, rows: Sequence[int] | Tensor | None = None, *, objective: str | Residual | None = None,
    progress: bool | None = False,
) -> Uncertainty:
    """Return the standard errors of a material's maps: how far other photographs of the same noise would move them.

    From the derivatives of the residuals after each texel's own numbers (the normal equations of a linear model, the Gauss-Newton
    block of any other) and from what the residuals themselves are. Height and what all texels share count as known, and so does
    the model: what no texel's numbers could follow is noise here. At a bound of a map they say how far the numbers could go.

    Args:
        material: a fitted material, in the size of the images, or a part of them.
        btf: the images that it was fitted to.
        rows: numbers of the samples that were fitted, such as ``result.split.train``; None is all. Of more than 2 million
            samples of texels some photographs are looked at, evenly chosen, and stand for all.
        objective: what the fit made small, None for the model's own way (`fit`).
        progress: whether to show a bar; None shows it on a terminal.

    Raises RangeError for a model whose numbers have no errors of their own, ShapeError for another size.
    """
    material, btf = _checked(material, btf)
    numbers = torch.arange(len(btf)) if rows is None else torch.as_tensor(rows).long()
    training = replace(make_training(btf, numbers, 0, material.tiles, material.dtype, progress), relief=material.relief)
    used = training.used.nonzero()[:, 0]
    ways = sum(spec.channels for spec in material.specs() if spec.per_texel and not spec.constant)
    chosen = _chosen(used, btf.height * btf.width, ways)
    training.used[:] = False
    training.used[chosen] = True
    observed = observe(material, training, objective)
    recipe = RECIPES.get(material.name)
    few = recipe.by_luminance if recipe is not None and objective is None else ()
    return _of(observed, few, len(used), progress)


def _checked(material: Material, btf: Btf) -> tuple[Material, Btf]:
    """Return a material and the images of the texels that it covers; raises where there are no errors to be had."""
    where = "uncertainty"
    check_sure(where, material)
    part = material.cutout
    if part is not None and (btf.height, btf.width) == (part.whole_height, part.whole_width):
        btf = btf.window(part.top, part.left, part.height, part.width)
    if material.size != (btf.height, btf.width):
        fact = f"it is {material.size[0]} x {material.size[1]} and the images {btf.height} x {btf.width}"
        step = "Give the images in the size that was fitted."
        raise ShapeError(message(where, "material", "have the size of the images", fact, step))
    return material, btf


def _chosen(used: Tensor, texels: int, ways: int) -> Tensor:
    most = max(_FEWEST, _OF_EACH * ways, _WORK // texels)
    return used if len(used) <= most else used[torch.linspace(0, len(used) - 1, most).round().long()]


def _of(observed: Observed, few: Sequence[str], whole: int, progress: bool | None) -> Uncertainty:
    """Return the uncertainty of all texels, a strip of rows after the other."""
    height, width = observed.flat.size
    jacobian = jacobian_of(observed)
    rows, every = torch.arange(len(observed.btf)), whole / len(observed.btf)
    deep = max(1, _STRIP // (4 * max(len(jacobian.ways), 1) ** 2 * width))
    names = dict.fromkeys(way.name for way in jacobian.ways)
    error = {name: torch.zeros_like(observed.flat.maps[name]) for name in names}
    freedom = torch.ones(1, height, width, dtype=torch.float64)
    squares, count = torch.zeros(3, dtype=torch.float64), torch.zeros(3, dtype=torch.float64)
    for top in progress_bar(range(0, height, deep), "how certain", show=progress):
        strip = slice(top, min(top + deep, height))
        part, some = observed.strip(strip), jacobian.strip(strip)
        noise = noise_of(part, rows, some, every)
        for numbers, covariance in covariance_of(part, rows, some, noise, every, few):
            for name in names:
                error[name][:, strip] += _variance(name, some, numbers, covariance, part.flat.maps[name])
        freedom[:, strip] = noise.freedom.amin(dim=1).reshape(1, -1, width)
        squares, count = squares + noise.squares, count + noise.count
    sigma = [math.sqrt(one) for one in (squares / count).tolist()]
    inside = observed.btf.mask
    error = {name: one.clamp(min=0).sqrt() if inside is None else one.clamp(min=0).sqrt() * inside for name, one in error.items()}
    span = {way.name: way.span for way in jacobian.ways}
    return Uncertainty(error, freedom.float(), (sigma[0], sigma[1], sigma[2]), observed.space.name, span, (len(rows), whole))


def _variance(name: str, jacobian: Jacobian, numbers: list[int], covariance: Tensor, value: Tensor) -> Tensor:
    """Return the variance [C, h, w] of a map's channels that a block of ways gives them."""
    total = torch.zeros_like(value)
    mine = [place for place, number in enumerate(numbers) if jacobian.ways[number].name == name]
    size = value.shape[-2:]
    for first in mine:
        one = jacobian.ways[numbers[first]]
        if one.single is not None or one.tangent.shape[-2:] == (1, 1) and int((one.tangent != 0).sum()) == 1:
            total += one.tangent.square() * covariance[:, first, first].reshape(size).to(value.dtype)
            continue
        for second in mine:
            other = jacobian.ways[numbers[second]]
            total += one.tangent * other.tangent * covariance[:, first, second].reshape(size).to(value.dtype)
    return total
