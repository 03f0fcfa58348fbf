"""A PBR texture set to a material: colour, height, normals, and a few lobes that stand for all roughnesses."""

from __future__ import annotations

import math
from pathlib import Path

import torch
from torch import Tensor

from torchmat import safe
from torchmat.create.from_picture import assemble, black_to_white
from torchmat.create.specular_maps import disc
from torchmat.create.textures import find_textures, read_textures
from torchmat.errors import DataError, RangeError, check_finite, message
from torchmat.geometry import normals_from_slopes, slopes_from_height, slopes_from_normals
from torchmat.geometry.normals import check_height_scale
from torchmat.models.distribution import Distribution
from torchmat.models.storage import StoredAs

_WHERE = "material_from_textures"
DIELECTRIC = 0.04  # r0 of a refractive index of 1.5
_ROUGHNESS = 0.5  # of a metal that says nothing of it
_HEIGHT_SCALE = 0.05  # of a displacement of which nothing else is known
_SIZE = 64
_FINE = 4  # samples a texel and axis: the peak of a sharp lobe is averaged over its texel


def material_from_textures(
    folder: str | Path, *, lobes: int = 3, height_scale: float | None = None, occlusion: bool = False, size: int = _SIZE,
    tiles: bool = True, storage: str = "paint8",
) -> Distribution:
    """Return the material of a folder of textures named as ambientCG names them (see `find_textures`).

    Diffuse is Color, less the share that Metalness says (with `occlusion` times AmbientOcclusion). The height is
    Displacement times `height_scale` in texture widths, 0 for none, by default what agrees best with the normal map
    (0.05 without one); `normal` then holds what its slopes lack of NormalGL's or NormalDX's, so that both together
    shade as the normal map says. Roughness becomes `lobes` GGX
    lobes [3, size, size] from the smallest to the largest that occurs, and an index that blends the two nearest; r0
    is 0.04, of metal its colour, which a mask of three channels tints. Without Roughness a metal has 0.5, anything
    else no specular part. Only what the files give is there. Masking and shadowing of microfacets is left to the
    model's D. Raises DataError or ShapeError naming the file, RangeError for a control out of range.
    """
    for name, number in (("lobes", lobes), ("size", size)):
        if not isinstance(number, int) or isinstance(number, bool) or number < 1:
            raise RangeError(message(_WHERE, name, "be a whole number from 1", f"it is {number!r}"))
    textures = read_textures(find_textures(folder))
    colour, metal = textures["color"], _share(folder, textures, "metalness")
    maps = {"diffuse": colour if metal is None else colour * (1 - metal)}
    if occlusion:
        shade = _share(folder, textures, "ambientocclusion")
        if shade is None:
            step = "Add one whose name ends in _AmbientOcclusion, or leave the occlusion out."
            raise DataError(message(str(folder), "the folder", "hold an occlusion texture", "it holds none", step))
        maps["diffuse"] = maps["diffuse"] * shade
    shape, stored = _shape(folder, textures, height_scale, tiles)
    maps |= shape
    rough = _share(folder, textures, "roughness")
    if rough is None and metal is not None:
        rough = torch.full_like(metal, _ROUGHNESS)
    if rough is None:
        return assemble(maps, 0, tiles, storage, stored)
    levels, index = quantised(rough, lobes)
    maps |= _reflectance(colour, metal)
    maps["specular"] = torch.cat([ggx_lobe(float(level), size) for level in levels])
    if len(levels) > 1:
        maps["index"] = index
    return assemble(maps, len(levels), tiles, storage, stored)


def _share(folder: str | Path, textures: dict[str, Tensor], kind: str) -> Tensor | None:
    """Return a texture [1, H, W] of shares, None when there is none; raises RangeError outside [0, 1]."""
    texture = textures.get(kind)
    if texture is not None and (float(texture.min()) < 0 or float(texture.max()) > 1):
        fact = f"it runs from {float(texture.min()):.6g} to {float(texture.max()):.6g}"
        raise RangeError(message(str(folder), f"the {kind} texture", "lie in [0, 1]", fact, "Correct it."))
    return texture


def _shape(
    folder: str | Path, textures: dict[str, Tensor], height_scale: float | None, tiles: bool
) -> tuple[dict[str, Tensor], dict[str, StoredAs]]:
    """Return the height, and the normal map: alone, or what is left of it beside the height; and how they are stored."""
    found, stored = {}, {}
    slopes = slopes_from_normals(textures["normal"]) if "normal" in textures else None
    if "displacement" in textures and height_scale != 0:
        if height_scale is None:
            height_scale = _HEIGHT_SCALE
            if slopes is not None:
                height_scale = _agreeing_scale(str(folder), textures["displacement"], slopes, tiles)
        check_height_scale(_WHERE, height_scale)
        height = textures["displacement"] * height_scale
        found["height"] = height - height.mean()
        stored["height"] = black_to_white(textures["displacement"], height_scale)
        slopes = None if slopes is None else slopes - slopes_from_height(found["height"], tiles=tiles)
    if slopes is not None:
        found["normal"] = normals_from_slopes(slopes)
    return found, stored


def _agreeing_scale(where: str, displacement: Tensor, slopes: Tensor, tiles: bool) -> float:
    """Return the scale at which the slopes of a displacement are nearest to `slopes`, in the sense of least squares.

    Nothing in a texture set states its height, but its normals do. Both are averaged over some texels first: what 8 bits
    leave of a displacement has steps, whose noise would pass for slopes too steep (measured on two sets: correlation
    0.85 to 0.89 texel by texel, 0.99 averaged over 8 x 8).
    """
    kernel = [max(1, min(8, side // 8)) for side in displacement.shape[1:]]
    rise, wanted = (
        torch.nn.functional.avg_pool2d(each, kernel) for each in (slopes_from_height(displacement, tiles=tiles), slopes)
    )
    energy = float((rise * rise).sum())
    if energy == 0:
        return _HEIGHT_SCALE  # it is even: any scale will do
    scale = float((rise * wanted).sum()) / energy
    if scale <= 0:
        fact = f"their slopes are {'opposite' if scale < 0 else 'unrelated'}"
        step = "Give a height_scale, or 0 for no height; check that they belong together."
        raise DataError(message(where, "the displacement and the normal map", "agree", fact, step))
    return scale


def _reflectance(colour: Tensor, metal: Tensor | None) -> dict[str, Tensor]:
    """Return r0 [1, H, W], and for metals a mask of three channels: r0 is the largest channel, the mask the ratio."""
    if metal is None:
        return {"fresnel": torch.full_like(colour[:1], DIELECTRIC)}
    at_normal = torch.lerp(torch.full_like(colour, DIELECTRIC), colour.clamp(max=1), metal)
    most = at_normal.amax(dim=0, keepdim=True)
    return {"fresnel": most, "specular_mask": torch.where(most > 0, safe.divide(at_normal, most), 1.0)}


def quantised(rough: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """Return `count` even levels [K] of roughness [1, H, W], and each texel's weights [K, H, W] of the two nearest.

    Weights are linear between the levels, so that they sum to 1 and their mean level is the texel's roughness. Of an
    even roughness there is one level only; one level is the mean.
    """
    check_finite("quantised", "roughness", rough)
    low, high = float(rough.min()), float(rough.max())
    if count == 1 or low == high:
        return rough.double().mean().float()[None], torch.ones_like(rough)
    place = (rough[0].double() - low) / (high - low) * (count - 1)
    number = torch.arange(count, dtype=torch.float64)
    index = (1 - (place - number[:, None, None]).abs()).clamp(min=0)
    return (low + (high - low) * number / (count - 1)).float(), index.to(rough.dtype)


def ggx_lobe(roughness: float, size: int = _SIZE) -> Tensor:
    """Return a quarter of GGX's distribution of half vectors, [3, size, size], for a `roughness` in [0, 1].

    ``alpha^2 / (4 pi (cos^2 (alpha^2 - 1) + 1)^2)`` with ``alpha = roughness^2`` (Walter et al. 2007; Burley 2012): seen
    along the normal the model's value is then that of the microfacet one. A map of `size` texels holds no lobe narrower
    than a texel, so that alpha counts as at least half the angle of one, and each texel is the mean over it.
    """
    if not 0 <= roughness <= 1:
        raise RangeError(message("ggx_lobe", "roughness", "lie in [0, 1]", f"it is {roughness}"))
    polar, _ = disc(size * _FINE)
    squared = max(roughness**2, min(1.0, 2 / size)) ** 2  # a texel at the centre spans 4 / size radians
    value = squared / (4 * math.pi * (torch.cos(polar) ** 2 * (squared - 1) + 1) ** 2)
    lobe = torch.nn.functional.avg_pool2d(value[None, None], _FINE)[0]
    return lobe.expand(3, size, size).float().contiguous()
