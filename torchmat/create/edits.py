"""What an artist does to a material that exists, by the controls that made it: one small function an edit, and a table.

Each takes a material and returns another one; what an edit does not name keeps its bits. Materials are never changed in
place. Pictures of the material itself stand for the picture that it was made of: diffuse for colours and brightness.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from torchmat import colour, safe
from torchmat.create.controls import brightness_contrast, darkened, draw_360, segments
from torchmat.create.specular_maps import specular_map, tilt_curve, tilt_through
from torchmat.errors import RangeError, ShapeError, check_known_keys, check_option, message
from torchmat.geometry import relief_from_picture, slopes_from_height, slopes_from_normals
from torchmat.geometry.normals import check_height_scale, normals_from_slopes
from torchmat.geometry.rays import texel_centres
from torchmat.models import Distribution, Material
from torchmat.models.edit import add_part, drop_part, replace_map, with_options
from torchmat.models.storage import StoredAs

OF_DIFFUSE, OF_ITSELF = SOURCES = ("diffuse", "itself")
KEEP = "keep"
_MOST_STRENGTH = 8.0
_USUAL = "glossy"


def _artists(where: str, material: Material) -> Distribution:
    if isinstance(material, Distribution):
        return material
    step = "Only the distribution material has such a map."
    raise RangeError(message(where, "the material", "be a distribution material", f"it is {material.name}", step))


def _with_part(material: Distribution, name: str, value: Tensor) -> Distribution:
    return (replace_map if name in material.maps else add_part)(material, name, value.to(material.dtype))


def height_scale(material: Material, scale: float) -> Material:
    """Return the material with a height of `scale` texture widths from black to white; 0 makes it flat.

    Black and white are those of the stored height (`StoredAs.span`), else the lowest and the highest place. A flat
    material gets the brightness of its diffuse map for a height, as one made of a picture does.
    """
    if scale == 0:
        return material.without_relief()
    check_height_scale("height_scale", scale)
    if not material.has_relief:
        shown = colour.display(_artists("height_scale", material).maps["diffuse"].detach())
        height = relief_from_picture(shown, scale, tiles=material.tiles).height
        low = float(-(colour.luminance(shown) * scale).mean())
        return material.on_relief(height).stored_at({"height": StoredAs(span=(low, low + scale))})
    height = material.maps["height"].detach()
    stored = material.stored.get("height", StoredAs())
    low, high = stored.span or (float(height.min()), float(height.max()))
    if low == high:
        step = "Paint one, or remove it with 0 and make it again."
        raise RangeError(message("height_scale", "the height", "rise somewhere", f"it is {low} everywhere", step))
    factor = scale / (high - low)
    scaled = StoredAs(stored.size, stored.storage, (low * factor, high * factor))
    return material.with_maps(height=height * factor).stored_at({"height": scaled})


def normal_strength(material: Material, strength: float) -> Distribution:
    """Return the material with all slopes that it is shaded with times `strength`, above 0 to 8; 1 leaves them.

    The height, with its parallax and shadows, stays: what the slopes then are more or less goes into the normal map.
    """
    material = _artists("normal_strength", material)
    if not 0 < strength <= _MOST_STRENGTH:
        requirement = f"lie above 0 and up to {_MOST_STRENGTH:g}"
        raise RangeError(message("normal_strength", "strength", requirement, f"it is {strength}", "1 leaves the normals."))
    size, flat = material.size, torch.zeros(2, *material.size, dtype=material.dtype)
    own = flat
    if "normal" in material.maps:
        own = slopes_from_normals(safe.normalise(material.maps["normal"].detach()))
    elif not material.has_relief:
        step = "Give it a height first (height_scale)."
        raise RangeError(message("normal_strength", "the material", "have a height or normals", f"it is flat, {size}", step))
    raised = slopes_from_height(material.maps["height"].detach(), tiles=material.tiles) if material.has_relief else flat
    if strength == 1:
        return material
    return _with_part(material, "normal", normals_from_slopes((raised + own) * strength - raised))


def _brightness(where: str, material: Distribution, name: str, source: str) -> Tensor:
    """Return what brightness and contrast are applied to, [1 or 3, H, W]."""
    check_option(where, "source", source, SOURCES)
    if source == OF_DIFFUSE:
        return colour.luminance(material.maps["diffuse"].detach())[None]
    if name not in material.maps:
        step = f"Use the {OF_DIFFUSE} map as its source."
        raise RangeError(message(where, "the material", f"have a {name}", "it has none", step))
    return material.maps[name].detach()


def mask(material: Material, brightness: float = 0.0, contrast: float = 1.0, source: str = OF_DIFFUSE) -> Distribution:
    """Return the material with brightness and contrast of the diffuse luminance (or of `source` "itself") for its mask.

    0 and 1 leave them as they are; see `controls.brightness_contrast`.
    """
    material = _artists("mask", material)
    found = brightness_contrast(_brightness("mask", material, "specular_mask", source), brightness, contrast)
    channels = len(material.maps["specular_mask"]) if "specular_mask" in material.maps else len(found)
    return _with_part(material, "specular_mask", found.expand(channels, *material.size).contiguous())


def fresnel(material: Material, brightness: float = -0.43, contrast: float = 0.1, source: str = OF_DIFFUSE) -> Distribution:
    """Return the material with brightness and contrast of the diffuse luminance (or of `source` "itself") for its r0.

    As they stand here they give 0.02 to 0.12, as of what is no metal.
    """
    material = _artists("fresnel", material)
    return _with_part(
        material, "fresnel", brightness_contrast(_brightness("fresnel", material, "fresnel", source), brightness, contrast)
    )


def darken(material: Material, share: float) -> Distribution:
    """Return the material with its diffuse map less the share `share` of its light, 0 to 1."""
    material = _artists("darken", material)
    return replace_map(material, "diffuse", darkened(material.maps["diffuse"].detach(), share))


def tilt(material: Material, curve: str | Tensor | Sequence[Sequence[float]]) -> Distribution:
    """Return the material with another tilt curve.

    `curve` is a name (`specular_maps.TILTS`), points (degrees, tilt) or a text of them, or the curve itself, [1, 1, 91].
    It takes the place of Smith's masking, if the material has that.
    """
    material = _artists("tilt", material)
    material = drop_part(material, "masking") if "masking" in material.maps else material
    if isinstance(curve, str):
        curve = tilt_curve(curve)
    elif not isinstance(curve, Tensor):
        curve = tilt_through(curve)
    return _with_part(material, "tilt", curve)


def rotation(
    material: Material, centres: Sequence[Sequence[float]] = (), region: Sequence[float] | Tensor | None = None
) -> Distribution:
    """Return the material with a specular lookup that runs round its centres ("draw 360"), in a region or everywhere.

    `centres` are texture coordinates (u, v), 0 to 1 and v up; none means the middle of the region. `region` is (left,
    bottom, right, top) in them, or weights [1, H, W] of which 0.5 and more are within; outside of it the rotation stays.
    """
    material = _artists("rotation", material)
    within = _within(material.size, region)
    if not len(centres):
        place = texel_centres(*material.size)[:, within]
        centres = [tuple(((place.amin(dim=1) + place.amax(dim=1)) / 2).tolist())]
    drawn = draw_360(material.size, centres).to(material.dtype)
    if "rotation" in material.maps:
        before = material.maps["rotation"].detach()
    else:
        before = torch.zeros_like(drawn)
        before[0] = 1
    return _with_part(material, "rotation", torch.where(within, drawn, before))


def _within(size: tuple[int, int], region: Sequence[float] | Tensor | None) -> Tensor:
    """Return which texels [H, W] lie in a region."""
    if region is None:
        return torch.ones(size, dtype=torch.bool)
    if isinstance(region, Tensor):
        if tuple(region.shape) != (1, *size):
            raise ShapeError(message("rotation", "region", f"be [1, {size[0]}, {size[1]}]", f"it is {tuple(region.shape)}"))
        found = region[0] >= 0.5
    else:
        if len(region) != 4 or not all(math.isfinite(number) for number in region):
            fact = f"it is {tuple(region)}"
            raise RangeError(message("rotation", "region", "be left, bottom, right and top", fact, "u and v from 0 to 1."))
        left, bottom, right, top = region
        u, v = texel_centres(*size)
        found = (u >= left) & (u <= right) & (v >= bottom) & (v <= top)
    if not bool(found.any()):
        step = "Left is less than right, and bottom less than top."
        raise RangeError(message("rotation", "region", "hold at least one texel", "it holds none", step))
    return found


def specular(material: Material, maps: Sequence[str | Tensor]) -> Distribution:
    """Return the material with other specular maps: one for each that it has, by name with controls, or [3, S, S].

    "keep" leaves one as it is. Named maps have the size of those that are there, unless they say another.
    """
    material = _artists("specular", material)
    lobes = material.options["lobes"]
    maps = (maps,) if isinstance(maps, (str, Tensor)) else maps
    if len(maps) != lobes:
        step = "Name as many, with keep for those that stay; index makes them more or fewer."
        raise ShapeError(message("specular", "maps", f"be {lobes}, as the material has", f"there are {len(maps)}", step))
    before = material.maps["specular"].detach().split(3) if lobes else ()
    found = [_specular(one, old, material.specular_spacing) for one, old in zip(maps, before, strict=True)]
    for number, one in enumerate(found):
        if one.ndim != 3 or one.shape[0] != 3 or one.shape != found[0].shape:
            fact = f"map {number} is {tuple(one.shape)}, map 0 is {tuple(found[0].shape)}"
            raise ShapeError(message("specular", "maps", "be [3, S, S], all of one size", fact))
    return replace_map(material, "specular", torch.cat(found).to(material.dtype)) if found else material


def _specular(one: str | Tensor, old: Tensor, spacing: str) -> Tensor:
    if isinstance(one, Tensor):
        return one.to(old.dtype)
    return old if one == KEEP else specular_map(one, old.shape[-1], spacing).to(old.dtype)


def index(material: Material, lobes: int | None = None, softness: float = 0.0, seed: int = 0) -> Distribution:
    """Return the material with its specular maps laid on the `lobes` colours of its diffuse map, from dark to light.

    None leaves their number. Of fewer the first stay, of more the last one is repeated, or "glossy" where there was none.
    `softness` are the Lab units over which colours pass into each other.
    """
    material = _artists("index", material)
    before = material.options["lobes"]
    lobes = before if lobes is None else lobes
    weights = segments(material.maps["diffuse"].detach(), lobes, softness=softness, seed=seed)
    maps = {name: value.detach() for name, value in material.maps.items() if name != "index"}
    shapes = maps["specular"].split(3) if before else (specular_map(_USUAL, spacing=material.specular_spacing).to(material.dtype),)
    maps["specular"] = torch.cat([shapes[min(number, len(shapes) - 1)] for number in range(lobes)])
    if lobes > 1:
        maps["index"] = weights.to(material.dtype)
    return with_options(material, maps, lobes=lobes)


def without(material: Material, part: str) -> Distribution:
    """Return the material without one of its optional maps, which then costs and changes nothing."""
    return drop_part(_artists("without", material), part)


def tiles(material: Material, repeats: bool) -> Material:
    """Return the material, repeating at its borders or not."""
    return material.repeating(repeats)


EDITS: dict[str, Callable[..., Material]] = {
    "index": index, "specular": specular, "height_scale": height_scale, "normal_strength": normal_strength, "mask": mask,
    "fresnel": fresnel, "darken": darken, "tilt": tilt, "rotation": rotation, "without": without, "tiles": tiles,
}


def edited(material: Material, edits: Mapping[str, Mapping[str, Any]]) -> Material:
    """Return the material after several edits, in the order of EDITS: ``edited(material, {"mask": {"contrast": 1.5}})``.

    Mask and Fresnel see the diffuse map that is there before it is darkened. Raises RangeError for an edit that does not
    exist, and what each edit raises.
    """
    check_known_keys("edited", edits, EDITS)
    for name, change in EDITS.items():
        if name in edits:
            material = change(material, **edits[name])
    return material
