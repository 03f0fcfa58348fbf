"""The material of a GLB as a microfacet one: the textures and factors of its first, by the formulas of glTF's extensions."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchmat import safe
from torchmat.errors import DataError, message, notice
from torchmat.geometry import normals_from_slopes, slopes_from_height, slopes_from_normals
from torchmat.material_io.glb import SUFFIX, Glb, read_glb
from torchmat.material_io.pictures import codes_of_bytes, values_of
from torchmat.models.ggx import usual_f90
from torchmat.models.microfacet import MICROFACET_PARTS, Microfacet
from torchmat.models.renderers import DIELECTRIC, alphas_of_gltf
from torchmat.models.resample import resample

MAP_OF_HEIGHT = "height"
_PREFIX = "KHR_materials_"
_KNOWN = ("specular", "ior", "anisotropy", "clearcoat", "sheen")
_SUFFIXES = {"image/png": ".png", "image/jpeg": ".jpg"}
_MOST_TEXELS = 2**28
_EXPANSION = 1100  # of bytes that deflate can make of one
_SAME = 2e-4  # F90 that is the usual one but for 16 bits
_PLAIN_SHEEN = (0.1, 1.0)
_REPEAT = 10497


def is_glb(path: str | Path) -> bool:
    """Return whether a path is called like a GLB and is no folder."""
    path = Path(path)
    return path.suffix.lower() == SUFFIX and not path.is_dir()


def has_material(path: str | Path) -> bool:
    """Return whether `path` is a GLB that holds a material; raises DataError for a damaged one."""
    return is_glb(path) and bool(read_glb(path).items("materials"))


def material_of(path: str | Path) -> Microfacet:
    """Return the first material of a GLB as a microfacet material; what it holds besides is said.

    Base colour, metalness, roughness, normal, and the extensions specular, ior, anisotropy, clearcoat and sheen; occlusion,
    emission and the others are left out. Textures of several sizes are brought to the largest. The height that `export` keeps
    in `extras` comes back as well. Raises DataError, which names the file, for what is damaged, external or has no material.
    """
    return _Reader(read_glb(path)).material()


class _Reader:
    def __init__(self, glb: Glb) -> None:
        self.glb = glb
        if not glb.items("materials"):
            step = "Load it as a mesh, or export it with a material."
            raise glb.error("the GLB", "hold a material", "it holds none", step)
        self.described = glb.item("materials", 0)
        self.base = self._table(self.described, "pbrMetallicRoughness")
        every = self._table(self.described, "extensions")
        self.more = {name: self._table(every, _PREFIX + name) for name in _KNOWN if _PREFIX + name in every}
        self._tell(every)
        self.planes: dict[int, np.ndarray] = {}
        self.size = self._largest()

    def _tell(self, every: dict[str, Any]) -> None:
        unknown = sorted(set(every) - {_PREFIX + name for name in _KNOWN})
        left = [name for name in ("occlusionTexture", "emissiveTexture") if name in self.described] + unknown
        if len(self.glb.items("materials")) > 1:
            left.append(f"{len(self.glb.items('materials')) - 1} more materials")
        if left:
            notice(str(self.glb.path), f"{', '.join(left)} left out, for which a microfacet material has no place")

    def _table(self, parent: dict[str, Any], key: str) -> dict[str, Any]:
        found = parent.get(key, {})
        if not isinstance(found, dict):
            raise self.glb.error(key, "be an object", f"it is a {type(found).__name__}")
        return found

    def _number(self, table: dict[str, Any], key: str, default: float, low: float = 0.0, high: float = math.inf) -> float:
        value = table.get(key, default)
        fits = isinstance(value, int | float) and not isinstance(value, bool) and low <= value <= min(high, 1e30)
        if not fits:
            raise self.glb.error(key, f"be a number in [{low}, {high}]", f"it is {value!r:.60}")
        return float(value)

    def _numbers(self, table: dict[str, Any], key: str, default: list[float], high: float = math.inf) -> Tensor:
        values = table.get(key, default)
        if not isinstance(values, list) or len(values) != len(default):
            raise self.glb.error(key, f"be {len(default)} numbers", f"it is {values!r:.60}")
        return torch.tensor([self._number({key: value}, key, 0.0, 0.0, high) for value in values])[:, None, None]

    def _textures(self) -> list[dict[str, Any]]:
        """Return every reference to a texture that counts."""
        tables = [self.base, self.described, *self.more.values(), self._extras()]
        keys = ("baseColorTexture", "metallicRoughnessTexture", "normalTexture", "specularTexture", "specularColorTexture",
                "anisotropyTexture", "clearcoatTexture", "clearcoatRoughnessTexture", "sheenColorTexture", MAP_OF_HEIGHT)
        found = [self._table(table, key) for table in tables for key in keys if key in table]
        for reference in found:
            if reference.get("texCoord", 0) != 0 or reference.get("extensions"):
                step = "Bake the textures to the first texture coordinates, unmoved."
                raise self.glb.error("textures", "use the first texture coordinates as they are", "one does not", step)
        return found

    def _extras(self) -> dict[str, Any]:
        extras = self.described.get("extras")
        own = extras.get("torchmat") if isinstance(extras, dict) else None
        return own if isinstance(own, dict) else {}

    def _largest(self) -> tuple[int, int]:
        sizes = [self._codes(reference).shape[:2] for reference in self._textures()]
        return (max(size[0] for size in sizes), max(size[1] for size in sizes)) if sizes else (1, 1)

    def _codes(self, reference: dict[str, Any]) -> np.ndarray:
        """Return the codes [H, W, C] of the picture that a reference leads to; each is decoded once."""
        texture = self.glb.item("textures", reference.get("index"))
        number = texture.get("source")
        picture = self.glb.item("images", number)
        assert isinstance(number, int)
        if number not in self.planes:
            where = f"{self.glb.path}, images {number}"
            kind = str(picture.get("mimeType"))
            if "bufferView" not in picture or kind not in _SUFFIXES:
                step = "Export it as one GLB with PNG or JPEG inside."
                fact = f"it is of type {kind!r:.40}" if "bufferView" in picture else "it lies elsewhere"
                raise DataError(message(where, "the picture", "be a PNG or JPEG of the GLB's own buffer", fact, step))
            data = self.glb.view_bytes(picture["bufferView"])
            _check_bound(where, data)
            self.planes[number] = codes_of_bytes(data, _SUFFIXES[kind], where)
        return self.planes[number]

    def _map(self, table: dict[str, Any], key: str, coded: bool = False) -> Tensor | None:
        """Return the channels [4, H, W] of a texture in the size of the largest, alpha 1 where there is none."""
        if key not in table:
            return None
        codes = self._codes(self._table(table, key))
        values = values_of(codes[..., : 1 if codes.shape[2] == 2 else 3], coded)
        values = values if len(values) == 3 else values[:1].expand(3, -1, -1)
        has_alpha = codes.shape[2] in (2, 4)
        alpha = values_of(codes[..., -1:]) if has_alpha else torch.ones_like(values[:1])
        return resample(torch.cat((values, alpha)), self.size, tiles=self.tiles)

    @property
    def tiles(self) -> bool:
        """Whether the texture repeats: glTF's default, unless its sampler says otherwise."""
        samplers = self.glb.items("samplers")
        wraps = [one.get(key, _REPEAT) for one in samplers for key in ("wrapS", "wrapT")]
        return all(wrap == _REPEAT for wrap in wraps)

    def material(self) -> Microfacet:
        maps, parts = self._specular()
        for more, names in (self._normal(), self._coat(), self._sheen()):
            maps |= more
            parts |= names
        kept = {name: value.float().contiguous() for name, value in maps.items()}
        return Microfacet(kept, parts=[part for part in MICROFACET_PARTS if part in parts], tiles=self.tiles, storage="half")

    def _specular(self) -> tuple[dict[str, Tensor], set[str]]:
        ones = torch.ones(1, *self.size)
        base = self._numbers(self.base, "baseColorFactor", [1.0] * 4, 1.0).expand(-1, *self.size)
        texture = self._map(self.base, "baseColorTexture", coded=True)
        base = base if texture is None else base * texture
        rough, metal = self._number(self.base, "roughnessFactor", 1.0, 0, 1) * ones, self._number(self.base, "metallicFactor", 1.0, 0, 1) * ones
        texture = self._map(self.base, "metallicRoughnessTexture")
        if texture is not None:
            rough, metal = rough * texture[1:2], metal * texture[2:3]
        f0, f90 = self._reflectance(ones)
        colour = base[:3]
        f0, f90 = f0 * (1 - metal) + colour * metal, f90 * (1 - metal) + metal
        maps = {"diffuse": colour * (1 - metal), "specular_f0": f0, "roughness": rough}
        share = safe.divide(f90, usual_f90(f0))
        share = torch.where(usual_f90(f0) > 0, share, ones).clamp(0, 1)
        parts = set()
        if bool(((1 - share) * usual_f90(f0) > _SAME).any()):
            maps["f90"] = share
            parts.add("f90")
        if self.described.get("alphaMode", "OPAQUE") != "OPAQUE":
            maps["opacity"] = base[3:]
        turned = self._anisotropy(rough, ones)
        return (maps | turned, parts | ({"anisotropy"} if turned else set()))

    def _reflectance(self, ones: Tensor) -> tuple[Tensor, Tensor]:
        """Return F0 and F90 of what is no metal."""
        table = self.more.get("specular", {})
        index = self._number(self.more.get("ior", {}), "ior", 1.5)
        if 0 < index < 1:
            raise self.glb.error("ior", "be 0 or at least 1", f"it is {index}")
        plain = 1.0 if index == 0 else DIELECTRIC if index == 1.5 else ((index - 1) / (index + 1)) ** 2
        weight, tint = self._number(table, "specularFactor", 1.0, 0, 1) * ones, self._numbers(table, "specularColorFactor", [1.0] * 3)
        texture = self._map(table, "specularTexture")
        weight = weight if texture is None else weight * texture[3:4]
        texture = self._map(table, "specularColorTexture", coded=True)
        tint = (tint * ones) if texture is None else tint * texture[:3]
        return (plain * tint).clamp(max=1) * weight, weight

    def _anisotropy(self, rough: Tensor, ones: Tensor) -> dict[str, Tensor]:
        if "anisotropy" not in self.more:
            return {}
        table = self.more["anisotropy"]
        strength = self._number(table, "anisotropyStrength", 0.0, 0, 1) * ones
        turn = self._number(table, "anisotropyRotation", 0.0, -1e6)
        direction = torch.stack((ones[0], 0 * ones[0]))
        texture = self._map(table, "anisotropyTexture")
        if texture is not None:
            direction, strength = texture[:2] * 2 - 1, strength * texture[2:3]
        cosine, sine = math.cos(turn), math.sin(turn)
        x, y = direction
        direction = safe.normalise(torch.stack((cosine * x - sine * y, sine * x + cosine * y)))
        none = (direction == 0).all(dim=0, keepdim=True)
        direction = torch.where(none, torch.tensor([1.0, 0.0])[:, None, None], direction)
        return {"roughness": alphas_of_gltf(rough, strength).sqrt(), "rotation": direction.clamp(-1, 1)}

    def _normal(self) -> tuple[dict[str, Tensor], set[str]]:
        texture = self._map(self.described, "normalTexture")
        height = self._height()
        found = {} if height is None else {"height": height}
        if texture is None:
            return found, set()
        scale = self._number(self._table(self.described, "normalTexture"), "scale", 1.0, -1e6)
        normal = (texture[:3] * 2 - 1) * torch.tensor([scale, scale, 1.0])[:, None, None]
        normal = torch.where(normal[2:] > 0, normal, torch.tensor([0.0, 0.0, 1.0])[:, None, None])
        normal = safe.normalise(normal).clamp(-1, 1)
        if height is not None:
            slopes = slopes_from_normals(normal) - slopes_from_height(height, tiles=self.tiles)
            normal = normals_from_slopes(slopes)
        return {**found, "normal": normal}, {"normal"}

    def _height(self) -> Tensor | None:
        table = self._extras()
        texture = self._map(table, MAP_OF_HEIGHT)
        if texture is None:
            return None
        given = self._table(table, MAP_OF_HEIGHT)
        low, high = (self._number(given, end, 0.0, -10, 10) for end in ("low", "high"))
        return low + texture[:1] * (high - low)

    def _coat(self) -> tuple[dict[str, Tensor], set[str]]:
        if "clearcoat" not in self.more:
            return {}, set()
        table, ones = self.more["clearcoat"], torch.ones(1, *self.size)
        coat = self._number(table, "clearcoatFactor", 0.0, 0, 1) * ones
        rough = self._number(table, "clearcoatRoughnessFactor", 0.0, 0, 1) * ones
        one, other = self._map(table, "clearcoatTexture"), self._map(table, "clearcoatRoughnessTexture")
        coat, rough = coat if one is None else coat * one[:1], rough if other is None else rough * other[1:2]
        return {"coat": DIELECTRIC * coat, "coat_roughness": rough}, {"coat"}

    def _sheen(self) -> tuple[dict[str, Tensor], set[str]]:
        if "sheen" not in self.more:
            return {}, set()
        table = self.more["sheen"]
        tint = self._numbers(table, "sheenColorFactor", [0.0] * 3, 1.0) * torch.ones(3, *self.size)
        texture = self._map(table, "sheenColorTexture", coded=True)
        rough = self._number(table, "sheenRoughnessFactor", 0.0, 0, 1)
        if "sheenRoughnessTexture" in table:
            notice(str(self.glb.path), "the texture of the sheen's roughness is left out: there is one number for all texels")
        low, high = _PLAIN_SHEEN
        return {"sheen": tint if texture is None else tint * texture[:3], "sheen_roughness": torch.tensor([min(max(rough, low), high)])}, {"sheen"}


def _check_bound(where: str, data: bytes) -> None:
    """Raise DataError when a PNG's head promises more texels than its bytes can hold, or than any texture has."""
    if data[:8] == b"\x89PNG\r\n\x1a\n" and len(data) >= 24:
        width, height = (int.from_bytes(data[place : place + 4], "big") for place in (16, 20))
        if width * height > min(_MOST_TEXELS, 8 * _EXPANSION * len(data)):
            fact = f"its head promises {width} x {height} and {len(data)} bytes follow"
            raise DataError(message(where, "the picture", "hold what its head promises", fact, "Restore the file."))
