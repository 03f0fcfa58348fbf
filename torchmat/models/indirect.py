"""Light that reaches a texel by way of others: a map of it, or the radiosity of the relief.

A map, `ambient`, holds what a texel sends in shadow; what it sends falls with the light's cosine as far as `ambient_falloff`
says, for the texels around it get less of a low light too. Without a map, `indirect` is a factor on what the relief and the
diffuse colour tell by themselves: two bounces between texels that see each other (Goral et al. 1984), brought into nine
hemispherical harmonics of the light so that any light, one for each pixel too, is a sum (Sloan et al. 2002).
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import torch
import torch.nn.functional as functional
from torch import Tensor, nn

from torchmat import frames
from torchmat.errors import RangeError, message
from torchmat.geometry.form_factors import form_factors
from torchmat.geometry.normals import normals_from_slopes, slopes_from_height
from torchmat.geometry.rays import soft_shadow
from torchmat.models.bases import BASES
from torchmat.models.storage import MapSpec
from torchmat.repeatable import one_thread, wide_product

AMBIENT = MapSpec("ambient", "light by way of other texels, for a light of 1", low=0.0, colour=True, linear=True)
# How much of the ambient light goes with the cosine of the light.
FALLOFF = MapSpec(
    "ambient_falloff", "share of the ambient light that falls with the light's cosine", layer_channels=1, low=0.0, high=1.0,
    constant=True,
)
INDIRECT = MapSpec(
    "indirect", "factor on the light between texels that relief and diffuse colour tell", layer_channels=1, low=0.0, constant=True,
)
BETWEEN_MAPS = (AMBIENT, FALLOFF, INDIRECT)
BETWEEN = tuple(spec.name for spec in BETWEEN_MAPS)
_BASIS = BASES["hsh9"]
_LIGHTS, _LOWEST = 48, 0.08  # that the harmonics are fitted to, and the cosine of the lowest
_BOUNCES = 2
_MOST_TEXELS = 96 * 96  # light between texels is smooth: larger reliefs are seen smaller


class Between(NamedTuple):
    """What texels send by way of others: `value` [3, H, W] for all lights times `share` [n, 1, 1, 1], or [n, 3, H, W] of each."""

    value: Tensor
    share: Tensor | None = None

    def whole(self) -> Tensor:
        """Return it for each light, [n or nothing, 3, H, W]."""
        return self.value if self.share is None else self.value * self.share


def check_between(name: str, maps: Mapping[str, Tensor], diffuse: str | None) -> None:
    """Raise RangeError unless what lies between texels fits the other maps of the material `name`."""
    where = f"{name} maps"
    if FALLOFF.name in maps and AMBIENT.name not in maps:
        step = "Leave the falloff out, or give an ambient map."
        raise RangeError(message(where, FALLOFF.name, "come with an ambient map", "there is none", step))
    if INDIRECT.name not in maps:
        return
    if AMBIENT.name in maps:
        step = "Leave one of them out."
        raise RangeError(message(where, INDIRECT.name, "stand in the place of an ambient map", "both are there", step))
    if "height" not in maps or diffuse is None:
        fact = "it has no height" if diffuse is not None else f"{name} has no diffuse colour to send it"
        step = "Give an ambient map, or neither."
        raise RangeError(message(where, INDIRECT.name, "have a relief of diffuse colours", fact, step))


def between(material: Any, light: Tensor, maps: Mapping[str, Tensor] | nn.ParameterDict | None = None) -> Between | None:
    """Return what the texels of a material send of lights [n, 3, 1, 1] above the horizon by way of others; None for nothing.

    `maps` stand in the place of the material's own; the light that arrives stays that between the material's texels.
    """
    maps = material.maps if maps is None else maps
    if AMBIENT.name in maps:
        return Between(maps[AMBIENT.name], share_of(maps, light))
    if INDIRECT.name in maps:
        return Between(maps[INDIRECT.name][:, None, None] * maps[material.diffuse_map] * arriving(transfer_of(material), light))
    return None


def share_of(maps: Mapping[str, Tensor] | nn.ParameterDict, light: Tensor) -> Tensor | None:
    """Return how much of the ambient light there is under lights [..., 3, h, w], [..., 1, h, w]; None for all of it."""
    if FALLOFF.name not in maps:
        return None
    share = maps[FALLOFF.name][:, None, None]
    return 1 - share + share * light[..., 2:3, :, :].clamp(min=0)


def arriving(transfer: Tensor, light: Tensor) -> Tensor:
    """Return what arrives by way of other texels, [..., 3, H, W], of lights [..., 3, h, w]; `transfer` is [9, 3, H, W]."""
    weights = _BASIS.evaluate(light, light)
    if weights.shape[-2:] == (1, 1):
        flat = wide_product(weights.reshape(-1, len(transfer)), transfer.flatten(1))
        return flat.reshape(*weights.shape[:-3], *transfer.shape[1:]).clamp(min=0)
    return (weights[..., :, None, :, :] * transfer).sum(dim=-4).clamp(min=0)


def transfer_of(material: Any) -> Tensor:
    """Return the `transfer` [9, 3, H, W] of a material, kept until its height or its colours are others."""
    height, diffuse = (material.maps[name].detach() for name in ("height", material.diffuse_map))
    if height.is_inference() or diffuse.is_inference():
        return transfer(height, diffuse, material.tiles)
    marks = [(one._version, one.data_ptr(), one.dtype, one.shape) for one in (height, diffuse)]
    kept = material.__dict__.get("_kept_transfer")
    if kept is None or kept[0] != marks:
        # The tensors are kept as well: else their place in memory could be another's.
        found = _TRANSFERS.of((height, diffuse), lambda: transfer(height, diffuse, material.tiles), material.tiles)
        kept = (marks, found, height, diffuse)
        material.__dict__["_kept_transfer"] = kept
    return kept[1]


class _Kept:
    """What was made of tensors lately, by what these hold: materials that differ in other maps share it."""

    def __init__(self, most: int) -> None:
        self.most, self.found = most, dict[tuple[Any, ...], Any]()

    def of(self, tensors: tuple[Tensor, ...], make: Callable[[], Any], *more: object) -> Any:
        """Return what `make` makes of the tensors, or what it made of the same before."""
        digests = [hashlib.blake2b(one.detach().contiguous().numpy().tobytes(), digest_size=16).digest() for one in tensors]
        key = (*digests, *(tuple(one.shape) for one in tensors), *(one.dtype for one in tensors), *more)
        if key not in self.found:
            while len(self.found) >= self.most:
                self.found.pop(next(iter(self.found)))
            self.found[key] = make()
        return self.found[key]


_FACTORS, _TRANSFERS = _Kept(2), _Kept(4)


@torch.no_grad()
def transfer(height: Tensor, diffuse: Tensor, tiles: bool) -> Tensor:
    """Return how much light arrives at each texel by way of others, for each harmonic of the light, [9, 3, H, W].

    Args:
        height: [1, H, W] in texture widths.
        diffuse: colours [3, H, W] of the texels; above 1 they count as 1, for no surface sends more than it gets.
        tiles: whether the relief repeats.
    """
    planes = small_transfer(height, diffuse, tiles)
    if planes.shape[-2:] == height.shape[-2:]:
        return planes
    size = (height.shape[-2], height.shape[-1])
    return functional.interpolate(planes, size=size, mode="bilinear", align_corners=False).contiguous()


@torch.no_grad()
def small_transfer(height: Tensor, diffuse: Tensor, tiles: bool) -> Tensor:
    """Return the `transfer` at the resolution at which texels are told to see each other, [9, 3, h, w]."""
    height, diffuse = _smaller(height), _smaller(diffuse.clamp(0, 1))
    with one_thread():
        factors = _FACTORS.of((height,), lambda: form_factors(height, tiles), tiles)
        light = _lights(height.dtype)
        cosine = (normals_from_slopes(slopes_from_height(height, tiles=tiles)) * light).sum(dim=1, keepdim=True).clamp(min=0)
        direct = soft_shadow(height, light, tiles=tiles) * cosine  # [l, 1, h, w]
        white = diffuse.flatten(1).T  # [texel, 3]
        sent = white[:, None] * direct.flatten(1).T[:, :, None]  # [texel, l, 3]
        total = torch.zeros_like(sent)
        for _ in range(_BOUNCES):
            arrived = (factors @ sent.flatten(1)).reshape(sent.shape)
            total, sent = total + arrived, white[:, None] * arrived
        terms = _BASIS.evaluate(light, light)[:, :, 0, 0]
        found = torch.linalg.pinv(terms.double()).to(height.dtype) @ total.movedim(1, 0).flatten(1)
    return found.reshape(len(found), -1, 3).movedim(-1, 1).unflatten(-1, height.shape[-2:]).contiguous()


def _smaller(value: Tensor) -> Tensor:
    """Return a map at the resolution at which texels are told to see each other."""
    rows, columns = value.shape[-2:]
    shrink = math.sqrt(rows * columns / _MOST_TEXELS)
    if shrink <= 1:
        return value
    size = (max(1, round(rows / shrink)), max(1, round(columns / shrink)))
    return functional.adaptive_avg_pool2d(value[None], size)[0]


def _lights(dtype: torch.dtype) -> Tensor:
    """Return lights [l, 3, 1, 1] that fill the hemisphere evenly."""
    return frames.spiral(_LIGHTS, _LOWEST)[:, :, None, None].to(dtype)


def as_ambient(material: Any) -> Any:
    """Return the material with a map in the place of its radiosity: the best for lights all over the hemisphere, with a falloff."""
    if INDIRECT.name not in material.maps:
        return material
    with torch.no_grad():
        light = _lights(material.dtype)
        sent = between(material, light)
        assert sent is not None
        cosine = light[:, 2, 0, 0].double()
        design = torch.stack((torch.ones_like(cosine), cosine), dim=1)
        constant, rising = (torch.linalg.pinv(design) @ sent.value.double().mean(dim=(1, 2, 3))).tolist()
        share = min(max(rising / max(constant + rising, 1e-12), 0.0), 1.0)
        weight = 1 - share + share * cosine
        ambient = torch.einsum("l,lchw->chw", (weight / weight.square().sum()).to(material.dtype), sent.value)
    bare = material.on_relief(material.maps["height"].detach(), ambient.clamp(min=0))
    return bare.with_maps(**{FALLOFF.name: torch.tensor([share], dtype=material.dtype)})


def told_alike(first: Any, second: Any) -> tuple[Any, Any]:
    """Return two materials that tell the light between texels in one way: where only one does it by radiosity, by maps."""
    if (INDIRECT.name in first.maps) != (INDIRECT.name in second.maps):
        first, second = as_ambient(first), as_ambient(second)
    falls = [FALLOFF.name in one.maps for one in (first, second)]
    if any(falls):
        nothing = torch.zeros(1, dtype=first.dtype)
        first, second = (
            one.with_maps(**{FALLOFF.name: nothing}) if AMBIENT.name in one.maps and not has else one
            for one, has in zip((first, second), falls, strict=True)
        )
    return first, second
