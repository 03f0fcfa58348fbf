"""Btf: many images of one flat sample, each under a known light and view, validated once."""

from __future__ import annotations

import copy
import hashlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from torch import Tensor

from torchmat.btf.decode import Decoder
from torchmat.btf.near import LIGHT, VIEW, Grid, Near, with_centre
from torchmat.btf.pixels import checksum
from torchmat.btf.store import CLIPPED, INVALID, VALID, PixelStore, summarise, taken
from torchmat.btf.stream import BAND_SAMPLES, Block, bands, runs, stream_blocks
from torchmat.errors import RangeError, ShapeError, check_finite, check_unit, message
from torchmat.geometry.mask import check_mask

# Little, so that unclipped samples decide where there are any; not 0, or a texel clipped throughout would turn black.
CLIPPED_WEIGHT = 0.05
_LOOKED_AT = 16  # images whose codes tell one BTF from another
_CODE = 1 << 20  # above all differences of rounded coordinates
_ROUNDING = 1e-6  # of a product in single precision
_DIRECTION_DECIMALS = 4  # directions closer than about 1e-4 (0.006 degrees) are one direction


@dataclass(frozen=True)
class Source:
    """Where a Btf came from, and notes on what was taken for what: shown by commands, kept in a material's provenance."""

    kind: str = "tensors"
    path: str = "memory"
    files: tuple[str, ...] = field(default=(), repr=False)
    load_seconds: float = 0.0
    from_cache: bool = False
    notes: tuple[str, ...] = ()
    xyz: bool = False
    mask: str = ""  # what the object mask was taken from


def unique_directions(directions: Tensor, position: Tensor | None = None) -> tuple[Tensor, Tensor]:
    """Return the distinct rows of [n, 3] unit vectors, from the pole outward, and each row's index among them.

    Where `position` [n, 3] differs, so do rows of one direction.
    """
    rounded = torch.round(directions.double(), decimals=_DIRECTION_DECIMALS) + 0.0  # + 0.0 turns -0.0 into 0.0
    steps = (rounded * 10**_DIRECTION_DECIMALS).round().long()
    # One number a direction: torch compares rows of several ten times as slowly.
    code = (steps * torch.tensor([_CODE**2, _CODE, 1])).sum(dim=1)
    if position is not None:
        code = torch.unique(position.double().round(decimals=_DIRECTION_DECIMALS), dim=0, return_inverse=True)[1]
    distinct, inverse = torch.unique(code, return_inverse=True)
    first = torch.full((len(distinct),), len(directions), dtype=torch.long)
    first.scatter_reduce_(0, inverse, torch.arange(len(directions)), reduce="amin")
    x, y, z = rounded[first].numpy().T
    order = torch.from_numpy(np.lexsort((y, x, np.arctan2(y, x), -z)))
    return directions[first[order]], order.argsort()[inverse]


def _below_notes(light: Tensor) -> tuple[str, ...]:
    """Return a note on lights that are below the surface, where there are any; a view there is refused."""
    below = light[:, 2] < 0 if light.ndim == 2 and light.shape[1] == 3 else torch.zeros(0, dtype=torch.bool)
    if not bool(below.any()):
        return ()
    first = int(below.nonzero()[0, 0])
    return (f"warning: {int(below.sum())} of {len(below)} lights are below the surface, first that of sample {first}",)


def _switched_off(where: str, weight: Tensor, shape: tuple[int, int, int]) -> Tensor:
    """Return where a 0/1 `weight` is 0, bool [sample, H, W]."""
    count, height, width = shape
    if weight.shape not in (shape, (count, 1, height, width)):
        fact = f"it is {tuple(weight.shape)}"
        step = "Give one value for each texel of each image."
        raise ShapeError(message(where, "weight", f"be [{count}, 1, {height}, {width}]", fact, step))
    off = weight.reshape(shape) == 0
    other = int((~off & (weight.reshape(shape) != 1)).sum())
    if other:
        step = "Compare it with a threshold first."
        raise RangeError(message(where, "weight", "be boolean or 0/1", f"{other} values are neither", step))
    return off


class Btf:
    """Images of a material under many lights and views.

    A value is ``pi * f_r * cos(light)`` in linear RGB; directions point away from the surface, in the frame x right, y up,
    z normal. `load_btf` reads one from files, `Btf.from_tensors` takes images that are at hand.

    Args:
        store: what gives the pixels of each sample, as codes or values.
        light, view: unit vectors [sample, 3].
        decoder: what makes linear values of the codes.
        source: where the images come from; None if they were given.
        clipped_weight: what a clipped sample counts in a fit, 0 to 1; an invalid one counts nothing.
        intensity: how bright each light was in red, green and blue [sample, 3]: values are divided by it; None is 1.
        mask: which texels show the object, bool [H, W]; None is all. The others are 0, without weight, in every image.
        near: where near lights and cameras stand, None where all are far. Then `light` and `view` are the directions at the
            texture's centre, and `directions` those at every texel.
    """

    def __init__(
        self,
        store: PixelStore,
        light: Tensor,
        view: Tensor,
        decoder: Decoder,
        source: Source | None = None,
        clipped_weight: float = CLIPPED_WEIGHT,
        intensity: Tensor | None = None,
        mask: Tensor | None = None,
        near: Near | None = None,
    ) -> None:
        self._store = store
        self._decoder = decoder
        self.light = light
        self.view = view
        self.source = source or Source()
        self.clipped_weight = clipped_weight
        self.intensity = intensity
        self.mask = mask
        self.near = near
        self._validate()
        self._find_distinct()
        # Codes that can clip do so somewhere, whether or not this texel or that window shows it.
        self.may_clip = decoder.full_code is not None or bool(store.clipped.any())

    def _find_distinct(self) -> None:
        self.lights, self.light_index = unique_directions(self.light, self.light_position)
        self.views, self.view_index = unique_directions(self.view, self.view_position)

    def _validate(self) -> None:
        where, count = self.source.path, len(self._store.pixels)
        if self._store.pixels.ndim != 4 or self._store.pixels.shape[1] != 3 or 0 in self._store.pixels.shape:
            fact = f"their shape is {tuple(self._store.pixels.shape)}"
            raise ShapeError(message(where, "images", "be [sample, 3, H, W] with no dimension of 0", fact))
        for name, direction in (("light", self.light), ("view", self.view)):
            if direction.shape != (count, 3):
                fact = f"there are {count} images and {name} is {tuple(direction.shape)}"
                raise ShapeError(message(where, name, "be [sample, 3]", fact, "Give one direction for each image."))
            check_unit(where, name, direction, "Divide each by its length.")
        if self.intensity is not None and (self.intensity.shape != (count, 3) or not bool((self.intensity > 0).all())):
            fact = f"it is {tuple(self.intensity.shape)}"
            raise ShapeError(message(where, "intensity", f"be [{count}, 3] and positive", fact))
        if self.mask is not None and (self.mask.shape != (self.height, self.width) or self.mask.dtype != torch.bool):
            fact = f"it is {list(self.mask.shape)} of {self.mask.dtype}"
            raise ShapeError(message(where, "mask", f"be bool [{self.height}, {self.width}]", fact))
        if self.near is not None:
            self.near.check(where, count)
        below = self.view[:, 2] <= 0
        if bool(below.any()):
            fact = f"{int(below.sum())} of {count} views have z <= 0, first at sample {int(below.nonzero()[0, 0])}"
            raise RangeError(message(where, "view", "lie above the surface", fact, "Remove those images."))
        if not 0 <= self.clipped_weight <= 1:
            step = "0 leaves clipped samples out, 1 trusts them."
            raise RangeError(message(where, "clipped_weight", "lie in [0, 1]", f"it is {self.clipped_weight}", step))

    @classmethod
    def from_tensors(
        cls, images: Tensor | np.ndarray, light: Tensor | np.ndarray | None, view: Tensor | np.ndarray | None,
        weight: Tensor | np.ndarray | None = None, *, light_position: Tensor | np.ndarray | None = None,
        view_position: Tensor | np.ndarray | None = None, falloff: bool = True,
    ) -> Btf:
        """Build a Btf from linear images [sample, 3, H, W] and unit directions [sample, 3].

        Of near lights or cameras `light_position` or `view_position` [sample, 3] says where they stand, in widths of the
        texture from its centre (x right, y up, z along the normal); `light` or `view` is None then, or the direction at the
        centre. `falloff` says that the images darken with the square of the distance to a near light, which is taken out:
        a value is then what the light would give at the distance that it has from the centre. False is for images that were
        normalised already.

        Images are floating point, and used as they are where they are float32 or float64 (not copied). `weight`
        [sample, 1, H, W] or [sample, H, W], boolean or 0/1, marks the samples that count; where it is 0 the image may
        hold anything, NaN included. Raises ShapeError, RangeError (codes, not finite, not unit, view below, positions that
        are not above the surface or in it).
        """
        where = "Btf.from_tensors"
        images = torch.as_tensor(images).detach()
        if images.ndim != 4 or images.shape[1] != 3 or 0 in images.shape:
            fact = f"their shape is {tuple(images.shape)}"
            step = "Put the three colours on dimension 1."
            raise ShapeError(message(where, "images", "be [sample, 3, H, W] with no dimension of 0", fact, step))
        if not images.is_floating_point():
            step = "Decode the codes to linear light first, or load the files with load_btf."
            raise RangeError(message(where, "images", "be floating point", f"they are {images.dtype}", step))
        dtype = torch.float64 if images.dtype == torch.float64 else torch.float32
        images = images.to(dtype)
        count, _, height, width = images.shape
        flags = np.zeros((count, height, width), dtype=np.uint8)
        if weight is not None:
            off = _switched_off(where, torch.as_tensor(weight).detach(), flags.shape)
            flags[off.numpy()] = INVALID
            images = torch.where(off[:, None], torch.zeros((), dtype=dtype), images)
        check_finite(where, "images", images, "Repair those values, or give them weight 0.")
        pixels = images.contiguous().numpy()
        given = (light, view, light_position, view_position)
        towards = [None if one is None else torch.as_tensor(one).detach().to(dtype) for one in given]
        near = None if towards[2] is towards[3] is None else Near(towards[2], towards[3], Grid.whole(height, width), bool(falloff))
        if near is not None:
            near.check(where, count)
        light, view = with_centre(where, LIGHT, towards[0], towards[2]), with_centre(where, VIEW, towards[1], towards[3])
        origin = Source(notes=_below_notes(light))
        return cls(summarise(pixels, flags), light, view, Decoder(pixels.dtype, "linear", 1.0), origin, near=near)

    def window(self, top: int, left: int, height: int, width: int, step: int = 1) -> Btf:
        """Return the same samples of a part of the texels, or of every `step`-th of them in rows and columns.

        It shares the pixels with this Btf, so it costs no memory and is read from the same file. Raises RangeError for
        a window that does not lie within the images.
        """
        for name, first, length, whole in (("rows", top, height, self.height), ("columns", left, width, self.width)):
            if not all(isinstance(n, int) for n in (first, length, step)) or step < 1:
                fact = f"they are {first!r}, {length!r} and step {step!r}"
                raise RangeError(message(self.source.path, f"the window's {name}", "be whole numbers", fact))
            if not (0 <= first and 0 < length and first + length <= whole):
                fact = f"they are {first} to {first + length} of {whole}"
                hint = "Give top, left, height and width in texels."
                raise RangeError(message(self.source.path, f"the window's {name}", "lie within the images", fact, hint))
        part = copy.copy(self)
        rows, columns = slice(top, top + height, step), slice(left, left + width, step)
        part._store = self._store.window(rows, columns)
        mask = None if self.mask is None else self.mask[rows, columns]
        part.mask = None if mask is None or bool(mask.all()) else mask
        part.near = None if self.near is None else self.near.window(rows, columns)
        return part

    def masked(self, mask: Tensor, source: str = "") -> Btf:
        """Return the same images of the object alone: texels outside of `mask`, bool [H, W] or [1, H, W], count nowhere.

        They are 0, without weight, in every image; a mask that is there already leaves out what it did. `source` says in a
        report where the mask is from. Raises ShapeError for another size, RangeError for a mask that is true nowhere.
        """
        found = check_mask(self.source.path, mask, (self.height, self.width))
        part = copy.copy(self)
        if found is not None:
            part.mask = found if self.mask is None else found & self.mask
            part.source = replace(self.source, mask=source or "the one given")
        return part

    def unmasked(self) -> Btf:
        """Return the same images with all their texels."""
        part = copy.copy(self)
        part.mask = None
        return part

    @property
    def inside(self) -> Tensor:
        """The numbers [t] of the texels of the object, row by row: of all without a mask."""
        if self.mask is None:
            return torch.arange(self.height * self.width)
        return self.mask.flatten().nonzero()[:, 0]

    @property
    def object_share(self) -> float:
        """Share of the texels that show the object, 1 without a mask."""
        return 1.0 if self.mask is None else float(self.mask.double().mean())

    def object_figures(self) -> dict[str, dict[str, str | int | float]]:
        """Return what a report says of the mask: where it is from, and the texels that it leaves; nothing without one."""
        if self.mask is None:
            return {}
        return {"object": {"mask": self.source.mask, "texels": len(self.inside), "share": self.object_share}}

    def seen_somewhere(self) -> Tensor:
        """Return which texels hold data in some image, bool [H, W]."""
        seen = np.zeros((self.height, self.width), dtype=bool)
        if self._store.flags is None or int(self._store.invalid.min()) == 0:
            return torch.from_numpy(~seen)
        for flags in self._store.flags:
            seen |= flags != INVALID
            if seen.all():
                break
        return torch.from_numpy(seen)

    def identity(self) -> str:
        """Return a text that tells other data apart: of directions, ranges and counts, and of some images' codes."""
        store = self._store
        digest = hashlib.sha256(repr((store.pixels.shape, store.pixels.dtype.str, self._decoder.encoding)).encode())
        digest.update(repr((float(self._decoder.exposure), self.clipped_weight)).encode())
        arrays = [self.light.numpy(), self.view.numpy(), store.clipped, store.invalid]
        arrays += [array for array in (store.low, store.high) if array is not None]
        arrays += [part.numpy() for part in (self.intensity, self.mask) if part is not None]
        arrays += [] if self.near is None else [part.numpy() for part in self.near.arrays()]
        chosen = np.linspace(0, len(self) - 1, min(len(self), _LOOKED_AT)).round().astype(int)
        for array in arrays:
            digest.update(np.ascontiguousarray(array).tobytes())
        for part in (store.pixels,) if store.flags is None else (store.pixels, store.flags):
            for row in chosen:
                digest.update(taken(part, slice(row, row + 1)).data)
        return digest.hexdigest()

    def digest(self) -> str:
        """Return a text that other data has not: of all codes, of directions, and of how the codes are read."""
        store = self._store
        if store.checksums is None:
            clear = np.zeros(store.pixels.shape[2:], np.uint8)
            flags = (clear if store.flags is None else store.flags[row] for row in range(len(self)))
            sums = np.array([checksum(codes, marks) for codes, marks in zip(store.pixels, flags, strict=True)], np.int64)
        else:
            sums = store.checksums.astype(np.int64)
        digest = hashlib.sha256(self.identity().encode())
        digest.update(sums.tobytes())
        return digest.hexdigest()

    def picked(self, indices: Sequence[int] | Tensor) -> Btf:
        """Return a Btf of chosen samples, whose codes are copied; `indices` are sample numbers or a bool mask."""
        rows = self._rows(indices)
        part = copy.copy(self)
        part._store = self._store.picked(rows)
        part.light, part.view = self.light[rows], self.view[rows]
        if len(self.source.files) == len(self):
            part.source = replace(self.source, files=tuple(self.source.files[row] for row in rows))
        part.intensity = None if self.intensity is None else self.intensity[rows]
        kept, part.light_index = self.light_index[rows].unique(return_inverse=True)
        part.lights = self.lights[kept]
        kept, part.view_index = self.view_index[rows].unique(return_inverse=True)
        part.views = self.views[kept]
        part.near = None if self.near is None else self.near.picked(torch.from_numpy(rows))
        return part

    @property
    def light_position(self) -> Tensor | None:
        """Where near lights stand, [sample, 3] in widths of the texture from its centre; None of far ones."""
        return None if self.near is None else self.near.light

    @property
    def view_position(self) -> Tensor | None:
        """Where near cameras stand, [sample, 3] in widths of the texture from its centre; None of far ones."""
        return None if self.near is None else self.near.view

    def directions(self, samples: Sequence[int] | Tensor, dtype: torch.dtype | None = None) -> tuple[Tensor, Tensor]:
        """Return light and view of chosen samples as unit planes: [k, 3, 1, 1], or [k, 3, H, W] of what is near."""
        rows = torch.from_numpy(self._rows(samples))
        return self._planes(LIGHT, rows, dtype), self._planes(VIEW, rows, dtype)

    def _planes(self, which: str, rows: Tensor, dtype: torch.dtype | None) -> Tensor:
        direction = self.light if which == LIGHT else self.view
        dtype = dtype or direction.dtype
        found = None if self.near is None else self.near.directions(which, rows, dtype)
        return direction[rows].to(dtype)[:, :, None, None] if found is None else found

    def light_planes(self, numbers: Tensor, dtype: torch.dtype | None = None) -> Tensor:
        """Return the distinct lights of numbers [k] as unit planes, [k, 3, 1, 1] or [k, 3, H, W]."""
        if self.light_position is None:
            return self.lights[numbers][:, :, None, None].to(dtype or self.lights.dtype)
        return self._planes(LIGHT, self._first_of(self.light_index, numbers), dtype)

    def view_planes(self, numbers: Tensor, dtype: torch.dtype | None = None) -> Tensor:
        """Return the distinct views of numbers [k] as unit planes, [k, 3, 1, 1] or [k, 3, H, W]."""
        if self.view_position is None:
            return self.views[numbers][:, :, None, None].to(dtype or self.views.dtype)
        return self._planes(VIEW, self._first_of(self.view_index, numbers), dtype)

    def of_size(self, rows: int, columns: int) -> Btf:
        """Return the same samples, whose `light_planes` and `view_planes` are those of other texels that cover the same part."""
        return self if self.near is None else self.with_near(self.near.resized(rows, columns))

    def corners(self) -> Btf:
        """Return the same samples, whose `light_planes` and `view_planes` are those of the texels in the corners alone."""
        if self.near is None:
            return self
        ends = (slice(0, None, max(1, length - 1)) for length in (self.height, self.width))
        return self.with_near(self.near.window(*ends))

    def _first_of(self, index: Tensor, numbers: Tensor) -> Tensor:
        first = torch.full((int(index.max()) + 1,), len(index), dtype=torch.long)
        return first.scatter_reduce_(0, index, torch.arange(len(index)), reduce="amin")[numbers]

    def far(self) -> Btf:
        """Return the same images as if near lights and cameras were far: the direction at the centre holds for all texels.

        An approximation, fall-off and all: 30 cm under a dome of 80 cm are off by up to 20 degrees.
        """
        if self.near is None:
            return self
        part = copy.copy(self)
        part.near = None
        part._find_distinct()
        return part.noted(f"warning: {self.near.sentence()}; they are taken for far ones")

    def with_near(self, near: Near | None) -> Btf:
        """Return the same images with other places of lights, cameras or texels."""
        part = copy.copy(self)
        part.near = near
        return part

    def __len__(self) -> int:
        return len(self._store.pixels)

    def __repr__(self) -> str:
        near = {which: "near " if self.near is not None and self.near.positions(which) is not None else "" for which in (LIGHT, VIEW)}
        directions = f"{len(self.lights)} {near[LIGHT]}lights, {len(self.views)} {near[VIEW]}views"
        return f"Btf({self.source.kind}, {len(self)} samples, {directions}, {self.height} x {self.width})"

    @property
    def height(self) -> int:
        """Rows of texels."""
        return self._store.pixels.shape[2]

    @property
    def width(self) -> int:
        """Columns of texels."""
        return self._store.pixels.shape[3]

    @property
    def encoding(self) -> str:
        """How the stored codes are read: "srgb" or "linear"."""
        return self._decoder.encoding

    @property
    def exposure(self) -> float:
        """The factor that values were divided by."""
        return self._decoder.exposure

    @property
    def stored_dtype(self) -> str:
        """The type of the stored codes, e.g. "uint8" or "float16"."""
        return self._store.pixels.dtype.name

    @property
    def clipped_share(self) -> float:
        """Share of all samples (texel of the object x image) that stand at the largest code in some channel."""
        return self._share(CLIPPED, self._store.clipped)

    @property
    def invalid_share(self) -> float:
        """Share of all samples (texel of the object x image) that carry no data."""
        return self._share(INVALID, self._store.invalid)

    def _share(self, kind: int, counts: np.ndarray) -> float:
        """Return the share of a kind of flag, of which each image has `counts`, among the object's samples."""
        if self.mask is None:
            return float(counts.sum() / (len(self) * self.height * self.width))
        inside, flags = self.mask.numpy(), self._store.flags
        found = 0 if flags is None else sum(int((flags[row][inside] == kind).sum()) for row in np.flatnonzero(counts))
        return found / (len(self) * int(inside.sum()))

    @property
    def value_range(self) -> tuple[float, float]:
        """Smallest and largest linear value over all images, of the object where there is a mask."""
        if self.mask is not None:
            return self._range_of(lambda images: images[:, :, self.mask])
        if self.near is not None and self.near.gain(torch.arange(0), torch.float32) is not None:
            return self._range_of(lambda images: images)
        if self.intensity is not None:
            return self._divided_range(1 / self.intensity)
        ends = np.array(self._store.ends()).astype(self._store.pixels.dtype)
        low, high = self._decoder.into(ends, torch.empty(2)).tolist()
        return low, high

    def _rows(self, indices: Sequence[int] | Tensor) -> np.ndarray:
        """Return sample numbers as an array; a boolean mask [sample] stands for the samples that it marks."""
        chosen = torch.as_tensor(indices)
        if chosen.dtype == torch.bool:
            if chosen.shape != (len(self),):
                fact = f"its shape is {tuple(chosen.shape)}"
                step = "Give sample numbers, or one truth value for each sample."
                raise ShapeError(message(self.source.path, "a mask of samples", f"be [{len(self)}]", fact, step))
            chosen = chosen.nonzero()[:, 0]
        elif chosen.numel() and chosen.is_floating_point():
            fact = f"they are {chosen.dtype}"
            raise RangeError(message(self.source.path, "sample numbers", "be whole", fact, "Convert them to integers."))
        return np.asarray(chosen.tolist(), dtype=np.int64)

    def image(self, index: int) -> Tensor:
        """Return one image [3, H, W], float32, linear."""
        return self.images([index])[0]

    def weight(self, index: int) -> Tensor:
        """Return what each texel of one image counts, [1, H, W] in [0, 1]."""
        return self.weights([index])[0]

    def images(self, indices: Sequence[int] | Tensor, dtype: torch.dtype = torch.float32) -> Tensor:
        """Return chosen images [k, 3, H, W], linear; `indices` are sample numbers or a mask, bool [sample]."""
        rows = self._rows(indices)
        codes = taken(self._store.pixels, rows)
        images = self._decoder.into(codes, torch.empty(codes.shape, dtype=dtype))
        images = images if self.intensity is None else images.div_(self.intensity[rows][:, :, None, None].to(dtype))
        gain = self._gain(rows, dtype)
        images = images if gain is None else images.mul_(gain)
        return images if self.mask is None else images.masked_fill_(~self.mask, 0)

    def _gain(self, rows: np.ndarray | range, dtype: torch.dtype) -> Tensor | None:
        """Return what takes the fall-off of near lights out of images, [k, 1, H, W]; None where there is nothing to take."""
        return None if self.near is None else self.near.gain(torch.as_tensor(rows), dtype)

    def _marks(self, samples: np.ndarray | slice, outside: int = INVALID) -> np.ndarray | None:
        """Return the flags [k, H, W] of some samples, `outside` off the object; None where all are valid."""
        flags = None if self._store.flags is None else taken(self._store.flags, samples)
        if self.mask is None:
            return flags
        count = samples.stop - samples.start if isinstance(samples, slice) else len(samples)
        flags = np.zeros((count, self.height, self.width), np.uint8) if flags is None else flags
        return np.where(self.mask.numpy(), flags, np.uint8(outside))

    def weights(self, indices: Sequence[int] | Tensor) -> Tensor:
        """Return the weights of chosen images [k, 1, H, W] in [0, 1]."""
        rows = self._rows(indices)
        flags = self._marks(rows)
        return torch.ones(len(rows), 1, self.height, self.width) if flags is None else self._to_weight(flags)

    def clipped(self, indices: Sequence[int] | Tensor) -> Tensor:
        """Return where chosen images are clipped, bool [k, 1, H, W]."""
        rows = self._rows(indices)
        flags = self._marks(rows)
        if flags is None:
            return torch.zeros(len(rows), 1, self.height, self.width, dtype=torch.bool)
        return torch.from_numpy(flags == CLIPPED)[:, None]

    def valid(self, indices: Sequence[int] | Tensor) -> Tensor:
        """Return where chosen images hold data, bool [k, 1, H, W]."""
        rows = self._rows(indices)
        flags = self._marks(rows)
        if flags is None:
            return torch.ones(len(rows), 1, self.height, self.width, dtype=torch.bool)
        return torch.from_numpy(flags != INVALID)[:, None]

    @property
    def clip_level(self) -> float:
        """The linear value of a clipped channel; infinite for data that does not clip."""
        # Averages of clipped codes are stored as floating point, and are still known by their flags.
        return (1 - 1e-6) / self._decoder.exposure if self.may_clip else float("inf")

    def saturated(self, indices: Sequence[int] | Tensor, images: Tensor) -> Tensor:
        """Return which channels of chosen `images` [k, 3, H, W] are clipped, bool: the truth is at least that bright."""
        level = torch.full((1, 3), self.clip_level, dtype=images.dtype)
        if self.intensity is not None:
            level = level / self.intensity[self._rows(indices)].to(images.dtype)
        level = level[:, :, None, None]
        gain = self._gain(self._rows(indices), images.dtype)
        return self.clipped(indices) & (images >= (level if gain is None else level * gain * (1 - _ROUNDING)))

    def _range_of(self, part: Callable[[Tensor], Tensor]) -> tuple[float, float]:
        ends = [part(self.images([row])).aminmax() for row in range(len(self))]
        return min(float(low) for low, _ in ends), max(float(high) for _, high in ends)

    def _divided_range(self, factor: Tensor) -> tuple[float, float]:
        if self._store.low is None or self._store.high is None:
            return self._range_of(lambda images: images)
        # Codes are known by sample alone: the range is that of a texel whose channels are all as dark or as bright.
        low, high = (self._decoder.into(np.ascontiguousarray(codes), torch.empty(len(self))) for codes in (self._store.low, self._store.high))
        return float((low[:, None] * factor).min()), float((high[:, None] * factor).max())

    def read_as(self, encoding: str) -> Btf:
        """Return the same codes with another meaning, "srgb" or "linear"."""
        part = copy.copy(self)
        part._decoder = Decoder(self._decoder.stored, encoding, self._decoder.exposure)
        return part

    def divided_by(self, intensity: Tensor, note: str) -> Btf:
        """Return the same images with each divided by `intensity` [sample, 3] of its light in place of what was known."""
        part = copy.copy(self)
        part.intensity = intensity.to(self.light.dtype)
        part._validate()
        return part.noted(note)

    def noted(self, note: str) -> Btf:
        """Return the same images with one more note on where they come from."""
        part = copy.copy(self)
        part.source = replace(self.source, notes=(*self.source.notes, note))
        return part

    def _to_weight(self, flags: np.ndarray) -> Tensor:
        # Compared and counted, not looked up: in a tenth of the time.
        weight = (flags == VALID).astype(np.float32)
        if self.clipped_weight:
            weight += (flags == CLIPPED) * np.float32(self.clipped_weight)
        return torch.from_numpy(weight)[:, None]

    def through(self, curve: Callable[[Tensor], Tensor]) -> Btf | None:
        """Return the same images with ``curve(value)`` in the place of values; None where each value has to be asked for it.

        So it is where what codes mean depends on the place or on the image. Values that are masked out stay 0.
        """
        decoder = None if self.intensity is not None or self.near is not None else self._decoder.through(curve)
        if decoder is None:
            return None
        part = copy.copy(self)
        part._decoder = decoder
        return part

    def bands(self, progress: bool | None = False) -> Iterator[tuple[slice, Btf]]:
        """Stream all texels a few rows at a time: the rows, and the Btf of those, whose `blocks` with ``band=True`` are small.

        For what each texel asks of all its samples: everything that is summed stays in the processor's cache.
        """
        for rows in bands(self._store, progress):
            yield slice(rows.start, rows.stop), self.window(rows.start, 0, len(rows), self.width)

    def blocks(
        self, wanted: Tensor | None = None, dtype: torch.dtype = torch.float32, progress: bool | None = False,
        band: bool = False,
    ) -> Iterator[Block]:
        """Stream all samples in their stored order, a run at a time.

        `wanted`, bool [sample], skips runs that hold none of the wanted samples; other runs come whole, since reading
        in order is faster than picking. `progress` None shows a bar on a terminal. `band` is for one of `bands`.
        """
        flagged = self._reduced()

        def weigh(run: range) -> Tensor | None:
            if self.mask is None and (self._store.flags is None or not flagged[run.start : run.stop].any()):
                return None
            flags = self._marks(slice(run.start, run.stop))
            return None if flags is None else self._to_weight(flags)

        most = BAND_SAMPLES if band else None
        for block in stream_blocks(self._store, self._decoder, weigh, wanted, dtype, progress, most):
            if self.intensity is not None:
                block.images.div_(self.intensity[block.samples.start : block.samples.stop, :, None, None].to(dtype))
            gain = self._gain(block.samples, dtype)
            if gain is not None:
                block.images.mul_(gain)
            if self.mask is not None:
                block.images.masked_fill_(~self.mask, 0)
            yield block

    def weight_blocks(self, wanted: Tensor | None = None) -> Iterator[tuple[range, Tensor]]:
        """Stream the weights [k, 1, H, W] of just those runs of samples in which some weight of the object is below 1.

        Off the object they are 1: values there are 0, and no texel's equations need be solved for them.
        """
        if self._store.flags is None:
            return
        reduced = torch.from_numpy(self._reduced() > 0)
        for run in runs(self._store, reduced if wanted is None else reduced & wanted):
            flags = self._marks(slice(run.start, run.stop), VALID)
            assert flags is not None
            yield run, self._to_weight(flags)
            self._store.release(run)

    def _reduced(self) -> np.ndarray:
        """Count, for each sample, the texels whose weight is below 1."""
        return self._store.invalid + (self._store.clipped if self.clipped_weight < 1 else 0)
