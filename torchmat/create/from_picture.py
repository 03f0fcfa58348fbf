"""One picture to a whole material, by the controls an artist has (Liao 2011, section 3.3)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from torchmat import colour
from torchmat.create.controls import brightness_contrast, check_picture, darkened, draw_360, segments
from torchmat.create.specular_maps import specular_map, tilt_curve
from torchmat.errors import ShapeError, message
from torchmat.geometry import relief_from_picture
from torchmat.geometry.tiling import AUTO_TILES, check_tiles, tiling_of
from torchmat.models.distribution import Distribution
from torchmat.models.storage import StoredAs
from torchmat.progress import phase

_WHERE = "material_from_picture"


def material_from_picture(
    picture: Tensor, *, lobes: int = 1, specular: Sequence[str | Tensor] = ("glossy",),
    mask_brightness: float | None = 0.0, mask_contrast: float = 1.0, fresnel_brightness: float | None = -0.43,
    fresnel_contrast: float = 0.1, darken: float = 0.2, height_scale: float = 0.05, softness: float = 0.0,
    rotation_centres: Sequence[Sequence[float]] = (), tilt: str | Tensor | None = None, tiles: bool | str = AUTO_TILES,
    storage: str = "paint8", seed: int = 0,
) -> Distribution:
    """Return the material that an evenly lit `picture` [3, H, W], linear and >= 0, suggests.

    Where nothing was measured brightness stands in: what is bright stands high (`height_scale`, the height of white in
    texture widths; 0 for a flat surface) and shines. `specular` names one map for each of `lobes` (see
    `specular_map`, or gives it as [3, S, S]), laid on the picture's `lobes` colours from dark to light, with `softness`
    Lab units of transition; 0 lobes leave the diffuse part alone. Mask and Fresnel's r0 are the luminance with
    brightness and contrast (None for the brightness: no such map); by default r0 is 0.02 to 0.12, as of what is no
    metal, and the mask the luminance itself. Diffuse is the picture less the share `darken`.
    `rotation_centres` (u, v) turn the lookup about them, `tilt` is a name or a curve [1, 1, 91]; without them there
    is no such map. `tiles` says whether it repeats, "auto" asks the picture (`tiling_of`). The codes of the textures span what each map can be (`storage` "paint8" and "paint16"), the height's
    from black to white. Raises RangeError or ShapeError, naming what does not fit. Liao 2011 darkens and adjusts 8-bit
    codes; here all is linear light, but for the height, which is taken from what people see.
    """
    check_picture(_WHERE, picture)
    picture = picture.detach().float()
    size = (picture.shape[1], picture.shape[2])
    check_tiles(_WHERE, tiles)
    repeats = tiling_of(picture[None]).repeats if tiles == AUTO_TILES else bool(tiles)
    shapes = _specular(specular, lobes)
    grey = colour.luminance(picture)[None]
    maps = {"diffuse": darkened(picture, darken)}
    if lobes > 0:
        maps["specular"] = torch.cat(shapes)
        if mask_brightness is not None:
            maps["specular_mask"] = brightness_contrast(grey, mask_brightness, mask_contrast)
        if fresnel_brightness is not None:
            maps["fresnel"] = brightness_contrast(grey, fresnel_brightness, fresnel_contrast)
    if lobes > 1:
        with phase("finding colours"):
            maps["index"] = segments(picture, lobes, softness=softness, seed=seed)
    if len(rotation_centres):
        maps["rotation"] = draw_360(size, rotation_centres)
    if tilt is not None:
        maps["tilt"] = tilt_curve(tilt) if isinstance(tilt, str) else tilt
    stored = {}
    if height_scale != 0:
        shown = colour.display(picture)
        maps["height"] = relief_from_picture(shown, height_scale, tiles=repeats).height
        stored["height"] = black_to_white(colour.luminance(shown), height_scale)
    return assemble(maps, lobes, repeats, storage, stored)


def black_to_white(share: Tensor, height_scale: float) -> StoredAs:
    """Return how to store a height of zero mean that is `height_scale` times `share` (0 to 1): from black to white."""
    black = float(-(share * height_scale).mean())
    return StoredAs(span=(black, black + height_scale))


def assemble(
    maps: dict[str, Tensor], lobes: int, tiles: bool, storage: str, stored: Mapping[str, StoredAs] | None = None
) -> Distribution:
    """Return the material of these maps; its optional parts are those that are there."""
    always = ("diffuse", "index", "specular", "height", "opacity")
    channels = len(maps["specular_mask"]) if "specular_mask" in maps else 1
    parts = [name for name in maps if name not in always]
    return Distribution(
        maps, lobes=lobes, parts=parts, mask_channels=channels, tiles=tiles, storage=storage, stored=stored
    )


def _specular(specular: Sequence[str | Tensor], lobes: int) -> list[Tensor]:
    """Return the specular maps [3, S, S], one for each lobe."""
    if isinstance(specular, str):
        specular = (specular,)
    if len(specular) != lobes:
        fact = f"there are {len(specular)} for {lobes} lobes"
        raise ShapeError(message(_WHERE, "specular", "name one map for each lobe", fact, "Name as many as lobes."))
    found = [specular_map(one) if isinstance(one, str) else one for one in specular]
    for number, one in enumerate(found):
        if one.ndim != 3 or one.shape[0] != 3 or one.shape != found[0].shape:
            fact = f"map {number} is {tuple(one.shape)}, map 0 is {tuple(found[0].shape)}"
            raise ShapeError(message(_WHERE, "specular", "be [3, S, S], all of one size", fact))
    return found
