"""Normals from photographs of one view under several known lights, robust to shadow and highlight."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchmat import safe
from torchmat.errors import DataError, RangeError, ShapeError, check_finite, check_unit, message

_ROUNDS = 10
_DARKEST, _BRIGHTEST = 0.25, 0.9  # ranks outside are shadow or highlight until the first fit says otherwise
_WIDTH = 2.0  # residuals beyond so many spreads do not count
_LEAST_SPREAD = 0.01  # of the albedo: camera noise and interreflection, below which nothing is an outlier
_TEXELS = 65536  # at a time, to bound memory


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


def photometric_stereo(images: Tensor, light: Tensor, weight: Tensor | None = None) -> Stereo:
    """Return normals and albedo of images [n, 3, H, W] (linear, one view) under distant `light` [n, 3] (unit).

    Lambert's law by iteratively reweighted least squares on the mean of the channels, starting without each texel's
    darkest quarter and brightest tenth; Tukey's weights then decide what is shadow or highlight. `weight` [n, 1, H, W]
    in [0, 1] marks samples to leave out. Woodham 1980; the reweighting follows Holland and Welsch 1977.
    """
    where = "photometric_stereo"
    if images.ndim != 4 or images.shape[1] != 3 or 0 in images.shape:
        raise ShapeError(message(where, "images", "be [n, 3, H, W]", f"they are {tuple(images.shape)}"))
    check_finite(where, "images", images, "Give those samples weight 0.")
    check_lights(where, light, len(images))
    height, width = images.shape[-2:]
    grey, light = images.mean(dim=1).flatten(1).double(), light.double()
    given = torch.ones_like(grey) if weight is None else weight.reshape(grey.shape).double()
    parts = [_solve(grey[:, part], light, given[:, part]) for part in torch.arange(grey.shape[1]).split(_TEXELS)]
    normal, kept, confidence = (torch.cat(pieces, dim=-1) for pieces in zip(*parts, strict=True))
    shading = (light @ normal).clamp(min=0)
    share = safe.divide(kept * shading, (kept * shading * shading).sum(dim=0, keepdim=True))
    albedo = torch.einsum("nt,nct->ct", share, images.flatten(2).double()).clamp(min=0)
    size = (height, width)
    dtype = images.dtype
    return Stereo(
        normal.to(dtype).unflatten(1, size), albedo.to(dtype).unflatten(1, size), confidence.to(dtype).reshape(1, *size)
    )


def _solve(grey: Tensor, light: Tensor, given: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return normal [3, t], final weights [n, t] and confidence [1, t] for grey values [n, t]."""
    count = len(grey)
    products = (light[:, :, None] * light[:, None, :]).flatten(1)  # [n, 9]
    rank = grey.argsort(dim=0).argsort(dim=0).double() / max(count - 1, 1)
    weight = given * ((rank >= _DARKEST) & (rank <= _BRIGHTEST)) if count > 5 else given.clone()
    full = torch.linalg.eigvalsh((light.T @ light))[0]
    scaled = torch.zeros(3, grey.shape[1], dtype=torch.float64)
    for _ in range(_ROUNDS):
        scaled = _normal_equations(weight, light, products, grey)
        predicted = light @ scaled
        residual = grey - predicted
        brightness = (scaled * scaled).sum(dim=0).sqrt()  # norm(dim=0) takes ten times as long
        spread = (1.4826 * residual.abs().median(dim=0).values).clamp(min=_LEAST_SPREAD * brightness + 1e-12)
        share = residual / (_WIDTH * spread)
        # A trace of weight stays, so that texels that are mostly shadow keep a solution.
        weight = given * (predicted > 0) * ((1 - share * share).clamp(min=0) ** 2 + 1e-4)
    information = torch.einsum("nt,nk->tk", weight, products).unflatten(1, (3, 3))
    confidence = (torch.linalg.eigvalsh(information)[:, 0] / full).clamp(0, 1)
    lit = ((scaled * scaled).sum(dim=0) > 1e-18) & (scaled[2] > 0)
    up = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)[:, None]
    normal = torch.where(lit, safe.normalise(scaled, dim=0), up)
    return normal, weight, torch.where(lit, confidence, torch.zeros_like(confidence))[None]


def _normal_equations(weight: Tensor, light: Tensor, products: Tensor, grey: Tensor) -> Tensor:
    left = torch.einsum("nt,nk->tk", weight, products).unflatten(1, (3, 3))
    left = left + 1e-9 * torch.eye(3, dtype=torch.float64)
    right = torch.einsum("nt,ni->ti", weight * grey, light)
    return torch.linalg.solve(left, right).T


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
