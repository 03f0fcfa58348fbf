"""Fits of the baselines of `models.linear`, in closed form."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from torchmat import colour, safe
from torchmat.btf import Btf
from torchmat.errors import RangeError, check_option, message
from torchmat.fitting.models.by_texel import TexelFit, fit_texels
from torchmat.fitting.models.streamed import Encode, LinearFit, fit_bands, solve_texels, stream_moments
from torchmat.fitting.recipe import Recipe, Rung
from torchmat.fitting.relief.surface import Surface
from torchmat.fitting.shared import Shared
from torchmat.fitting.training import Fitted, Training
from torchmat.geometry import normals_from_slopes
from torchmat.models import Hsh, Lambert, Lptm, Ptm, Texture
from torchmat.models.bases import BASES
from torchmat.models.linear import HSH_TERMS, LINEAR, NORMALS, SPACES, SRGB
from torchmat.models.storage import StoredAs
from torchmat.repeatable import one_thread, product
from torchmat.solvers.least_squares import Design, make_design

_KNEE = 0.0031308  # of linear light: below it codes are a multiple
_CONSTANT = "1"
_EYE = 1.0  # of the mean value: darker samples weigh no more


def design_of(training: Training, basis: str, ridge: float = 0.0) -> Design:
    """Return the design matrix that `basis` makes of the training directions."""
    light, view = training.light.double(), training.view.double()
    matrix = BASES[basis].evaluate(light, view)[:, :, 0, 0]
    return make_design(matrix, training.used, ridge, training.importance)


def encoded(images: Tensor) -> Tensor:
    """Return linear images as the codes of a screen (IEC 61966-2-1), of which 1 is white and which go on above it.

    As `colour` does, but by a logarithm, which has the same bits on any number of threads, and in a third of the memory.
    """
    light = images.clamp(min=0)  # no light is less than none, but a relief's indirect light is taken off
    curve = light.clamp(min=_KNEE).log_().mul_(1 / 2.4).exp_().mul_(1.055).sub_(0.055)
    return torch.where(light > _KNEE, curve, light * 12.92)


def _asked(training: Training, basis: str, space: str) -> tuple[Btf, Design, Tensor, torch.dtype, bool | None, Encode | None]:
    """Return what the least squares of a basis in a space are asked for."""
    check_option(f"fit to {basis}", "space", space, SPACES)
    encode = encoded if space == SRGB else None
    return training.btf, design_of(training, basis), training.used, training.dtype, training.progress, encode


def _solve_near(training: Training, basis: str, space: str = LINEAR) -> TexelFit:
    """Return the fit of directions that each texel has of its own."""
    check_option(f"fit to {basis}", "space", space, SPACES)
    terms, evaluate = BASES[basis]
    return fit_texels(training, len(terms), evaluate, encode=encoded if space == SRGB else None)


def _solved(training: Training, basis: str, space: str = LINEAR) -> LinearFit:
    return fit_bands(*_asked(training, basis, space)) if training.btf.near is None else _solve_near(training, basis, space).fit


def fit_texture(training: Training, *, storage: str = "half") -> Fitted:
    """Least-squares colour per texel for value = colour * cos(light)."""
    solved = _solved(training, "cosine")
    albedo = solved.coefficients[0].clamp(min=0)  # the non-negative minimum of one unknown is the clamped one
    return Fitted(Texture({"albedo": albedo}, storage=storage), coverage=solved.coverage)


def fit_ptm(training: Training, *, space: str = SRGB, storage: str = "half") -> Fitted:
    """Least-squares biquadratic per texel and channel.

    Args:
        space: "srgb" fits the codes of a screen, as RTI tools do: nearer to what is seen; "linear" the light itself: nearer in highlights,
            and what a solver that steps takes unless it is told.
    """
    solved = _solved(training, "polynomial", space)
    maps = {"polynomial": solved.coefficients.flatten(0, 1)}
    return Fitted(Ptm(maps, space=space, storage=storage), coverage=solved.coverage)


def fit_hsh(training: Training, *, terms: int = 9, space: str = SRGB, storage: str = "half") -> Fitted:
    """Least-squares hemispherical harmonics per texel and channel.

    Args:
        terms: harmonics per texel and channel, 4, 9 or 16: more follow sharper shading and need more lights.
        space: "srgb" fits the codes of a screen, as RTI tools do: nearer to what is seen; "linear" the light itself: nearer in highlights,
            and what a solver that steps takes unless it is told.
    """
    check_option("fit hsh", "terms", terms, HSH_TERMS)
    solved = _solved(training, f"hsh{terms}", space)
    maps = {"harmonic": solved.coefficients.flatten(0, 1)}
    return Fitted(Hsh(maps, terms=terms, space=space, storage=storage), coverage=solved.coverage)


def fit_lptm(training: Training, *, space: str = SRGB, storage: str = "half") -> Fitted:
    """Biquadratic of luminance per texel; colour = summed colour over summed luminance (Malzbender et al. 2001).

    The sum over samples is the product with the design's constant column, so one pass gives both.

    Args:
        space: "srgb" fits the codes of a screen, as RTI tools do: nearer to what is seen; "linear" the light itself: nearer in highlights,
            and what a solver that steps takes unless it is told.
    """
    if training.btf.near is None:
        asked = _asked(training, "polynomial", space)
        design, moments = asked[1], stream_moments(*asked)
        ones = product(design.left.T, training.used.double()[:, None])[:, 0].to(training.dtype)
        total = torch.einsum("r,rchw->chw", ones, moments.product).clamp(min=0)
        solved = solve_texels(training.btf, design, moments, training.used, reuse=True)
    else:
        solved, sums = _solve_near(training, "polynomial", space)
        total = sums[BASES["polynomial"].terms.index(_CONSTANT)].clamp(min=0)
    luminance = colour.luminance(solved.coefficients, dim=1)
    brightness = colour.luminance(total)
    grey = torch.ones_like(total)
    chroma = torch.where(brightness > 0, safe.divide(total, brightness), grey)
    maps = {"chroma": chroma, "luminance": luminance}
    return Fitted(Lptm(maps, space=space, storage=storage), coverage=solved.coverage)


def fit_lambert(training: Training, *, normals: str = "auto", storage: str = "half") -> Fitted:
    """Normal from the least-squares gradient of luminance over the light, then the albedo for that normal.

    Woodham 1980 over all samples, without rejecting shadows or highlights: the plain baseline.

    Args:
        normals: "map" for a normal map, "height" for the slopes of the relief (which needs one), or "auto": a map on a flat
            surface and the height's on a relief.
    """
    check_option("fit lambert", "normals", normals, ("auto", *NORMALS))
    if normals == "height":
        step = "Use geometry='recover' or a height map, or normals='map'."
        raise RangeError(message("fit lambert", "normals='height'", "have a height", "the geometry is flat", step))
    btf, used, dtype = training.btf, training.used, training.dtype
    if btf.near is None:
        design = make_design(btf.light.double(), used, importance=training.importance)
        moments = stream_moments(btf, design, used, dtype, training.progress)
        solved = solve_texels(btf, design, moments, used, reuse=True)
    else:
        solved = fit_texels(training, 3, lambda light, view: light).fit
    normal = safe.normalise(colour.luminance(solved.coefficients, dim=1))
    up = torch.zeros(3, 1, 1, dtype=dtype)
    up[2] = 1
    # A black texel, or one whose samples contradict each other, has no normal: it gets the surface's.
    normal = torch.where((normal[2:] > 0), normal, up)
    albedo = _albedo(training, normal).clamp(min=0)
    return Fitted(Lambert({"albedo": albedo, "normal": normal}, storage=storage), coverage=solved.coverage)


@dataclass(frozen=True)
class LambertShared(Shared):
    """What all texels share on a relief: the data's `mean_value`, by which samples are weighed."""

    mean_value: float = 1.0


def fit_lambert_on_relief(
    surface: Surface, height: Tensor, *, normals: str = "auto", storage: str = "half"
) -> Fitted | None:
    """Fit albedo and ambient colour of each texel for the normals of the height, in closed form.

    Returns None for normals="map", which takes the way of all models.

    ``value = albedo * lit * max(0, n.l) + ambient``, both non-negative: two unknowns a channel. Samples weigh the less
    the brighter they are, as they do to the eye; without that, PSNR on deep relief is 0.6 dB lower.
    """
    check_option("fit lambert", "normals", normals, ("auto", *NORMALS))
    if normals == "map":
        return None
    training = surface.training
    btf, dtype = training.btf, training.dtype
    normal = normals_from_slopes(surface.slopes).flatten(1)
    size = (btf.height, btf.width)
    left, right = torch.zeros(3, *size, dtype=dtype), torch.zeros(2, 3, *size, dtype=dtype)
    known = training.shared
    mean_value = known.mean_value if isinstance(known, LambertShared) else _mean_value(training)
    level = _EYE * mean_value
    for block in btf.blocks(None, dtype, training.progress):
        direct = _cosine(btf, block.samples, normal, dtype).reshape(-1, 1, *size) * surface.shadow(block.samples)
        weight = 1 / (block.images.mean(dim=1, keepdim=True) + level)
        weight = weight if block.weight is None else weight * block.weight
        weight = training.counted(weight, block.samples)
        weighted = weight * direct
        left += torch.stack([(weighted * direct)[:, 0].sum(0), weighted[:, 0].sum(0), weight[:, 0].sum(0)])
        right[0] += (block.images * weighted).sum(dim=0)
        right[1] += (block.images * weight).sum(dim=0)
    albedo, ambient = _two_non_negative(*left, *right)
    lit = ((left[0] > 0) & (left[2] > 0)).to(dtype)[None]
    maps = {"albedo": albedo, "height": height.to(dtype), "ambient": ambient}
    material = Lambert(maps, normals="height", storage=storage, tiles=training.tiles)
    return Fitted(material, coverage=lit, shared=LambertShared(mean_value=mean_value))


def _cosine(btf: Btf, samples: range, normal: Tensor, dtype: torch.dtype) -> Tensor:
    """Return max(0, n.l) of a run of samples for normals [3, t], [k, t]."""
    if btf.near is None or btf.near.light is None:
        return (btf.light[samples.start : samples.stop].to(dtype) @ normal).clamp_(min=0)
    light = btf.directions(samples, dtype)[0].flatten(2)
    return (light * normal).sum(dim=1).clamp_(min=0)


def _mean_value(training: Training) -> float:
    total = torch.zeros(training.btf.height, training.btf.width, dtype=torch.float64)
    for block in training.btf.blocks(None, training.dtype):
        total += block.images.mean(dim=1).sum(dim=0)
    with one_thread():
        inside = total if training.btf.mask is None else total[training.btf.mask]
        return max(float(inside.mean()) / len(training.btf), 1e-30)


def _two_non_negative(aa: Tensor, ab: Tensor, bb: Tensor, ay: Tensor, by: Tensor) -> tuple[Tensor, Tensor]:
    """Solve min |a x + b y|^2 with x, y >= 0 for each texel: sums of products [H, W], right-hand sides [3, H, W].

    A little of each unknown's own energy is added, which gives those that no sample determines the value 0.
    """
    ridge = 1e-4 * (aa + bb) / 2
    aa, bb = aa + ridge, bb + ridge
    determinant = aa * bb - ab * ab
    x, y = safe.divide(bb * ay - ab * by, determinant), safe.divide(aa * by - ab * ay, determinant)
    alone_x, alone_y = safe.divide(ay, aa).clamp(min=0), safe.divide(by, bb).clamp(min=0)
    zero = torch.zeros_like(x)
    return torch.where(x < 0, zero, torch.where(y < 0, alone_x, x)), torch.where(y < 0, zero, torch.where(x < 0, alone_y, y))


def _albedo(training: Training, normal: Tensor) -> Tensor:
    """Return the least-squares albedo [3, H, W] for value = albedo * max(0, n.l)."""
    btf, dtype = training.btf, training.dtype
    flat = normal.flatten(1)
    used = training.used.to(dtype)
    numerator = torch.zeros(3, flat.shape[1], dtype=dtype)
    denominator = torch.zeros(flat.shape[1], dtype=dtype)
    for block in btf.blocks(training.used, dtype, training.progress):
        rows = slice(block.samples.start, block.samples.stop)
        if btf.near is None:
            light = torch.where(training.used[rows, None], btf.light[rows], torch.zeros(())).to(dtype)
            shading = (light @ flat).clamp_(min=0)
        else:
            shading = _cosine(btf, block.samples, flat, dtype) * used[rows, None]
        weighted = shading if block.weight is None else shading * block.weight[:, 0].flatten(1)
        weighted = training.counted(weighted, block.samples)
        # In place and plane by plane: einsum turns this into a product per texel, 50 times slower.
        denominator += (weighted * shading).sum(dim=0)
        numerator += block.images.flatten(2).mul_(weighted[:, None]).sum(dim=0)
    return safe.divide(numerator, denominator).unflatten(1, normal.shape[1:])


TEXTURE = Recipe(Texture, fit_texture, near=True, bytes_per_texel="6", rungs=(
    Rung("constant", "texture", 0, {}, {"albedo": StoredAs((1, 1))}), Rung("texture", "texture", 3),
))
LAMBERT = Recipe(
    Lambert, fit_lambert, near=True, bytes_per_texel="12", by_luminance=("normal",), on_relief=fit_lambert_on_relief, shared=LambertShared,
    rungs=(Rung("Lambert", "lambert", 6),),
)
# The automatic choice judges highlights too, which sums in linear light are nearer to; what steps makes errors of linear
# light small, which codes of a screen bend.
_LINEAR = {"space": LINEAR}
PTM = Recipe(Ptm, fit_ptm, near=True, bytes_per_texel="36", stepping=_LINEAR, rungs=(Rung("PTM", "ptm", 18, _LINEAR),))
LPTM = Recipe(Lptm, fit_lptm, near=True, bytes_per_texel="18", stepping=_LINEAR, rungs=(Rung("luminance PTM", "lptm", 9, _LINEAR),))
HSH = Recipe(
    Hsh, fit_hsh, near=True, bytes_per_texel="54", compared=tuple(f"terms={terms}" for terms in HSH_TERMS), stepping=_LINEAR,
    rungs=tuple(
        Rung(f"{terms} harmonics", "hsh", size, {"terms": terms, **_LINEAR}) for terms, size in ((4, 12), (9, 27))
    ),
)
