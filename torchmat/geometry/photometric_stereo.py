"""Normals from photographs of one view under several known lights, robust to shadow and highlight."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from torchmat import safe
from torchmat.errors import DataError, RangeError, ShapeError, check_finite, check_unit, message
from torchmat.geometry.mask import check_mask

_ROUNDS = 10
_SPREAD_ROUNDS = 4  # then the spread stands: a median costs as much as the rest of a round, and it hardly moves
_DARKEST, _BRIGHTEST = 0.25, 0.9  # ranks outside are shadow or highlight until the first fit says otherwise
_WIDTH = 2.0  # residuals beyond so many spreads do not count
_LEAST_SPREAD = 0.01  # of the albedo: camera noise and interreflection, below which nothing is an outlier
_TEXELS = 65536  # at a time, to bound memory
_NEAR_TEXELS = 16384  # of those that have lights of their own


class Stereo(NamedTuple):
    """Unit `normal` [3, H, W], `albedo` [3, H, W], and `confidence` [1, H, W] in [0, 1].

    The confidence is the smallest share of the lights' information that any direction of the normal kept after
    outliers went; 0 where nothing was measured, and the normal there is +z.
    """

    normal: Tensor
    albedo: Tensor
    confidence: Tensor


def check_lights(where: str, light: Tensor, images: int) -> None:
    """Raise an error unless `light` [n, 3] are n >= 3 unit vectors that do not lie in one plane; say what stays open."""
    if light.shape != (images, 3):
        fact = f"there are {images} images and light is {tuple(light.shape)}"
        raise ShapeError(message(where, "light", "be [image, 3]", fact))
    check_unit(where, "light", light, "Divide each by its length.")
    values, vectors = torch.linalg.eigh(light.double().T @ light.double())
    open_ones = int((values < 1e-4 * values[-1]).sum())
    if images >= 3 and open_ones == 0:
        return
    x, y, z = vectors[:, 0].tolist()
    along = f"({x:.2f}, {y:.2f}, {z:.2f})"
    fact = f"{images} lights span {3 - open_ones} of 3 directions; the normal along {along} stays undetermined"
    step = "Add a photograph whose light is out of the others' plane."
    raise RangeError(message(where, "lights", "be at least 3 and not in one plane", fact, step))


def photometric_stereo(images: Tensor, light: Tensor, weight: Tensor | None = None, mask: Tensor | None = None) -> Stereo:
    """Return normals and albedo of images [n, 3, H, W] (linear, one view) under distant `light` [n, 3] (unit).

    Under near lights `light` is that of each texel, [n, 3, H, W], and the fall-off is taken out of the images.

    Lambert's law by iteratively reweighted least squares on the mean of the channels, starting without each texel's
    darkest quarter and brightest tenth; Tukey's weights then decide what is shadow or highlight. `weight` [n, 1, H, W]
    in [0, 1] marks samples to leave out. Outside of a `mask`, bool [H, W], nothing is looked at: the normal there is +z,
    without albedo or confidence. Woodham 1980; the reweighting follows Holland and Welsch 1977.
    """
    where = "photometric_stereo"
    if images.ndim != 4 or images.shape[1] != 3 or 0 in images.shape:
        raise ShapeError(message(where, "images", "be [n, 3, H, W]", f"they are {tuple(images.shape)}"))
    inside = None if mask is None else check_mask(where, mask, (images.shape[-2], images.shape[-1]))
    if inside is not None:
        return _inside(images, light, weight, inside)
    check_finite(where, "images", images, "Give those samples weight 0.")
    height, width = images.shape[-2:]
    near = light.ndim == 4
    if near and light.shape != images.shape:
        fact = f"images are {tuple(images.shape)} and light is {tuple(light.shape)}"
        raise ShapeError(message(where, "light", "be [image, 3] or that of each texel of each image", fact))
    check_lights(where, light[:, :, height // 2, width // 2] if near else light, len(images))
    if near:
        return _near(images, light, weight)
    grey, light = images.mean(dim=1).flatten(1).T.contiguous(), light.double()
    given = torch.ones_like(grey) if weight is None else weight.reshape(len(images), -1).T.to(grey.dtype).contiguous()
    parts = [_solve(grey[part], light, given[part]) for part in _parts(len(grey))]
    normal = torch.cat([part[0] for part in parts], dim=1)
    kept = torch.cat([part[1] for part in parts]).T
    confidence = torch.cat([part[2] for part in parts])
    shading = (light @ normal).clamp(min=0)
    share = safe.divide(kept * shading, (kept * shading * shading).sum(dim=0, keepdim=True))
    albedo = torch.einsum("nt,nct->ct", share, images.flatten(2).double()).clamp(min=0)
    size = (height, width)
    dtype = images.dtype
    return Stereo(
        normal.to(dtype).unflatten(1, size), albedo.to(dtype).unflatten(1, size), confidence.to(dtype).reshape(1, *size)
    )


def _near(images: Tensor, light: Tensor, weight: Tensor | None) -> Stereo:
    """Return what `photometric_stereo` finds where each texel has lights of its own, [n, 3, H, W]."""
    grey, planes = images.mean(dim=1).flatten(1).T.contiguous(), light.flatten(2).permute(2, 0, 1)
    given = torch.ones_like(grey) if weight is None else weight.reshape(len(images), -1).T.to(grey.dtype).contiguous()
    normals, albedos, confidences = [], [], []
    for first in range(0, len(grey), _NEAR_TEXELS):
        part = slice(first, first + _NEAR_TEXELS)
        own = planes[part].double().contiguous()
        normal, kept, confidence = _solve(grey[part], own, given[part])
        shading = _along(own, normal).clamp(min=0)
        share = safe.divide(kept * shading, (kept * shading * shading).sum(dim=1, keepdim=True)).T
        albedos.append((share[:, None] * images.flatten(2)[:, :, part].double()).sum(dim=0).clamp(min=0))
        normals.append(normal)
        confidences.append(confidence[None])
    found = (torch.cat(maps, dim=1).to(images.dtype) for maps in (normals, albedos, confidences))
    return Stereo(*(maps.unflatten(1, images.shape[-2:]) for maps in found))


def _inside(images: Tensor, light: Tensor, weight: Tensor | None, inside: Tensor) -> Stereo:
    """Return what `photometric_stereo` finds of the texels inside a mask, bool [H, W], put in their places."""
    weight = None if weight is None else weight.reshape(len(images), 1, *inside.shape)[:, :, inside][:, :, None]
    light = light[:, :, inside][:, :, None] if light.ndim == 4 else light
    found = photometric_stereo(images[:, :, inside][:, :, None], light, weight)
    normal, albedo, confidence = (values.new_zeros(len(values), *inside.shape) for values in found)
    normal[2] = 1
    for whole, values in zip((normal, albedo, confidence), found, strict=True):
        whole[:, inside] = values[:, 0]
    return Stereo(normal, albedo, confidence)


def _parts(texels: int) -> list[slice]:
    return [slice(first, first + _TEXELS) for first in range(0, texels, _TEXELS)]


def _solve(grey: Tensor, light: Tensor, given: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return normal [3, t], final weights [t, n] and confidence [t] for grey values and weights [t, n].

    `light` is [n, 3], or [t, n, 3] where each texel has its own.
    Here texels are rows: medians and the choice of texels that still move then run along memory. Weights are found in
    the precision of `grey`; the last solution is in double precision.
    """
    up = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)[:, None]
    weight, light = shading_weights(grey, light.to(grey.dtype), given).double(), light.double()
    scaled = _solve_symmetric(_information(weight, light), _summed(weight * grey, light))
    full = _least_eigenvalue(_information(torch.ones(1, grey.shape[1], dtype=torch.float64), light))
    confidence = (_least_eigenvalue(_information(weight, light)) / full).clamp(0, 1)
    lit = (scaled.square().sum(dim=0) > 1e-18) & (scaled[2] > 0)
    normal = torch.where(lit, safe.normalise(scaled, dim=0), up)
    return normal, weight, torch.where(lit, confidence, torch.zeros_like(confidence))


def shading_weights(grey: Tensor, light: Tensor, given: Tensor) -> Tensor:
    """Return weights [t, n] that leave out shadow and highlight, by iteration from ranks, of values and given weights [t, n].

    `light` is [n, 3], or [t, n, 3] where each texel has its own.
    """
    count = grey.shape[1]
    rank = grey.argsort(dim=1).argsort(dim=1).to(grey.dtype) / max(count - 1, 1)
    weight = given * ((rank >= _DARKEST) & (rank <= _BRIGHTEST)) if count > 5 else given.clone()
    spread = torch.zeros(len(grey), dtype=grey.dtype)
    for turn in range(_ROUNDS):
        scaled = _solve_symmetric(_information(weight, light), _summed(weight * grey, light))
        predicted = _along(light, scaled)
        residual = grey - predicted
        if turn < _SPREAD_ROUNDS:
            brightness = scaled.square().sum(dim=0).sqrt()
            spread = 1.4826 * residual.abs().median(dim=1).values
            spread = spread.clamp(min=1e-12).maximum(_LEAST_SPREAD * brightness)
        share = residual.mul_((1 / (_WIDTH * spread))[:, None])
        # A trace of weight stays, so that texels that are mostly shadow keep a solution.
        weight = (1 - share.square_()).clamp_(min=0).square_().add_(1e-4).mul_(predicted > 0).mul_(given)
    return weight


def _summed(values: Tensor, light: Tensor) -> Tensor:
    """Return the sums over n of values [t, n] times light [n, 3] or [t, n, 3], as planes [3, t]."""
    if light.ndim == 3:
        return torch.stack([(values * axis).sum(dim=1) for axis in light.unbind(2)])
    return (values @ light).T.contiguous()


def _along(light: Tensor, vector: Tensor) -> Tensor:
    """Return the products [t, n] of vectors [3, t] with light [n, 3] or [t, n, 3]."""
    if light.ndim == 3:
        return (light * vector.T[:, None]).sum(dim=2)
    return vector.T @ light.T


def _information(weight: Tensor, light: Tensor) -> Tensor:
    """Return the sums over n of weight [t, n] times light light^T as planes [6, t]: xx, xy, xz, yy, yz, zz."""
    if light.ndim == 3:
        x, y, z = light.unbind(2)
        return torch.stack([(weight * pair).sum(dim=1) for pair in (x * x, x * y, x * z, y * y, y * z, z * z)])
    x, y, z = light.T
    return (weight @ torch.stack((x * x, x * y, x * z, y * y, y * z, z * z), dim=1)).T.contiguous()


def _solve_symmetric(matrix: Tensor, right: Tensor) -> Tensor:
    """Solve symmetric 3 x 3 systems held as planes, matrix [6, t] and right-hand sides [3, t], by Cramer's rule.

    A batch of library solves takes ten times as long; double precision covers the conditions that lights allow.
    """
    a, b, c, d, e, f = matrix
    a, d, f = a + 1e-9, d + 1e-9, f + 1e-9
    aa, ab, ac = d * f - e * e, c * e - b * f, b * e - c * d
    bb, bc, cc = a * f - c * c, b * c - a * e, a * d - b * b
    rows = (torch.stack((aa, ab, ac)), torch.stack((ab, bb, bc)), torch.stack((ac, bc, cc)))
    determinant = a * aa + b * ab + c * ac
    return torch.stack([safe.divide((row * right).sum(dim=0), determinant) for row in rows])


def _least_eigenvalue(matrix: Tensor) -> Tensor:
    """Return the smallest eigenvalue [t] of symmetric 3 x 3 matrices held as planes [6, t] (Smith 1961)."""
    a, b, c, d, e, f = matrix
    mean = (a + d + f) / 3
    a, d, f = a - mean, d - mean, f - mean
    size = safe.sqrt((a * a + d * d + f * f + 2 * (b * b + c * c + e * e)) / 6)
    determinant = a * (d * f - e * e) - b * (b * f - c * e) + c * (b * e - c * d)
    angle = safe.acos(safe.divide(determinant, 2 * size**3)) / 3
    return mean + 2 * size * torch.cos(angle + 2 * math.pi / 3)


def lights_from_ball(highlight: Tensor, centre: tuple[float, float], radius: float) -> Tensor:
    """Return light directions [n, 3] from where a chrome ball shows each light.

    `highlight` [n, 2] are (column, row) in pixels, rows downward; `centre` and `radius` the ball's circle in the same
    pixels. The camera looks along -z from far away; the light is its view mirrored at the ball's normal.
    """
    if not radius > 0:
        raise RangeError(message("lights_from_ball", "radius", "be positive", f"it is {radius}"))
    offset = (highlight.double() - torch.tensor(centre, dtype=torch.float64)) / radius
    outside = offset.norm(dim=1) >= 1
    if bool(outside.any()):
        first = int(outside.nonzero()[0, 0])
        fact = f"{int(outside.sum())} of {len(outside)} do not, first is number {first}"
        step = "Check the circle's centre and radius."
        raise RangeError(message("lights_from_ball", "highlights", "lie inside the ball's circle", fact, step))
    x, y = offset[:, 0], -offset[:, 1]
    z = torch.sqrt(1 - x * x - y * y)
    normal = torch.stack((x, y, z), dim=1)
    return (2 * z[:, None] * normal - torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)).to(highlight.dtype)


def find_highlight(image: Tensor, centre: tuple[float, float], radius: float) -> Tensor:
    """Return (column, row) of the highlight on a chrome ball in `image` [3, H, W]: the centre of its brightest spot.

    Raises DataError when nothing on the ball is brighter than the rest.
    """
    grey = image.mean(dim=0).double()
    rows, columns = torch.meshgrid(
        torch.arange(grey.shape[0], dtype=torch.float64), torch.arange(grey.shape[1], dtype=torch.float64), indexing="ij"
    )
    inside = (columns - centre[0]) ** 2 + (rows - centre[1]) ** 2 < (0.98 * radius) ** 2
    if not bool(inside.any()):
        fact = f"centre {centre}, radius {radius:g} for {grey.shape[0]} x {grey.shape[1]}"
        raise DataError(message("find_highlight", "the circle", "lie inside the image", fact))
    grey = torch.where(inside, grey, torch.zeros_like(grey))
    level = 0.8 * grey.max()
    if float(level) <= float(grey[inside].median()):
        fact = "nothing on the ball stands out"
        raise DataError(message("find_highlight", "the ball", "show one highlight", fact, "Check the circle and exposure."))
    weight = (grey - level).clamp(min=0)
    total = weight.sum()
    return torch.stack(((columns * weight).sum() / total, (rows * weight).sum() / total))
