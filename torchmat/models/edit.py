"""What an artist changes in a finished material: another picture for a map, another size, a part more or less.

Materials are never changed in place: each function returns a new one.
"""

from __future__ import annotations

import torch
import torch.nn.functional as functional
from torch import Tensor

from torchmat import safe
from torchmat.errors import RangeError, ShapeError, check_finite, check_known_keys, check_option, message
from torchmat.models.base import Material
from torchmat.models.distribution import DISTRIBUTION_PARTS, Distribution, default_tilt
from torchmat.models.storage import MapSpec, check_map

FILTERS = ("bilinear", "nearest", "area")
VECTORS = ("normal", "rotation")  # maps of directions: what is between two of them is a direction too
_ANY_SIZE = ("specular",)  # shared tables whose side is a matter of choice
_LEAST_LENGTH = 1e-3  # a shorter sum of unit vectors says nothing of the direction in between


def resample(value: Tensor, size: tuple[int, int], filter: str = "bilinear", tiles: bool = True) -> Tensor:
    """Return a map [C, h, w] as [C, H, W]; the same bits if it has that size.

    "bilinear" widens its triangle when it shrinks, so that nothing aliases; "area" is the mean of the texels that the
    new one touches; "nearest" invents no value. A map that tiles goes on around the corner, another with its border.
    """
    check_option("resample", "filter", filter, FILTERS)
    if value.shape[-2:] == size:
        return value
    if filter == "nearest":
        return functional.interpolate(value[None], size, mode="nearest-exact")[0]
    if filter == "area":
        found = functional.interpolate(value[None], size, mode="area")[0]
    else:
        found = _along(_along(value, size[0], -2, tiles), size[1], -1, tiles)
    # A mean lies between what it is of; weights that sum to 1.0000001 would put a map out of its range.
    return found.clamp(value.min(), value.max())


def _along(value: Tensor, length: int, dim: int, tiles: bool) -> Tensor:
    """Filter one dimension; what tiles is laid down three times and the middle is taken."""
    # Always along the last dimension: torch 2.13 copies one sample where it filters the rows of a map one texel wide.
    lines = value.movedim(dim, -1)
    wide = torch.cat([lines] * 3, dim=-1) if tiles else lines
    size = (lines.shape[-2], 3 * length if tiles else length)
    found = functional.interpolate(wide[None].contiguous(), size, mode="bilinear", antialias=True, align_corners=False)[0]
    return (found[..., length : 2 * length] if tiles else found).movedim(-1, dim).contiguous()


def resample_map(spec: MapSpec, value: Tensor, size: tuple[int, int], filter: str = "bilinear", tiles: bool = True) -> Tensor:
    """Return a map in another size, as what it is: directions stay unit vectors, whole numbers take the nearest."""
    found = resample(value, size, "nearest" if spec.index else filter, tiles)
    if spec.name not in VECTORS or found is value:
        return found
    short = found.norm(dim=0, keepdim=True) < _LEAST_LENGTH
    return safe.normalise(torch.where(short, resample(value, size, "nearest", tiles), found))


def resized(material: Material, size: tuple[int, int], filter: str = "bilinear") -> Material:
    """Return `material` with maps of `size` (height, width) texels; tables that all texels share stay as they are."""
    if min(size) < 1:
        raise RangeError(message("resized", "size", "be two positive numbers", f"it is {tuple(size)}"))
    changed = {
        spec.name: resample_map(spec, material.maps[spec.name].detach(), tuple(size), filter, material.tiles)
        for spec in material.specs() if spec.per_texel and not spec.constant
    }
    return material.with_maps(**changed)


def replace_map(
    material: Material, name: str, value: Tensor, filter: str = "bilinear", normalise_index: bool = True
) -> Material:
    """Return `material` with the map `name` replaced by `value` [C, h, w], brought to the material's size.

    `filter` is "bilinear", "nearest" or "area" (see `resample`). Normals and rotations become unit vectors. The weights
    `index` of the distribution material are divided by their sum; `normalise_index` False leaves them, so that two
    specular maps may both count in full (Liao 2011, fig. 4.17). Tables that all texels share are never resampled: they
    keep their shape, only the specular maps may have another side.
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
    return material.with_maps(**{name: resample_map(spec, value, material.size, filter, material.tiles)})


def _spec_of(material: Material, name: str) -> MapSpec:
    specs = {spec.name: spec for spec in material.specs()}
    step = ""
    if name in ("height", "ambient"):
        step = "Use material.on_relief(height, ambient) to give it one."
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
    if not spec.constant and not spec.per_texel and spec.name not in _ANY_SIZE:
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

    Exactly so but for `tilt`, whose 91 samples are filtered linearly: its cosines are within 4e-5 of the true ones.
    """
    check_option("neutral_part", "name", name, DISTRIBUTION_PARTS)
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
    maps = {**material.maps, name: neutral_part(material, name, channels)}
    changed = with_options(material, maps, parts=[*material.options["parts"], name], mask_channels=channels)
    return changed if value is None else replace_map(changed, name, value, filter)


def drop_part(material: Distribution, name: str) -> Distribution:
    """Return a distribution material without one of its parts, which costs nothing then and changes nothing."""
    _check_part("drop_part", material, name)
    parts = material.options["parts"]
    if name not in parts:
        fact = f"{name} is not; the material has {', '.join(parts) or 'none'}"
        raise RangeError(message("drop_part", "name", "be a part that is there", fact))
    maps = {key: value for key, value in material.maps.items() if key != name}
    return with_options(material, maps, parts=[part for part in parts if part != name])


def with_options(material: Distribution, maps: dict[str, Tensor], **options: object) -> Distribution:
    """Return a material of these maps with some options changed."""
    return Distribution(maps, storage=material.storage, tiles=material.tiles, **{**material.options, **options})


def _check_part(where: str, material: Material, name: str) -> None:
    if not isinstance(material, Distribution):
        step = "Only the distribution material is made of parts."
        raise RangeError(message(where, "material", "be a distribution material", f"it is {material.name}", step))
    check_option(where, "name", name, DISTRIBUTION_PARTS)
