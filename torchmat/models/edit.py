"""What an artist changes in a finished material: another picture for a map, another size, a part more or less.

Materials are never changed in place: each function returns a new one.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import torch
from torch import Tensor

from torchmat import safe
from torchmat.errors import RangeError, ShapeError, check_finite, check_known_keys, check_option, message
from torchmat.models.base import Material
from torchmat.models.distribution import DISTRIBUTION_PARTS, Distribution, default_tilt
from torchmat.models.resample import ANY_SIZE, FILTERS, VECTORS, resample, resample_map
from torchmat.models.storage import MapSpec, check_map

__all__ = [
    "FILTERS", "VECTORS", "add_part", "drop_part", "neutral_part", "replace_map", "resample", "resampled", "resized",
    "with_options",
    "without_idle_parts",
]
_Edited = TypeVar("_Edited", bound=Material)


def resized(material: _Edited, size: tuple[int, int], filter: str = "bilinear") -> _Edited:
    """Return `material` with maps of `size` (height, width) texels; tables that all texels share stay as they are."""
    if min(size) < 1:
        raise RangeError(message("resized", "size", "be two positive numbers", f"it is {tuple(size)}"))
    changed = {
        spec.name: resample_map(spec, material.maps[spec.name].detach(), (size[0], size[1]), filter, material.tiles)
        for spec in material.specs() if spec.per_texel and not spec.constant
    }
    small = {
        name: replace(one, size=(min(one.size[0], size[0]), min(one.size[1], size[1])))
        for name, one in material.stored.items() if one.size is not None
    }
    return material.stored_at(dict.fromkeys(small)).with_maps(**changed).stored_at(small)


def replace_map(
    material: _Edited, name: str, value: Tensor, filter: str = "bilinear", normalise_index: bool = True
) -> _Edited:
    """Return `material` with the map `name` replaced by `value` [C, h, w], brought to the material's size.

    `filter` is "bilinear", "nearest" or "area" (see `resample`). Normals and rotations become unit vectors. The weights
    `index` of the distribution material are divided by their sum; `normalise_index` False leaves them, so that two
    specular maps may both count in full (Liao 2011, fig. 4.17). Tables that all texels share are never resampled: they
    keep their shape, only the specular maps may have another side. A map that was stored small is stored in full again.
    Raises RangeError for an unknown map and for values that are not finite or leave its range, ShapeError for a wrong
    number of channels.
    """
    spec = _spec_of(material, name)
    value = _checked(material, spec, value).to(material.dtype)
    if spec.constant or not spec.per_texel:
        return material.with_maps(**{name: value})
    if name in VECTORS:
        value = _as_directions(name, value)
    elif name == "index" and normalise_index:
        value = _as_weights(value)
    if name in material.stored:
        material = material.stored_at({name: replace(material.stored[name], size=None)})
    return material.with_maps(**{name: resample_map(spec, value, material.size, filter, material.tiles)})


def _spec_of(material: Material, name: str) -> MapSpec:
    specs = {spec.name: spec for spec in material.specs()}
    step = ""
    if name in ("height", "ambient"):
        step = "Use material.on_relief(height, ambient) to give it one."
    elif name in ("indirect", "ambient_falloff"):
        step = "Use material.with_maps, or fit with indirect='radiosity' (an ambient map for the falloff)."
    elif name == "opacity":
        step = "Use material.with_maps(opacity=...) to give it one."
    elif isinstance(material, Distribution) and name in DISTRIBUTION_PARTS:
        step = f"Use add_part(material, {name!r}, value)."
    if name not in specs and step:
        raise RangeError(message("replace_map", "name", "be a map of the material", f"it has no {name}", step))
    check_known_keys("replace_map", [name], specs)
    return specs[name]


def _checked(material: Material, spec: MapSpec, value: Tensor) -> Tensor:
    """Return `value` if it can stand for the map, apart from its size."""
    if not isinstance(value, Tensor) or not value.is_floating_point():
        fact = f"it is {value.dtype if isinstance(value, Tensor) else type(value).__name__}"
        step = "Decode codes to values in the map's range first."
        raise RangeError(message("replace_map", spec.name, "be a floating-point tensor", fact, step))
    value, old = value.detach(), material.maps[spec.name]
    fits = value.ndim == old.ndim and value.shape[0] == spec.channels and 0 not in value.shape
    shape = f"[{spec.channels}]" if spec.constant else f"[{spec.channels}, h, w]"
    if not spec.constant and not spec.per_texel and spec.name not in ANY_SIZE:
        fits, shape = fits and value.shape == old.shape, f"{list(old.shape)}"
    if not fits:
        step = f"It is {spec.meaning}."
        raise ShapeError(message("replace_map", spec.name, f"be {shape}", f"it is {tuple(value.shape)}", step))
    check_finite("replace_map", spec.name, value, "Repair those values first: filtering would spread them.")
    check_map("replace_map", spec, value)
    return value


def _as_directions(name: str, value: Tensor) -> Tensor:
    """Return unit vectors; those that are so already keep their bits."""
    length = value.norm(dim=0, keepdim=True)
    if bool((length == 0).any()):
        first = tuple((length[0] == 0).nonzero()[0].tolist())
        fact = f"{int((length == 0).sum())} of {length.numel()} have length 0, first at texel {first}"
        raise RangeError(message("replace_map", name, "be directions", fact, "Give those texels a direction."))
    unit = (length - 1).abs() <= 4 * torch.finfo(value.dtype).eps
    return torch.where(unit, value, safe.normalise(value))


def _as_weights(value: Tensor) -> Tensor:
    """Return weights that sum to 1; those that do already keep their bits."""
    total = value.sum(dim=0, keepdim=True)
    if bool((total == 0).any()):
        first = tuple((total[0] == 0).nonzero()[0].tolist())
        fact = f"{int((total == 0).sum())} of {total.numel()} texels have none, first at {first}"
        step = "Give them a specular map, and hide it with specular_mask 0."
        raise RangeError(message("replace_map", "index", "give each texel a weight", fact, step))
    summed = (total - 1).abs() <= 4 * torch.finfo(value.dtype).eps
    return torch.where(summed, value, (value / total).clamp(max=1))


def neutral_part(material: Distribution, name: str, channels: int = 1) -> Tensor:
    """Return the map of a part that changes nothing: what the material shades as without it.

    Exactly so but for `tilt`, whose 91 samples are filtered linearly: its cosines are within 4e-5 of the true ones. Smith's
    `masking` takes the place of D and has no such value: raises RangeError.
    """
    check_option("neutral_part", "name", name, DISTRIBUTION_PARTS)
    if name == "masking":
        step = "Give its two numbers, as add_part(material, 'masking', value)."
        raise RangeError(message("neutral_part", "name", "be a part that can change nothing", "masking replaces D", step))
    if name == "tilt":
        return default_tilt(material.dtype)
    values = {"normal": (0.0, 0.0, 1.0), "rotation": (1.0, 0.0), "fresnel": (1.0,), "specular_mask": (1.0,) * channels}
    planes = torch.tensor(values[name], dtype=material.dtype)[:, None, None]
    return planes.expand(-1, *material.size).contiguous()


def add_part(material: Distribution, name: str, value: Tensor | None = None, filter: str = "bilinear") -> Distribution:
    """Return a distribution material with one more part, of `value` or else of the value that changes nothing.

    A specular mask may have 1 or 3 channels. Raises RangeError when the part is there already, and what `replace_map`
    raises for the value.
    """
    _check_part("add_part", material, name)
    if name in material.options["parts"]:
        step = "Use replace_map to change it."
        raise RangeError(message("add_part", "name", "be a part that is not there", f"{name} is", step))
    channels = material.options["mask_channels"]
    if name == "specular_mask" and isinstance(value, Tensor) and value.ndim == 3 and value.shape[0] in (1, 3):
        channels = value.shape[0]
    given = name == "masking" and value is not None  # no value of it changes nothing
    maps = {**material.maps, name: torch.ones(2, dtype=material.dtype) if given else neutral_part(material, name, channels)}
    changed = with_options(material, maps, parts=[*material.options["parts"], name], mask_channels=channels)
    return changed if value is None else replace_map(changed, name, value, filter)


def drop_part(material: Distribution, name: str) -> Distribution:
    """Return a distribution material without one of its parts, which costs nothing then and changes nothing.

    Without `masking` or `tilt` its denominator is D as printed.
    """
    _check_part("drop_part", material, name)
    parts = material.options["parts"]
    if name not in parts:
        fact = f"{name} is not; the material has {', '.join(parts) or 'none'}"
        raise RangeError(message("drop_part", "name", "be a part that is there", fact))
    maps = {key: value for key, value in material.maps.items() if key != name}
    return with_options(material, maps, parts=[part for part in parts if part != name])


def without_idle_parts(material: Distribution) -> Distribution:
    """Return a distribution material without the parts that are stored as one number and can be done without.

    A mask, and an index, that are the same everywhere are multiplied into the specular maps; a normal that is the same
    everywhere is left out, and with it a lean of the whole surface, if there was one.
    """
    idle = [name for name, one in material.stored.items() if one.numbers]
    exported = material.as_exported().maps
    maps = {**material.maps, **{name: exported[name].detach().to(material.dtype) for name in idle}}
    lobes, parts = material.options["lobes"], list(material.options["parts"])
    if "specular_mask" in idle and lobes:
        maps["specular"] = maps["specular"] * maps.pop("specular_mask")[:, :1, :1].expand(3, 1, 1).repeat(lobes, 1, 1)
    if "index" in idle:
        weight = maps.pop("index")[:, :1, :1].repeat_interleave(3, dim=0)
        maps["specular"], lobes = (maps["specular"] * weight).unflatten(0, (lobes, 3)).sum(dim=0), 1
    if "normal" in idle:
        del maps["normal"]
    return with_options(material, maps, lobes=lobes, parts=[part for part in parts if part in maps])


def resampled(material: Material, size: tuple[int, int]) -> Material:
    """Return `material` with maps of `size` texels as `resized` filters them, through which gradients pass to its own.

    For pictures of it: nothing is checked, and it is not to be stored.
    """
    maps = {
        spec.name: resample_map(spec, material.maps[spec.name], size, tiles=material.tiles)
        if spec.per_texel and not spec.constant else material.maps[spec.name] for spec in material.specs()
    }
    return material._unchecked(maps)


def with_options(material: Distribution, maps: dict[str, Tensor], **options: object) -> Distribution:
    """Return a material of these maps with some options changed."""
    return Distribution(maps, **material.settings(maps), **{**material.options, **options})


def _check_part(where: str, material: Material, name: str) -> None:
    if not isinstance(material, Distribution):
        step = "Only the distribution material is made of parts."
        raise RangeError(message(where, "material", "be a distribution material", f"it is {material.name}", step))
    check_option(where, "name", name, DISTRIBUTION_PARTS)
