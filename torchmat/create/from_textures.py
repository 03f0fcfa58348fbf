"""A PBR texture set to a material: colour, height, normals, and a few lobes that stand for all roughnesses."""

from __future__ import annotations

import math
from collections.abc import Callable
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
from torchmat.geometry.tiling import AUTO_TILES, check_tiles, tiling_of
from torchmat.models.distribution import Distribution
from torchmat.models.storage import StoredAs
from torchmat.progress import in_command, phase, progress

_WHERE = "material_from_textures"
DIELECTRIC = 0.04  # r0 of a refractive index of 1.5
_ROUGHNESS = 0.5  # of a metal that says nothing of it
_HEIGHT_SCALE = 0.05  # of a displacement of which nothing else is known
_SURE, _CERTAIN = 0.1, 0.5  # correlations: enough to tell a sign by, and enough to contradict a name
_SIZE = 64
_FINE = 4  # samples a texel and axis: the peak of a sharp lobe is averaged over its texel


def material_from_textures(
    folder: str | Path, *, lobes: int = 3, height_scale: float | None = None, occlusion: bool = False, size: int = _SIZE,
    tiles: bool | str = AUTO_TILES, storage: str = "paint8", say: Callable[[str], None] | None = None,
) -> Distribution:
    """Return the material of a folder of textures, named as vendors name them (see `find_textures`).

    Diffuse is the colour, less the share that is metal (with `occlusion` times the occlusion texture). The height is the
    displacement times `height_scale` in texture widths, 0 for none, by default what agrees best with the normal map
    (0.05 without one); `normal` then holds what its slopes lack of the normal map's, so that both together
    shade as the normal map says. A normal map whose name does not say so is OpenGL's or DirectX's as agrees with the
    displacement, or else as slopes of a surface do. Roughness becomes `lobes` GGX lobes [3, size, size] from the smallest
    to the largest that occurs, and an index that blends the two nearest; r0 is 0.04, of metal its colour, or that of a
    specular texture, and a mask of three channels tints it. Without roughness a metal has 0.5, anything
    else no specular part. What is cut out (`opacity`) keeps the mean of the rest, so that no average sees it. Only what
    the files give is there. `tiles` says whether they repeat, "auto" asks the colour. Masking and shadowing of microfacets is left to the model's D. `say` is called with a line
    for each thing that the files do not state. Raises DataError, ShapeError or RangeError naming the file, RangeError for
    a control out of range.
    """
    for name, number in (("lobes", lobes), ("size", size)):
        if not isinstance(number, int) or isinstance(number, bool) or number < 1:
            raise RangeError(message(_WHERE, name, "be a whole number from 1", f"it is {number!r}"))
    say = say or (lambda line: None)
    textures = filled(read_textures(find_textures(folder)))
    tiles, told = repeats(_WHERE, textures["color"], tiles)
    colour, metal = textures["color"], textures.get("metalness")
    maps = {"diffuse": colour if metal is None else colour * (1 - metal)}
    if occlusion:
        maps["diffuse"] = with_occlusion(folder, maps["diffuse"], textures)
    with phase("bringing height and normals together"):
        shape, stored = shape_of(folder, textures, height_scale, tiles, say)
    for line in told:
        say(line)
    maps |= shape
    if "opacity" in textures:
        maps["opacity"] = textures["opacity"]
    rough = textures.get("roughness")
    if rough is None and (metal is not None or "f0" in textures):
        rough = torch.full_like(colour[:1], _ROUGHNESS)
        say(f"roughness: no file gives it; {_ROUGHNESS} is taken")
    if rough is None:
        return assemble(maps, 0, tiles, storage, stored)
    with phase("choosing roughnesses"):
        levels, index = quantised(rough, lobes)
    maps |= _reflectance(colour, metal, textures.get("f0"))
    drawn = progress(levels, "computing specular maps", show=in_command())
    maps["specular"] = torch.cat([ggx_lobe(float(level), size) for level in drawn])
    if len(levels) > 1:
        maps["index"] = index
    return assemble(maps, len(levels), tiles, storage, stored)


def repeats(where: str, colour: Tensor, tiles: bool | str) -> tuple[bool, list[str]]:
    """Return whether the textures repeat, and a line on it where nobody says so."""
    check_tiles(where, tiles)
    if tiles != AUTO_TILES:
        return bool(tiles), []
    found = tiling_of(colour[None])
    return found.repeats, [f"tiles: {found.sentence()}"]


def with_occlusion(folder: str | Path, diffuse: Tensor, textures: dict[str, Tensor]) -> Tensor:
    """Return a diffuse map times the occlusion texture; raises DataError where there is none."""
    if "ambientocclusion" not in textures:
        step = "Add one whose name ends in _AmbientOcclusion, or leave the occlusion out."
        raise DataError(message(str(folder), "the folder", "hold an occlusion texture", "it holds none", step))
    return diffuse * textures["ambientocclusion"]


def filled(textures: dict[str, Tensor]) -> dict[str, Tensor]:
    """Return the textures with the mean of what is there in place of what is wholly cut out; vendors leave it black."""
    opacity = textures.get("opacity")
    if opacity is None or not bool((opacity > 0).any()):
        return textures
    gone, weight = opacity == 0, opacity / opacity.sum()
    return {
        name: value if name == "opacity" else torch.where(gone, (value * weight).sum(dim=(1, 2), keepdim=True), value)
        for name, value in textures.items()
    }


def shape_of(
    folder: str | Path, textures: dict[str, Tensor], height_scale: float | None, tiles: bool, say: Callable[[str], None]
) -> tuple[dict[str, Tensor], dict[str, StoredAs]]:
    """Return the height, and the normal map: alone, or what is left of it beside the height; and how they are stored."""
    found: dict[str, Tensor] = {}
    stored: dict[str, StoredAs] = {}
    rise = slopes_from_height(textures["displacement"], tiles=tiles) if "displacement" in textures else None
    slopes = _normal_slopes(folder, textures, rise, tiles, say)
    if rise is not None and height_scale != 0:
        why = "as given"
        if height_scale is None:
            height_scale, why = _HEIGHT_SCALE, "nothing says how high"
            if slopes is not None:
                height_scale, why = _agreeing_scale(str(folder), rise, slopes), "as the normal map's slopes say"
        check_height_scale(_WHERE, height_scale)
        say(f"height: white lies {height_scale:.3g} texture widths over black, {why}")
        height = textures["displacement"] * height_scale
        found["height"] = height - height.mean()
        stored["height"] = black_to_white(textures["displacement"], height_scale)
        slopes = None if slopes is None else slopes - slopes_from_height(found["height"], tiles=tiles)
    if slopes is not None:
        found["normal"] = normals_from_slopes(slopes)
    return found, stored


def _normal_slopes(
    folder: str | Path, textures: dict[str, Tensor], rise: Tensor | None, tiles: bool, say: Callable[[str], None]
) -> Tensor | None:
    """Return the slopes of the normal map, turned over where it is DirectX's; None where there is none."""
    if "normalgl" in textures:
        return slopes_from_normals(textures["normalgl"])
    if "normal" not in textures:
        return None
    slopes = slopes_from_normals(textures["normal"])
    agreement, of_what = _upward(slopes, rise, tiles)
    kind = "DirectX" if agreement < 0 else "OpenGL"
    sure = "" if abs(agreement) > _SURE else ", which is a guess: rename the file to end in _NormalGL or _NormalDX"
    say(f"normal: read as {kind}'s; its green agrees with {of_what} by {agreement:+.2f}{sure}")
    return torch.stack((slopes[0], -slopes[1])) if agreement < 0 else slopes


def _upward(slopes: Tensor, rise: Tensor | None, tiles: bool) -> tuple[float, str]:
    """Return how well the second of `slopes` [2, H, W] points up, -1 to 1, and what was asked: DirectX's points down.

    Against those of a displacement, whose sign the first slope tells: a hollow may be white. Without one by the twist
    that only normals of a surface lack: d(dz/dx)/dy = d(dz/dy)/dx (Frankot & Chellappa 1988).
    """
    if rise is not None:
        along, across = (_correlation(one, other) for one, other in zip(_smooth(slopes), _smooth(rise), strict=True))
        if abs(along) > _SURE and abs(across) > _SURE:
            return (across if along > 0 else -across), "the displacement"
    twist = [slopes_from_height(one[None], tiles=tiles) for one in slopes]
    return _correlation(_smooth(twist[0][1:]), _smooth(twist[1][:1])), "its own red"


def _correlation(first: Tensor, second: Tensor) -> float:
    product = (first * second).sum()
    return float(safe.divide(product, torch.sqrt((first * first).sum() * (second * second).sum())))


def _smooth(planes: Tensor) -> Tensor:
    """Return planes [n, H, W] averaged over some texels: what 8 bits leave of a height has steps, whose slopes are noise."""
    return torch.nn.functional.avg_pool2d(planes, [max(1, min(8, side // 8)) for side in planes.shape[1:]])


def _agreeing_scale(where: str, rise: Tensor, slopes: Tensor) -> float:
    """Return the scale at which the slopes `rise` of a displacement are nearest to `slopes`, in the sense of least squares.

    Nothing in a texture set states its height, but its normals do. Both are averaged over some texels first: what 8 bits
    leave of a displacement has steps, whose noise would pass for slopes too steep (measured on two sets: correlation
    0.85 to 0.89 texel by texel, 0.99 averaged over 8 x 8).
    """
    rise, wanted = _smooth(rise), _smooth(slopes)
    along, across = (_correlation(one, other) for one, other in zip(wanted, rise, strict=True))
    if along * across < 0 and min(abs(along), abs(across)) > _CERTAIN:
        fact = f"they agree by {along:+.2f} to the right and {across:+.2f} upward"
        step = "Is its name right? OpenGL's normal map ends in _NormalGL, DirectX's in _NormalDX; or give a height_scale."
        raise DataError(message(where, "the displacement and the normal map", "agree in both directions", fact, step))
    energy = float((rise * rise).sum())
    if energy == 0:
        return _HEIGHT_SCALE  # it is even: any scale will do
    scale = float((rise * wanted).sum()) / energy
    if scale <= 0:
        fact = f"their slopes are {'opposite' if scale < 0 else 'unrelated'}"
        step = "Give a height_scale, or 0 for no height; check that they belong together."
        raise DataError(message(where, "the displacement and the normal map", "agree", fact, step))
    return scale


def _reflectance(colour: Tensor, metal: Tensor | None, given: Tensor | None) -> dict[str, Tensor]:
    """Return r0 [1, H, W], the largest channel, and of what is coloured a mask of three channels: the ratio to it."""
    if metal is not None:
        at_normal = torch.lerp(torch.full_like(colour, DIELECTRIC), colour.clamp(max=1), metal)
    elif given is not None:
        at_normal = given
    else:
        return {"fresnel": torch.full_like(colour[:1], DIELECTRIC)}
    most = at_normal.amax(dim=0, keepdim=True)
    if bool((at_normal == most).all()):
        return {"fresnel": most}
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
