"""How a map becomes the codes of a texture and comes back: the arithmetic, without any file.

A material predicts what its textures hold, so both the writer and `Material.as_exported` go through here.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchmat import colour
from torchmat.errors import RangeError, check_finite, check_known_keys, check_option, message
from torchmat.models.hue import directions_of, hue_of


@dataclass(frozen=True)
class Storage:
    """One way to store a texture: file suffix and type of its codes.

    `natural` codes are made to be painted: they span what the map can be rather than the values that occur, colours are
    sRGB-encoded in any depth, and a rotation is a hue.
    """

    suffix: str
    dtype: str
    natural: bool = False

    @property
    def bytes(self) -> int:
        """Bytes of one value."""
        return np.dtype(self.dtype).itemsize

    @property
    def levels(self) -> int | None:
        """The largest integer code; None for floating point."""
        return int(np.iinfo(self.dtype).max) if self.dtype.startswith("uint") else None


STORAGES = {
    "half": Storage(".exr", "float16"),
    "float": Storage(".exr", "float32"),
    "png8": Storage(".png", "uint8"),
    "png16": Storage(".png", "uint16"),
    "tiff8": Storage(".tif", "uint8"),
    "tiff16": Storage(".tif", "uint16"),
    "paint8": Storage(".png", "uint8", natural=True),
    "paint16": Storage(".png", "uint16", natural=True),
}


_BAND_VALUES = 1_000_000  # of a texture are made codes at a time: in double precision a large one would take gigabytes
KINDS = ("value", "normal", "rotation", "weights")


@dataclass(frozen=True)
class MapSpec:
    """What a map is.

    `layers` names its textures, each of `layer_channels` channels, so the map has their product; an empty tuple means
    one texture called like the map. `low` and `high` bound its values (None: unbounded); `fixed_range` says that
    integer codes span exactly low..high rather than the values that occur. `colour` marks linear RGB, which 8-bit
    textures hold sRGB-encoded. `index` marks whole numbers, always stored exactly and looked up without filtering.
    `per_texel` is False for tables shared by all texels, `constant` True for a handful of numbers that go into the
    manifest. `linear` says whether the shaded value is linear in the map. `storage` overrides the material's. `kind` is
    what the channels of a place are together, which decides what a descent may change (`models.unbounded`): a "value"
    each, a unit "normal", the cosine and sine of a "rotation", or "weights" that sum to 1. `fixed` says that a fit that
    goes on from a material leaves the map as it is.
    """

    name: str
    meaning: str
    layers: tuple[str, ...] = ()
    layer_channels: int = 3
    low: float | None = None
    high: float | None = None
    fixed_range: bool = False
    colour: bool = False
    index: bool = False
    per_texel: bool = True
    constant: bool = False
    linear: bool = False
    storage: str | None = None
    kind: str = "value"
    fixed: bool = False

    def __post_init__(self) -> None:
        check_option(f"the map {self.name}", "kind", self.kind, KINDS)

    @property
    def textures(self) -> tuple[str, ...]:
        """Names of the textures that hold the map."""
        return tuple(f"{self.name}_{layer}" for layer in self.layers) if self.layers else (self.name,)

    @property
    def fits_a_byte(self) -> bool:
        """Whether the largest value, of an index, is at most 255."""
        return self.high is not None and self.high <= 255

    @property
    def looks_coloured(self) -> bool:
        """Whether a paint program takes the map for a colour: linear RGB, or three channels that are never negative."""
        return self.colour or (self.layer_channels == 3 and self.low == 0)

    @property
    def channels(self) -> int:
        """Channels of the map: textures times channels of each."""
        return len(self.textures) * self.layer_channels


@dataclass(frozen=True)
class StoredAs:
    """How one map is stored, where it is not as the others are.

    `size` (height, width) in texels, no larger than the material; None is the full size, (1, 1) means numbers in the
    manifest instead of a texture. `storage` is a key of STORAGES; None is the material's, or what the map's spec says.
    `span` (low, high) are the values of black and white that integer codes reach to, at least: a height's, which no map
    can have by itself.
    """

    size: tuple[int, int] | None = None
    storage: str | None = None
    span: tuple[float, float] | None = None

    def as_table(self) -> dict[str, object]:
        """Return what a manifest holds."""
        table: dict[str, object] = {"size": self.size, "storage": self.storage}
        return table if self.span is None else {**table, "span": self.span}

    @property
    def numbers(self) -> bool:
        """Whether the map is a number for each channel."""
        return self.size == (1, 1)


def check_stored(where: str, stored: Mapping[str, StoredAs], specs: Iterable[MapSpec], size: tuple[int, int]) -> None:
    """Raise RangeError unless maps of `specs`, in a material of `size` texels, can be stored as said."""
    known = {spec.name: spec for spec in specs}
    check_known_keys(f"{where} stored", stored, known)
    for name, one in stored.items():
        spec = known[name]
        if not isinstance(one, StoredAs) or spec.constant:
            fact = f"it is {type(one).__name__}" if not isinstance(one, StoredAs) else "it is numbers already"
            raise RangeError(message(where, f"stored {name}", "be a StoredAs of a map that has textures", fact))
        if one.storage is not None:
            check_option(where, f"the storage of {name}", one.storage, STORAGES)
        if one.span is not None and not (len(one.span) == 2 and -math.inf < one.span[0] < one.span[1] < math.inf):
            requirement = "be two finite numbers, low and high"
            raise RangeError(message(where, f"the span of {name}", requirement, f"it is {one.span}"))
        if one.size is None:
            continue
        if not spec.per_texel:
            step = "Use stored_at, which resamples it, or leave its size out."
            raise RangeError(message(where, f"the size of {name}", "be its own", "all texels share it", step))
        whole = len(one.size) == 2 and all(isinstance(side, int) and not isinstance(side, bool) for side in one.size)
        if not whole or not all(1 <= side <= most for side, most in zip(one.size, size, strict=True)):
            requirement = f"lie in (1, 1) to ({size[0]}, {size[1]})"
            raise RangeError(message(where, f"the size of {name}", requirement, f"it is {one.size}"))


@dataclass(frozen=True)
class Codes:
    """One texture as codes: `pixels` [H, W, C], and the `low` and `high` [C] values of its smallest and largest code.

    Floating-point textures hold their values as they are; `low` and `high` are then empty. `transfer` is "linear",
    "srgb" (between low and high), or "hue": colours [H, W, 3] whose hues are the angles of a rotation.
    """

    pixels: np.ndarray
    low: tuple[float, ...] = ()
    high: tuple[float, ...] = ()
    transfer: str = "linear"


class StoredTexture(NamedTuple):
    """One texture of a material: `values` [C, h, w] of the map that `spec` declares, called `name`, to be stored as
    `storage` (a key of STORAGES)."""

    spec: MapSpec
    name: str
    values: Tensor
    storage: str
    span: tuple[float, float] | None = None

    @property
    def meaning(self) -> str:
        """What the map is, in words."""
        return self.spec.meaning

    @property
    def file(self) -> str:
        """What a material folder calls its file."""
        return self.name + (".png" if self.spec.index else STORAGES[self.storage].suffix)

    @property
    def range(self) -> tuple[float | None, float | None]:
        """The least and the largest value that the map may have; None is no bound."""
        return self.spec.low, self.spec.high

    @property
    def colour_space(self) -> str:
        """"linear" RGB of Rec. 709 primaries, or "data": numbers that no colour management may touch."""
        return "linear" if self.spec.colour else "data"

    def codes(self, storage: str | None = None) -> Codes:
        """Return the texture as codes with their range and transfer, in its own storage or another.

        Raises RangeError when it cannot be stored so.
        """
        return encode(self.spec, self.values, storage or self.storage, self.span)


def check_map(where: str, spec: MapSpec, value: Tensor) -> None:
    """Raise RangeError when `value` is not finite or leaves the declared range of `spec`."""
    value = value.detach()
    check_finite(where, spec.name, value)
    if spec.index and bool((value != value.round()).any()):
        fact = f"the first that is not is {float(value[value != value.round()][0]):.6g}"
        raise RangeError(message(where, spec.name, "hold whole numbers", fact, "It is an index, which cannot be mixed."))
    for bound, least in ((spec.low, True), (spec.high, False)):
        if bound is None or bool(value.min() >= bound if least else value.max() <= bound):
            continue
        outside = value < bound if least else value > bound
        fact = f"{int(outside.sum())} of {value.numel()} values are not, the first is {float(value[outside][0]):.6g}"
        ends = ["-inf" if spec.low is None else spec.low, "inf" if spec.high is None else spec.high]
        requirement = f"lie in [{ends[0]}, {ends[1]}]"
        raise RangeError(message(where, spec.name, requirement, fact, "Correct the map; it is never clipped."))


def encode(spec: MapSpec, value: Tensor, storage: str, span: tuple[float, float] | None = None) -> Codes:
    """Return the codes of one texture [C, H, W] of map `spec`; integer codes span at least `span`, if it is given.

    Raises RangeError outside the declared range, or beyond what a half can hold.
    """
    check_option("encode", "storage", storage, STORAGES)
    check_map("export", spec, value)
    kind = STORAGES[storage]
    value = value.detach()
    if spec.index:
        return Codes(value.double().round().permute(1, 2, 0).numpy().astype(np.uint8 if spec.fits_a_byte else np.uint16))
    if kind.levels is None:
        largest = max(abs(float(end)) for end in value.aminmax())
        # As a Python float: NumPy would round `largest` to a half before it compares.
        most = float(np.finfo(kind.dtype).max)
        if largest > most:
            step = "Divide it by a constant." if storage == "float" else "Store this map as float, or divide it by a constant."
            fact = f"its largest magnitude is {largest:.6g}, above {most:.6g}"
            raise RangeError(message("export", spec.name, f"fit {kind.dtype}", fact, step))
        # From double precision torch would round twice.
        whole = value.half() if kind.dtype == "float16" and value.dtype == torch.float32 else value
        return Codes(whole.permute(1, 2, 0).numpy().astype(kind.dtype, copy=False))
    if kind.natural and spec.kind == "rotation":
        codes = (hue_of(value.double()) * kind.levels).round()
        return Codes(codes.permute(1, 2, 0).numpy().astype(kind.dtype), (0.0,) * 3, (1.0,) * 3, "hue")
    low, high = _span(spec, value, kind.natural, span)
    coded = (kind.natural and spec.looks_coloured) or (spec.colour and kind.dtype == "uint8")
    transfer = "srgb" if coded and float(low.min()) >= 0 else "linear"
    if transfer == "srgb":
        low, high = torch.zeros_like(low), high.amax().expand_as(high)
    width = torch.where(high > low, high - low, torch.ones_like(low))
    pixels = np.empty((*value.shape[1:], len(value)), kind.dtype)
    rows = max(1, _BAND_VALUES // (value.shape[2] * len(value)))
    for top in range(0, len(pixels), rows):
        share = (value[:, top : top + rows].double() - low[:, None, None]) / width[:, None, None]
        if transfer == "srgb":
            share = _per_channel(colour.linear_to_srgb, share)
        codes = (share * kind.levels).round().clamp(0, kind.levels)  # the clamp meets rounding errors of 1e-16 only
        pixels[top : top + rows] = codes.permute(1, 2, 0).numpy()
    return Codes(pixels, tuple(low.tolist()), tuple(high.tolist()), transfer)


def _per_channel(curve: Callable[[Tensor], Tensor], planes: Tensor) -> Tensor:
    """Apply a curve that asks for three channels to planes [C, H, W] of any number."""
    return curve(planes.flatten()[None, None].expand(3, 1, -1))[0].reshape(planes.shape)


def _span(spec: MapSpec, planes: Tensor, natural: bool, stated: tuple[float, float] | None) -> tuple[Tensor, Tensor]:
    """Return the values [C] of the smallest and the largest code."""
    # Floats of 32 bits, so that the manifest's decimal text brings back the same numbers.
    low, high = planes.amin(dim=(1, 2)).float().double(), planes.amax(dim=(1, 2)).float().double()
    if stated is not None:
        return low.clamp(max=stated[0]).float().double(), high.clamp(min=stated[1]).float().double()
    if spec.low is not None and spec.high is not None and (spec.fixed_range or natural):
        return torch.full_like(low, spec.low), torch.full_like(high, spec.high)
    if natural and spec.low == 0:
        return torch.zeros_like(low), high.amax().clamp(min=1).expand_as(high)
    if natural and spec.low is None:  # grey is 0
        most = torch.maximum(-low, high).amax()
        most = torch.where(most > 0, most, 1.0).expand_as(high)
        return -most, most
    return low, high


def decode(codes: Codes) -> Tensor:
    """Return the texture [C, H, W], float32, that `codes` stand for."""
    pixels = codes.pixels
    if not codes.low:
        return torch.from_numpy(np.ascontiguousarray(pixels.transpose(2, 0, 1)).astype(np.float32))
    share = torch.from_numpy(pixels.transpose(2, 0, 1).astype(np.float64) / np.iinfo(pixels.dtype).max)
    if codes.transfer == "hue":
        return directions_of(share).float().contiguous()
    if codes.transfer == "srgb":
        share = _per_channel(colour.srgb_to_linear, share)
    low = torch.tensor(codes.low, dtype=torch.float64)[:, None, None]
    high = torch.tensor(codes.high, dtype=torch.float64)[:, None, None]
    return (low + share * (high - low)).float().contiguous()
