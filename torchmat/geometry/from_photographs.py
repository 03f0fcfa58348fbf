"""Relief without a BTF: from a few photographs under known lights, or from one picture."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchmat import colour
from torchmat.errors import RangeError, ShapeError, check_finite, check_option, message
from torchmat.geometry.integrate import frankot_chellappa, poisson
from torchmat.geometry.mask import check_mask
from torchmat.geometry.normals import check_height_scale, normals_from_height, slopes_from_normals
from torchmat.geometry.photometric_stereo import Stereo, photometric_stereo

INTEGRATIONS = ("fourier", "poisson")
_DARK = 0.2  # of the bright texels' albedo: below it slopes are trusted less


class Relief(NamedTuple):
    """The shape of a surface.

    `height` [1, H, W] in texture widths with mean 0; unit `normal` [3, H, W]; `albedo` [3, H, W] and `confidence`
    [1, H, W] where photographs gave them, else None.
    """

    height: Tensor
    normal: Tensor
    albedo: Tensor | None = None
    confidence: Tensor | None = None


def check_integration(where: str, integration: str, mask: Tensor | None) -> None:
    """Raise RangeError unless slopes can be integrated so, within an object `mask` where there is one."""
    check_option(where, "integration", integration, INTEGRATIONS)
    if mask is not None and integration != "poisson":
        fact, step = f"it is {integration!r}, which integrates the whole picture", "Leave it out, or the mask (--mask none)."
        raise RangeError(message(where, "integration", "be 'poisson' with an object mask", fact, step))


def relief_from_photographs(
    images: Tensor, light: Tensor, weight: Tensor | None = None, tiles: bool = False, integration: str = "poisson",
    mask: Tensor | None = None,
) -> Relief:
    """Return the relief that photographs of one view under known lights show.

    `images` [n, 3, H, W] linear, `light` [n, 3] unit, `weight` [n, 1, H, W] in [0, 1]. Normals by robust photometric
    stereo; the height by weighted least squares, trusting each texel as far as its confidence and brightness
    ("poisson"), or in one step by Fourier transform ("fourier"). One view fixes the scale of the slopes but no offset:
    the mean height is 0.

    Of a `mask`, bool [H, W], only the object inside is looked at and integrated ("poisson"): the mean height of each piece is
    0, and outside the relief is flat, as low as the object's border. Raises RangeError for "fourier", which knows no masks.
    """
    mask = None if mask is None else check_mask("relief_from_photographs", mask, (images.shape[-2], images.shape[-1]))
    check_integration("relief_from_photographs", integration, mask)
    return relief_from_stereo(photometric_stereo(images, light, weight, mask), tiles, integration, mask)


def relief_from_stereo(
    found: Stereo, tiles: bool = False, integration: str = "poisson", mask: Tensor | None = None
) -> Relief:
    """Return the relief of the normals that photometric stereo found; see `relief_from_photographs`."""
    slopes = slopes_from_normals(found.normal)
    if integration == "poisson" and bool((found.confidence > 0).any()):
        height = poisson(slopes, found.confidence * _signal(found.albedo, mask), tiles, mask=mask)
    else:
        height = frankot_chellappa(slopes, tiles)
    return Relief(height, found.normal, found.albedo, found.confidence)


def _signal(albedo: Tensor, mask: Tensor | None) -> Tensor:
    """Return how far above its noise each texel stands, [1, H, W] in [0, 1]: a dark background has slopes of noise."""
    grey = albedo.mean(dim=0, keepdim=True)
    known = grey.flatten() if mask is None else grey[0, mask]
    bright = torch.sort(known).values[int(0.9 * (known.numel() - 1))].clamp(min=1e-12)
    return (grey / (_DARK * bright)).clamp(max=1) ** 2


def relief_from_picture(
    picture: Tensor, height_scale: float = 0.05, normal_strength: float = 1.0, tiles: bool = True
) -> Relief:
    """Return the relief that takes the luminance of one `picture` [3, H, W] (display values, 0 to 1) for its height.

    What an artist does for want of measurements (Liao 2011, section 3.3.1): dark is low. `height_scale` is the height
    of white in texture widths; normals are the Sobel ones of the unscaled luminance with `normal_strength`.
    """
    if picture.ndim != 3 or picture.shape[0] != 3:
        raise ShapeError(message("relief_from_picture", "picture", "be [3, H, W]", f"it is {tuple(picture.shape)}"))
    check_finite("relief_from_picture", "picture", picture)
    check_height_scale("relief_from_picture", height_scale)
    grey = colour.luminance(picture)[None]
    height = grey * height_scale
    return Relief(height - height.mean(), normals_from_height(grey, normal_strength, tiles))
