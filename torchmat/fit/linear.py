"""Fits of the baselines of `models.linear`, in closed form."""

from __future__ import annotations

import torch
from torch import Tensor

from torchmat import colour, safe
from torchmat.errors import check_option
from torchmat.fit.least_squares import Design, LinearFit, Moments, make_design, solve_texels, stream_moments
from torchmat.fit.repeatable import product
from torchmat.fit.training import Fitted, Training
from torchmat.models import Hsh, Lambert, Lptm, Ptm, Texture
from torchmat.models.bases import BASES
from torchmat.models.linear import HSH_TERMS



def design_of(training: Training, basis: str, ridge: float = 0.0) -> Design:
    """Return the design matrix that `basis` makes of the training directions."""
    light, view = training.light.double(), training.view.double()
    matrix = BASES[basis].evaluate(light, view)[:, :, 0, 0]
    return make_design(matrix, training.used, ridge)


def _solve(training: Training, basis: str) -> tuple[Design, Moments, LinearFit]:
    design = design_of(training, basis)
    moments = stream_moments(training.btf, design, training.used, training.dtype, training.progress)
    return design, moments, solve_texels(training.btf, design, moments, training.used)


def fit_texture(training: Training, *, storage: str = "half") -> Fitted:
    """Least-squares colour per texel for value = colour * cos(light)."""
    _, _, solved = _solve(training, "cosine")
    albedo = solved.coefficients[0].clamp(min=0)  # the non-negative minimum of one unknown is the clamped one
    return Fitted(Texture({"albedo": albedo}, storage=storage), coverage=solved.coverage)


def fit_ptm(training: Training, *, storage: str = "half") -> Fitted:
    """Least-squares biquadratic per texel and channel."""
    _, _, solved = _solve(training, "polynomial")
    return Fitted(Ptm({"polynomial": solved.coefficients.flatten(0, 1)}, storage=storage), coverage=solved.coverage)


def fit_hsh(training: Training, *, terms: int = 9, storage: str = "half") -> Fitted:
    """Least-squares hemispherical harmonics per texel and channel."""
    check_option("fit hsh", "terms", terms, HSH_TERMS)
    _, _, solved = _solve(training, f"hsh{terms}")
    maps = {"harmonic": solved.coefficients.flatten(0, 1)}
    return Fitted(Hsh(maps, terms=terms, storage=storage), coverage=solved.coverage)


def fit_lptm(training: Training, *, storage: str = "half") -> Fitted:
    """Biquadratic of luminance per texel; colour = summed colour over summed luminance (Malzbender et al. 2001).

    The sum over samples is the product with the design's constant column, so one pass gives both.
    """
    design, moments, solved = _solve(training, "polynomial")
    luminance = colour.luminance(solved.coefficients, dim=1)
    ones = product(design.basis.T, training.used.double()).to(training.dtype)
    total = torch.einsum("r,rchw->chw", ones, moments.product).clamp(min=0)
    brightness = colour.luminance(total)
    grey = torch.ones_like(total)
    chroma = torch.where(brightness > 0, safe.divide(total, brightness), grey)
    maps = {"chroma": chroma, "luminance": luminance}
    return Fitted(Lptm(maps, storage=storage), coverage=solved.coverage)


def fit_lambert(training: Training, *, storage: str = "half") -> Fitted:
    """Normal from the least-squares gradient of luminance over the light, then the albedo for that normal.

    Woodham 1980 over all samples, without rejecting shadows or highlights: the plain baseline.
    """
    btf, used, dtype = training.btf, training.used, training.dtype
    design = make_design(btf.light.double(), used)
    moments = stream_moments(btf, design, used, dtype, training.progress)
    solved = solve_texels(btf, design, moments, used)
    normal = safe.normalise(colour.luminance(solved.coefficients, dim=1))
    up = torch.zeros(3, 1, 1, dtype=dtype)
    up[2] = 1
    # A black texel, or one whose samples contradict each other, has no normal: it gets the surface's.
    normal = torch.where((normal[2:] > 0), normal, up)
    albedo = _albedo(training, normal).clamp(min=0)
    return Fitted(Lambert({"albedo": albedo, "normal": normal}, storage=storage), coverage=solved.coverage)


def _albedo(training: Training, normal: Tensor) -> Tensor:
    """Return the least-squares albedo [3, H, W] for value = albedo * max(0, n.l)."""
    btf, dtype = training.btf, training.dtype
    flat = normal.flatten(1)
    light = torch.where(training.used[:, None], btf.light, torch.zeros(())).to(dtype)
    numerator = torch.zeros(3, flat.shape[1], dtype=dtype)
    denominator = torch.zeros(flat.shape[1], dtype=dtype)
    for block in btf.blocks(training.used, dtype, training.progress):
        shading = (light[block.samples.start : block.samples.stop] @ flat).clamp_(min=0)
        weighted = shading if block.weight is None else shading * block.weight[:, 0].flatten(1)
        # In place and plane by plane: einsum turns this into a product per texel, 50 times slower.
        denominator += (weighted * shading).sum(dim=0)
        numerator += block.images.flatten(2).mul_(weighted[:, None]).sum(dim=0)
    return safe.divide(numerator, denominator).unflatten(1, normal.shape[1:])
