"""Storable: maps as textures, of any size and depth, and what they take."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Self

import torch
from torch import Tensor, nn

from torchmat.models.cutout import Cutout
from torchmat.models.resample import ANY_SIZE, resample, restored, shrunk
from torchmat.models.storage import STORAGES, MapSpec, StoredAs, StoredTexture, decode


class Storable(nn.Module):
    """What a material knows of its own textures.

    `storage` is how they are stored unless `stored` says otherwise of a map; `options` make another material like it.
    """

    maps: nn.ParameterDict
    storage: str
    stored: dict[str, StoredAs]
    tiles: bool
    cutout: Cutout | None
    relief: str
    options: dict[str, Any]

    def specs(self) -> tuple[MapSpec, ...]:
        """Return what each map is."""
        raise NotImplementedError

    @property
    def size(self) -> tuple[int, int]:
        """Height and width in texels."""
        raise NotImplementedError

    def with_maps(self, **maps: Tensor) -> Self:
        """Return the same material with some other maps."""
        raise NotImplementedError

    def _unchecked(self, maps: dict[str, Tensor], **fields: Any) -> Self:
        """Return a material that differs in these maps and fields, neither checked nor copied."""
        raise NotImplementedError

    def settings(self, maps: Mapping[str, Tensor]) -> dict[str, Any]:
        """Return the keywords besides the options that make a material of other `maps` be stored and tile like this."""
        stored = {name: one for name, one in self.stored.items() if name in maps}
        return {"storage": self.storage, "tiles": self.tiles, "stored": stored, "cutout": self.cutout, "relief": self.relief}

    def _like(self, maps: Mapping[str, Tensor], **changed: Any) -> Self:
        return type(self)(maps, **{**self.settings(maps), **changed}, **self.options)

    def stored_as(self, storage: str) -> Self:
        """Return the same material with its textures to be stored as `storage`."""
        return self._like(dict(self.maps), storage=storage)

    def stored_at(self, changes: Mapping[str, StoredAs | None]) -> Self:
        """Return the same material with some maps to be stored smaller, or in another depth.

        Maps keep their full size in memory and shade as before; `as_exported`, the bytes and the folder follow. None,
        or a StoredAs that says nothing, stores a map as usual. The specular maps, a table that all texels share, are
        resampled at once to the size that is asked for. Raises RangeError for unknown maps and impossible sizes.
        """
        stored = {name: one for name, one in {**self.stored, **changes}.items() if one is not None}
        maps = dict(self.maps)
        for name in ANY_SIZE:
            size = stored[name].size if isinstance(stored.get(name), StoredAs) and name in maps else None
            if size is not None:
                maps[name] = resample(maps[name].detach(), size, tiles=False)
                stored[name] = replace(stored[name], size=None)
        return self._like(maps, stored=stored)

    def _storage_of(self, spec: MapSpec) -> str:
        # Shared tables are few bytes and set the brightness of every texel, so they keep at least half precision.
        deep = "paint16" if STORAGES[self.storage].natural else "half"
        default = deep if not spec.per_texel and STORAGES[self.storage].levels == 255 else self.storage
        usual = deep if spec.storage == "png16" and deep == "paint16" else spec.storage
        return self._stored(spec).storage or usual or default

    def _is_hue(self, spec: MapSpec) -> bool:
        return spec.kind == "rotation" and STORAGES[self._storage_of(spec)].natural

    def _stored(self, spec: MapSpec) -> StoredAs:
        return self.stored.get(spec.name, StoredAs())

    def _small(self, spec: MapSpec) -> Tensor:
        """Return a map in the size that it is stored in."""
        value = self.maps[spec.name].detach()
        return shrunk(spec, value, self._stored(spec).size or value.shape[-2:], self.tiles)

    def textures(self) -> list[StoredTexture]:
        """Return every texture that export writes: (map, texture name, values [C, h, w], storage), in its size.

        With `numbers` this is all that a material holds. Each says what it means, in which range, and whether it is
        colour or data.
        """
        found = []
        for spec in self.specs():
            if not self._is_numbers(spec):
                whole, storage, span = self._small(spec), self._storage_of(spec), self._stored(spec).span
                hue = self._is_hue(spec)  # both channels make one picture
                names, parts = ((spec.name,), (whole,)) if hue else (spec.textures, whole.split(spec.layer_channels))
                found += [
                    StoredTexture(spec, name, part, storage, span) for name, part in zip(names, parts, strict=True)
                ]
        return found

    def numbers(self) -> list[tuple[MapSpec, Tensor]]:
        """Return (map, values [C], float32) of every map that export writes into the manifest, as numbers."""
        constants = [(spec, self.maps[spec.name].detach()) for spec in self.specs() if spec.constant]
        small = [(spec, self._small(spec)[:, 0, 0]) for spec in self.specs() if self._stored(spec).numbers]
        return [(spec, value.float()) for spec, value in (*constants, *small)]

    def some_texels(self, rows: slice, columns: slice, exported: bool = False) -> Self:
        """Return a flat material of some rows and columns, as it is or `exported`, as its textures would bring it back.

        Their codes span what those of the whole do. Not checked; it shades, and is not to be stored.
        """
        parts: dict[str, list[Tensor]] = {}
        for texture in self.textures() if exported else ():
            parts.setdefault(texture.spec.name, []).append(self._some_of(texture, rows, columns))
        maps = {spec.name: _some(spec, self.maps[spec.name].detach(), rows, columns) for spec in self.specs()}
        for spec, value in self.numbers() if exported else ():
            maps[spec.name] = value if spec.constant else value[:, None, None].expand(maps[spec.name].shape)
        return self._unchecked(maps | {name: torch.cat(pieces) for name, pieces in parts.items()}, cutout=None, stored={})

    def _some_of(self, texture: StoredTexture, rows: slice, columns: slice) -> Tensor:
        """Return some rows and columns of what a texture brings back; a table whole."""
        if not texture.spec.per_texel:
            return decode(texture.codes())
        if texture.values.shape[-2:] != self.size:
            return _some(texture.spec, restored(texture.spec, [decode(texture.codes())], self.size, self.tiles), rows, columns)
        if STORAGES[texture.storage].levels is None and not texture.spec.index:  # each value is its own code
            return decode(texture._replace(values=texture.values[:, rows, columns]).codes())
        codes = texture.codes()
        return decode(replace(codes, pixels=codes.pixels[rows, columns]))

    def as_exported(self) -> Self:
        """Return the material, in float32, as its textures would bring it back, without writing files.

        Raises RangeError when a map cannot be stored without leaving its range.
        """
        parts: dict[str, tuple[MapSpec, list[Tensor]]] = {}
        for texture in self.textures():
            parts.setdefault(texture.spec.name, (texture.spec, []))[1].append(decode(texture.codes()))
        maps = {
            spec.name: value if spec.constant else value[:, None, None].expand(-1, *self.size).contiguous()
            for spec, value in self.numbers()
        }
        for spec, pieces in parts.values():
            size = self.size if spec.per_texel else self.maps[spec.name].shape[-2:]
            maps[spec.name] = restored(spec, pieces, size, self.tiles)
        return self.with_maps(**maps)

    def bytes_of(self, spec: MapSpec) -> int:
        """Return the bytes that one map takes as stored: found from its size alone, numbers are 4 each."""
        if self._is_numbers(spec):
            return 4 * spec.channels
        width = (1 if spec.fits_a_byte else 2) if spec.index else STORAGES[self._storage_of(spec)].bytes
        channels = 3 if self._is_hue(spec) else spec.channels
        return width * channels * math.prod(self._stored(spec).size or self.maps[spec.name].shape[-2:])

    def _is_numbers(self, spec: MapSpec) -> bool:
        return spec.constant or self._stored(spec).numbers

    @property
    def bytes_per_texel(self) -> float:
        """Bytes of texture a texel takes as stored, before any file compression; shared tables stand beside it."""
        textures = [spec for spec in self.specs() if spec.per_texel and not self._is_numbers(spec)]
        return sum(map(self.bytes_of, textures)) / math.prod(self.size)

    @property
    def shared_bytes(self) -> int:
        """Bytes of the tables that all texels share, and of all numbers."""
        return sum(self.bytes_of(spec) for spec in self.specs() if not spec.per_texel or self._is_numbers(spec))


def _some(spec: MapSpec, value: Tensor, rows: slice, columns: slice) -> Tensor:
    """Return some rows and columns of a map [C, H, W]; numbers and tables stay whole."""
    return value if spec.constant or not spec.per_texel else value[:, rows, columns].contiguous()
