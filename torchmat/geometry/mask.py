"""Object masks on a grid of texels: what belongs together, its border, and levels of its own for each piece."""

from __future__ import annotations

import torch
from torch import Tensor

from torchmat.errors import RangeError, ShapeError, message


def check_mask(where: str, mask: Tensor, size: tuple[int, int]) -> Tensor | None:
    """Return an object mask as bool [H, W], None where it leaves no texel out.

    `mask` is bool [H, W] or [1, H, W], true on the object. Raises ShapeError for another size, which names both, RangeError
    for what is not bool, or true nowhere.
    """
    if tuple(mask.shape) not in (size, (1, *size)):
        step = "Bring it to the images' size without blurring it, texel by texel."
        raise ShapeError(message(where, "mask", f"be [{size[0]}, {size[1]}] as the images are", f"it is {list(mask.shape)}", step))
    if mask.dtype != torch.bool:
        raise RangeError(message(where, "mask", "be bool", f"it is {mask.dtype}", "Compare it with a threshold first."))
    if not bool(mask.any()):
        raise RangeError(message(where, "mask", "be true somewhere", "it is false on all texels", "True is the object."))
    return None if bool(mask.all()) else mask.reshape(size)


def neighbours(inside: Tensor, tiles: bool) -> tuple[Tensor, Tensor]:
    """Return where a texel and its right, and its upper, neighbour are both inside, bool [H, W]; they wrap if it tiles."""
    right, up = inside & inside.roll(-1, 1), inside & inside.roll(1, 0)
    if not tiles:
        right[:, -1], up[0, :] = False, False
    return right, up


def pieces(inside: Tensor, tiles: bool) -> Tensor:
    """Return which piece each texel inside belongs to, numbers [t] from 0 in their order; a corner joins nothing."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    number = torch.full(inside.shape, -1, dtype=torch.long)
    count = int(inside.sum())
    number[inside] = torch.arange(count)
    right, up = neighbours(inside, tiles)
    first = torch.cat((number[right], number[up])).numpy()
    second = torch.cat((number.roll(-1, 1)[right], number.roll(1, 0)[up])).numpy()
    graph = coo_array(([1] * len(first), (first, second)), shape=(count, count))
    return torch.from_numpy(connected_components(graph, directed=False)[1]).long()


def piece_means(values: Tensor, piece: Tensor, weight: Tensor | None = None) -> Tensor:
    """Return the mean of values [t] over the piece of each, [t], each counting its `weight` [t]; 0 where a piece has none."""
    weight = torch.ones_like(values) if weight is None else weight
    total = torch.bincount(piece, weight).clamp(min=torch.finfo(values.dtype).tiny)
    return (torch.bincount(piece, weight * values) / total)[piece]


def border(inside: Tensor, tiles: bool) -> Tensor:
    """Return which texels inside stand beside one that is not, bool [H, W]."""
    shrunk = inside.clone()
    for shift, dimension in ((1, 0), (-1, 0), (1, 1), (-1, 1)):
        beside = inside.roll(shift, dimension)
        if not tiles:
            beside.select(dimension, 0 if shift == 1 else -1).fill_(True)
        shrunk &= beside
    return inside & ~shrunk


def flat_outside(height: Tensor, inside: Tensor, tiles: bool) -> Tensor:
    """Return a height [H, W] that outside of the object is flat, at the lowest height of the object's border.

    So nothing outside stands between the object and a light, and the object alone says what the heights span.
    """
    return torch.where(inside, height, height[border(inside, tiles)].min())
