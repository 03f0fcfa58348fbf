"""What an artist does to a picture to make maps of it: brightness and contrast, segments of one colour, directions.

Liao 2011, section 3.3. Directions that turn the specular lookup are unit vectors [2, H, W], cosine and sine of an
angle from +x (right) toward +y (up); as a picture an angle is a hue.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from torchmat import colour, safe
from torchmat.errors import RangeError, ShapeError, check_finite, message
from torchmat.geometry.rays import texel_centres
from torchmat.models.hue import directions_of, hue_of, is_grey

_MOST_COLOURS = 20_000  # texels that k-means sees: more do not move its centres
_STARTS = 4
_LEAST_SOFTNESS = 0.01  # far below what an eye tells apart; smaller ones divide by nothing


def check_picture(where: str, picture: Tensor) -> None:
    """Raise ShapeError or RangeError unless `picture` is [3, H, W], floating-point, finite and nowhere negative."""
    if picture.ndim != 3 or picture.shape[0] != 3 or 0 in picture.shape:
        raise ShapeError(message(where, "the picture", "be [3, H, W]", f"it is {tuple(picture.shape)}"))
    if not picture.is_floating_point():
        step = "Decode it to linear values first."
        raise RangeError(message(where, "the picture", "be floating-point", f"it is {picture.dtype}", step))
    check_finite(where, "the picture", picture)
    negative = picture < 0
    if bool(negative.any()):
        fact = f"{int(negative.sum())} of {picture.numel()} values are, the least is {float(picture.min()):.6g}"
        raise RangeError(message(where, "the picture", "not be negative", fact, "It holds linear light."))


def brightness_contrast(grey: Tensor, brightness: float = 0.0, contrast: float = 1.0) -> Tensor:
    """Return `grey` with its contrast changed about 0.5 and `brightness` added, clamped to [0, 1].

    As paint programs have it (kornia's contrast turns about 0 or about the mean, so black would not stay where it is
    put). 0 and 1 leave values in [0, 1] exactly as they are; `contrast` 0 leaves one grey, negative inverts.
    """
    for name, value in (("brightness", brightness), ("contrast", contrast)):
        if not math.isfinite(value):
            raise RangeError(message("brightness_contrast", name, "be finite", f"it is {value}"))
    check_finite("brightness_contrast", "grey", grey)
    return (grey * contrast + (0.5 * (1 - contrast) + brightness)).clamp(0, 1)


def darkened(picture: Tensor, darken: float = 0.2) -> Tensor:
    """Return linear `picture` less the share `darken` of its light, 0 to 1: what its highlights account for."""
    check_picture("darkened", picture)
    if not 0 <= darken <= 1:
        raise RangeError(message("darkened", "darken", "lie in [0, 1]", f"it is {darken}", "0 keeps the picture."))
    return picture * (1 - darken)


def segments(picture: Tensor, count: int, *, softness: float = 0.0, seed: int = 0) -> Tensor:
    """Return weights [count, H, W] in [0, 1], summing to 1, of the `count` colours that linear `picture` consists of.

    k-means in CIE Lab, colours from dark to light. With `softness` 0 each texel belongs to the nearest colour alone,
    else to all: their weights fall off as a Gaussian with `softness` Lab units (colour differences) for its deviation.
    Raises RangeError when the picture has fewer colours than that.
    """
    check_picture("segments", picture)
    if not isinstance(count, int) or isinstance(count, bool) or count < 1:
        raise RangeError(message("segments", "count", "be a whole number from 1", f"it is {count!r}"))
    if softness != 0 and not _LEAST_SOFTNESS <= softness < math.inf:
        fact = f"it is {softness}"
        raise RangeError(message("segments", "softness", f"be 0, or finite and from {_LEAST_SOFTNESS} Lab units", fact))
    lab = colour.srgb_to_lab(colour.display(picture.detach().double())).flatten(1).T.contiguous()
    centres = _centres(lab, count, seed)
    squared = torch.cdist(lab, centres, compute_mode="donot_use_mm_for_euclid_dist") ** 2
    if softness > 0:
        weight = torch.softmax(-squared / (2 * softness**2), dim=1)
    else:
        weight = torch.nn.functional.one_hot(squared.argmin(dim=1), count)
    return weight.T.reshape(count, *picture.shape[1:]).to(picture.dtype).contiguous()


def _centres(lab: Tensor, count: int, seed: int) -> Tensor:
    """Return `count` colours [count, 3] that stand for texels [n, 3], from dark to light."""
    from sklearn.cluster import KMeans
    from threadpoolctl import threadpool_limits  # comes with scikit-learn

    sample = lab[:: max(1, len(lab) // _MOST_COLOURS)]
    # Rounded, because the same colour may leave the conversion with other last bits.
    distinct = len(torch.unique((sample * 1e3).round(), dim=0))
    if distinct < count:
        step = "Ask for fewer specular maps, or give a picture with more colours."
        requirement = f"be at most the {distinct} colours there are"
        raise RangeError(message("segments", "count", requirement, f"it is {count}", step))
    # Threads of k-means add their sums in the order in which they finish.
    with threadpool_limits(1, user_api="openmp"):
        found = KMeans(count, n_init=_STARTS, random_state=seed).fit(sample.numpy()).cluster_centers_
    centres = torch.from_numpy(found).to(lab.dtype)
    return centres[centres[:, 0].argsort()]


def draw_360(size: tuple[int, int], centres: Sequence[Sequence[float]]) -> Tensor:
    """Return directions [2, H, W] that run round: each texel's is the azimuth of its place about the nearest centre.

    `centres` are texture coordinates (u, v): u to the right and v up, 0..1 across the texture, outside it too. At a
    centre itself the direction is +x.
    """
    height, width = size
    points = torch.tensor([[float(number) for number in centre] for centre in centres], dtype=torch.float64)
    if points.ndim != 2 or points.shape[1] != 2 or not bool(points.isfinite().all()):
        fact = f"they are {[tuple(centre) for centre in centres]}"
        raise RangeError(message("draw_360", "centres", "be one or more pairs of finite u and v", fact))
    # In texels, so that a circle is one on textures that are not square.
    texels = torch.tensor([width, height], dtype=torch.float64)[:, None, None]
    away = (texel_centres(height, width, torch.float64) - points[:, :, None, None]) * texels
    nearest = (away**2).sum(dim=1).argmin(dim=0)
    chosen = away.gather(0, nearest.expand(1, 2, height, width))[0]
    direction = safe.normalise(chosen)
    at_centre = (direction == 0).all(dim=0)
    direction[0, at_centre] = 1
    return direction.float()


def constant_rotation(size: tuple[int, int], angle: float) -> Tensor:
    """Return one direction everywhere, [2, H, W]: `angle` in radians from +x toward +y."""
    if not math.isfinite(angle):
        raise RangeError(message("constant_rotation", "angle", "be finite", f"it is {angle}"))
    direction = torch.tensor([math.cos(angle), math.sin(angle)])
    return direction[:, None, None].expand(2, *size).contiguous()


def rotation_to_hue(rotation: Tensor) -> Tensor:
    """Return directions [2, H, W] as a picture [3, H, W] of sRGB values: the angle is the hue, +x is red.

    Saturation and value are full (Liao 2011, fig. 3.19). Vectors of any length but 0 will do.
    """
    if rotation.ndim != 3 or rotation.shape[0] != 2:
        raise ShapeError(message("rotation_to_hue", "rotation", "be [2, H, W]", f"it is {tuple(rotation.shape)}"))
    check_finite("rotation_to_hue", "rotation", rotation)
    return hue_of(rotation)


def hue_to_rotation(picture: Tensor) -> Tensor:
    """Return the directions [2, H, W], unit vectors, that the hues of a picture [3, H, W] of sRGB values stand for.

    Saturation and value do not matter, but a grey texel has no hue: RangeError says how many there are.
    """
    check_picture("hue_to_rotation", picture)
    grey = is_grey(picture)
    if bool(grey.any()):
        fact = f"{int(grey.sum())} of {grey.numel()} texels are grey, first at {tuple(grey.nonzero()[0].tolist())}"
        step = "Paint them in a colour: red is to the right, its hue turns toward up."
        raise RangeError(message("hue_to_rotation", "the picture", "have a hue everywhere", fact, step))
    return directions_of(picture)
