"""A material between two: every map interpolated, as one number or a map of weights says.

What linear interpolation of the shaded value would give is met exactly where the value is linear in what differs:
diffuse, ambient, and, with one normal, rotation and Fresnel, the specular colours under their masks. Angles and normals
turn on the way, Fresnel's r0 changes: there the result is a material in between, not a double exposure of two.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torchmat import safe
from torchmat.errors import RangeError, ShapeError, check_finite, message
from torchmat.geometry import normals_from_slopes, slopes_from_normals
from torchmat.models.base import Material
from torchmat.models.distribution import _MOST_LOBES, DISTRIBUTION_PARTS, Distribution
from torchmat.models.edit import neutral_part, resample, resized, with_options
from torchmat.models.indirect import FALLOFF, INDIRECT, told_alike
from torchmat.models.parabolic import DENSE, EVEN, respaced


def blend(first: Material, second: Material, weight: float | Tensor, filter: str = "bilinear") -> Material:
    """Return the material that is `first` where `weight` is 0, `second` where it is 1, and mixes them between.

    `weight` is a number in [0, 1] or a map [1, H, W] of `first`'s size. A `second` of another size is resampled with
    `filter`; tiling and storage are `first`'s, and a map is stored small where both have it so. Heights, colours and
    weights interpolate linearly (no height is 0), normals by their slopes, rotations as vectors. Two distribution
    materials may differ in parts, of which a missing one takes its neutral value, and in specular maps: those of both
    then stand side by side, and the index places them.
    The numbers 0 and 1 give the very maps of that material; in a map the texels of 0 and 1 shade as the material of
    that side does, as long as both are flat and neither the sides of their specular maps nor their tilt differ.
    Raises RangeError for two models, or options and tables that cannot be mixed, ShapeError for a map of another size.
    """
    weight = _as_weight(first, weight)
    _check_pair(first, second, weight)
    second = _like(second, first, filter)
    if weight.ndim == 0 and float(weight) in (0.0, 1.0):
        return first if float(weight) == 0 else second
    first, second = _spaced_alike(*told_alike(first, second))
    first = first.stored_at(dict.fromkeys(first.stored.keys() - _stored_alike(first, second, weight)))
    maps = _relief(first, second, weight)
    if isinstance(first, Distribution) and isinstance(second, Distribution):
        return _blend_distributions(first, second, weight, maps)
    for spec in first.own_specs():
        one, other = first.maps[spec.name].detach(), second.maps[spec.name].detach()
        if torch.equal(one, other):
            maps[spec.name] = one
            continue
        if spec.index or not (spec.per_texel or spec.constant):
            fact = f"their {spec.name} ({spec.meaning}) differ"
            step = "Fit both as 'distribution', whose maps can be mixed."
            raise RangeError(message("blend", "the materials", "share what cannot be mixed", fact, step))
        if spec.constant:
            _check_number(weight, spec.name)
        maps[spec.name] = _mix_vectors(spec.name, one, other, weight) if spec.name == "normal" else mix(one, other, weight)
    return type(first)(maps, **first.settings(maps), **first.options)


def _spaced_alike(first: Material, second: Material) -> tuple[Material, Material]:
    """Return two materials whose specular maps have their texels in the same places: where one's are dense, both's."""
    if not isinstance(first, Distribution) or not isinstance(second, Distribution):
        return first, second
    shining = [side.specular_spacing for side in (first, second) if side.options["lobes"]]
    wanted = DENSE if DENSE in shining else EVEN
    return _with_spacing(first, wanted), _with_spacing(second, wanted)


def _with_spacing(side: Distribution, spacing: str) -> Distribution:
    if side.specular_spacing == spacing:
        return side
    maps = {name: value.detach() for name, value in side.maps.items()}
    if "specular" in maps:
        maps["specular"] = respaced(maps["specular"], side.specular_spacing, spacing)
    return with_options(side, maps, specular_spacing=spacing)


def mix(one: Tensor, other: Tensor, weight: Tensor) -> Tensor:
    """Interpolate linearly: exact at both ends, and never outside what it interpolates (torch counts from the nearer)."""
    return torch.lerp(one, other, torch.broadcast_tensors(one, weight)[1])


def _mix_vectors(name: str, one: Tensor, other: Tensor, weight: Tensor) -> Tensor:
    """Interpolate normals by slopes and rotations as vectors; the ends keep their bits."""
    if name == "normal":
        slopes = [slopes_from_normals(safe.normalise(normal)) for normal in (one, other)]
        found = normals_from_slopes(mix(slopes[0], slopes[1], weight))
    else:
        found = mix(safe.normalise(one), safe.normalise(other), weight)
        # Halfway between opposite directions there is none: the nearer end stands in.
        lost = found.square().sum(dim=0, keepdim=True) < 1e-6
        found = safe.normalise(torch.where(lost, torch.where(weight < 0.5, one, other), found))
    return torch.where(weight == 0, one, torch.where(weight == 1, other, found))


def _check_pair(first: Material, second: Material, weight: Tensor) -> None:
    if type(first) is not type(second):
        fact = f"they are {first.name} and {second.name}"
        step = "Fit both with the same model."
        raise RangeError(message("blend", "the materials", "be of one model", fact, step))
    if first.cutout != second.cutout:
        fact = f"they are {first.cutout} and {second.cutout}"
        raise RangeError(message("blend", "the materials", "cover the same part of a texture", fact))
    free = ("lobes", "parts", "mask_channels", "specular_spacing") if isinstance(first, Distribution) else ()
    if weight.ndim == 0 or not all("fresnel" in side.maps for side in (first, second)):
        free = (*free, "fresnel_exponent")  # a number lies between two others; a map of them has no place
    for name, value in first.options.items():
        if name not in free and second.options[name] != value:
            fact = f"{name} is {value!r} and {second.options[name]!r}"
            step = "Fit both with the same options."
            raise RangeError(message("blend", "the materials", "have the same options", fact, step))


def _as_weight(first: Material, weight: float | Tensor) -> Tensor:
    """Return the weight as a tensor, of no dimension or [1, H, W]."""
    if isinstance(weight, bool) or not isinstance(weight, (int, float, Tensor)):
        fact = f"it is {type(weight).__name__}"
        raise RangeError(message("blend", "weight", "be a number or a map [1, H, W]", fact))
    weight = torch.as_tensor(weight, dtype=first.dtype).detach()
    if weight.ndim and tuple(weight.shape) != (1, *first.size):
        fact = f"it is {tuple(weight.shape)}"
        step = "Resample it to the first material's size."
        raise ShapeError(message("blend", "weight", f"be a number or a map [1, {first.size[0]}, {first.size[1]}]", fact, step))
    check_finite("blend", "weight", weight)
    outside = (weight < 0) | (weight > 1)
    if bool(outside.any()):
        fact = f"{int(outside.sum())} of {weight.numel()} values are not, the first is {float(weight[outside][0]):.6g}"
        raise RangeError(message("blend", "weight", "lie in [0, 1]", fact, "0 is the first material, 1 the second."))
    return weight


def _stored_alike(first: Material, second: Material, weight: Tensor) -> set[str]:
    """Return the maps that both store in one way; a map of weights has detail of its own, which none is stored with."""
    return set() if weight.ndim else {name for name, one in first.stored.items() if second.stored.get(name) == one}


def _check_number(weight: Tensor, name: str) -> None:
    if weight.ndim:
        fact = f"it is a map, and {name} differs, which all texels share"
        raise RangeError(message("blend", "weight", "be a number", fact, f"Give both materials the same {name}."))


def _like(second: Material, first: Material, filter: str) -> Material:
    """Return `second` in the size, precision, tiling and storage of `first`; itself where nothing differs."""
    if second.size != first.size:
        second = resized(second, first.size, filter)
    if second.dtype != first.dtype:
        second = second.with_maps(**{name: value.to(first.dtype) for name, value in second.maps.items()})
    second = second if second.tiles == first.tiles else second.repeating(first.tiles)
    return second if second.storage == first.storage else second.stored_as(first.storage)


def _relief(first: Material, second: Material, weight: Tensor) -> dict[str, Tensor]:
    """Return height, ambient and opacity in between; what neither has is left out, what one lacks is 0, or opaque, there."""
    found = {}
    for name, channels, without in (("height", 1, 0.0), ("ambient", 3, 0.0), ("opacity", 1, 1.0)):
        if name not in first.maps and name not in second.maps:
            continue
        nothing = torch.full((channels, *first.size), without, dtype=first.dtype)
        one, other = (side.maps[name].detach() if name in side.maps else nothing for side in (first, second))
        found[name] = mix(one, other, weight)
    for name in (FALLOFF.name, INDIRECT.name):  # of all texels: in a map of weights those of the mean
        sides = [side.maps[name].detach() for side in (first, second) if name in side.maps]
        if sides:
            found[name] = mix(sides[0], sides[-1], weight.mean())
    return found


def _blend_distributions(
    first: Distribution, second: Distribution, weight: Tensor, maps: dict[str, Tensor]
) -> Distribution:
    maps["diffuse"] = mix(first.maps["diffuse"].detach(), second.maps["diffuse"].detach(), weight)
    present = {name for side in (first, second) for name in side.options["parts"]}
    dark = bool(first.options["lobes"]) != bool(second.options["lobes"])  # one has no specular: its mask is 0
    parts = [name for name in DISTRIBUTION_PARTS if name in present or (dark and name == "specular_mask")]
    masks = _masks(first, second)
    for name in parts:
        if name == "specular_mask":
            maps[name] = mix(masks[0], masks[1], weight)
            continue
        if name == "masking" and not all(name in side.maps for side in (first, second)):
            step = "Fit both with one denominator."
            fact = "one has Smith's masking, the other D"
            raise RangeError(message("blend", "the materials", "have one denominator", fact, step))
        one, other = (_part(side, name) for side in (first, second))
        if name in ("tilt", "masking") and not torch.equal(one, other):
            _check_number(weight, name)
        maps[name] = _mix_vectors(name, one, other, weight) if name in ("normal", "rotation") else mix(one, other, weight)
    lobes = _lobes(first, second, weight, masks, maps)
    return with_options(
        first, maps, lobes=lobes, parts=parts, mask_channels=len(masks[0]), fresnel_exponent=_rise(first, second, weight)
    )


def _rise(first: Distribution, second: Distribution, weight: Tensor) -> float:
    """Return the exponent of Fresnel's rise in between; that of the one side that has such a part."""
    found = [side.options["fresnel_exponent"] for side in (first, second) if "fresnel" in side.maps]
    if len(found) < 2 or found[0] == found[1]:
        return found[0] if found else first.options["fresnel_exponent"]
    return found[0] + float(weight) * (found[1] - found[0])


def _part(side: Distribution, name: str, channels: int = 1) -> Tensor:
    return side.maps[name].detach() if name in side.maps else neutral_part(side, name, channels)


def _masks(first: Distribution, second: Distribution) -> list[Tensor]:
    """Return both masks, of 3 channels if one has 3; 0 where there is nothing specular."""
    sides = (first, second)
    channels = max(side.maps["specular_mask"].shape[0] if "specular_mask" in side.maps else 1 for side in sides)
    found = []
    for side in sides:
        mask = _part(side, "specular_mask").expand(channels, -1, -1)
        found.append(mask if side.options["lobes"] or not any(s.options["lobes"] for s in sides) else torch.zeros_like(mask))
    return found


def _lobes(
    first: Distribution, second: Distribution, weight: Tensor, masks: list[Tensor], maps: dict[str, Tensor]
) -> int:
    """Put the specular maps and the index of the blend into `maps` and return how many lobes it has.

    The value holds mask * sum of index * specular. With the mask in between, m = (1 - w) m1 + w m2, index weights are
    scaled by (1 - w) m1 / m and w m2 / m: the product is then the mix of the two. A mask of three channels cannot be
    divided out of an index, which has one; the scales are 1 - w and w there.
    """
    sides = [side for side in (first, second) if side.options["lobes"]]
    if not sides:
        return 0
    tables, indices = zip(*((side.maps["specular"].detach(), _index(side)) for side in sides), strict=True)
    if len(sides) == 1:
        shared, index = tables[0], indices[0]
    else:
        one, other = ((1 - weight).expand(1, *first.size), weight.expand(1, *first.size))
        if len(masks[0]) == 1:
            between = mix(masks[0], masks[1], weight)
            there = between >= torch.finfo(between.dtype).tiny
            one = torch.where(there, safe.divide(one * masks[0], between), one)
            other = torch.where(there, safe.divide(other * masks[1], between), other)
        index = [indices[0] * one, indices[1] * other]
        same = torch.equal(*tables)
        shared = tables[0] if same else torch.cat(_of_one_side(tables))
        index = (sum(index) if same else torch.cat(index)).clamp(0, 1)  # the clamp meets rounding errors only
    lobes = len(shared) // 3
    if lobes > _MOST_LOBES:
        fact, step = f"they have {lobes}", "Fit one of them with fewer lobes."
        raise RangeError(message("blend", "the materials", f"have at most {_MOST_LOBES} specular maps together", fact, step))
    maps["specular"] = shared
    if lobes > 1:
        maps["index"] = index
    return lobes


def _index(side: Distribution) -> Tensor:
    return side.maps["index"].detach() if "index" in side.maps else torch.ones(1, *side.size, dtype=side.dtype)


def _of_one_side(tables: tuple[Tensor, ...]) -> list[Tensor]:
    """Return specular maps of one side, the larger: they do not tile."""
    side = max(table.shape[-1] for table in tables)
    return [resample(table, (side, side), tiles=False) for table in tables]
