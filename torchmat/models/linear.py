"""The baselines whose value is a weighted sum of known functions of the light, or nearly so.

`texture`, `lambert`, and the models of reflectance transformation imaging: `ptm` and `lptm` (Malzbender et al. 2001)
and `hsh` (Gautron et al. 2004, the hemispherical harmonics that RTI tools use). None of them sees the view.

The three of RTI have a `space` in which their sums lie: "linear" light, or "srgb", the codes of a screen, where RTI tools keep
their coefficients. A sum of codes is nearer to photographs at the same bytes, for errors weigh there as they do to the eye.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Self

import torch
from torch import Tensor

from torchmat import safe
from torchmat.errors import RangeError, ShapeError, check_option, message
from torchmat.fast import sums as fast_sums
from torchmat.geometry import normals_from_slopes, slopes_from_height
from torchmat.models.base import Material, combine
from torchmat.models.bases import BASES
from torchmat.models.storage import MapSpec

HSH_TERMS = (4, 9, 16)
NORMALS = ("map", "height")
LINEAR, SRGB = SPACES = ("linear", "srgb")


class Texture(Material):
    """A colour per texel times the cosine of the light."""

    name = "texture"
    glsl = "texture.glsl"

    def own_specs(self) -> tuple[MapSpec, ...]:
        return (MapSpec("albedo", "diffuse colour", low=0.0, colour=True, linear=True),)

    def value(self, light: Tensor, view: Tensor) -> Tensor:
        return combine(BASES["cosine"].evaluate(light, view), self.maps["albedo"][None])

    def in_one_pass(self, light: Tensor, view: Tensor) -> Tensor | None:
        return fast_sums.weighed(light, view, "cosine", self.maps["albedo"])


class Lambert(Material):
    """An albedo and a normal per texel: photometric stereo's material.

    `normals` says where they come from: "map", or, on a relief, the Sobel slopes of its "height".
    """

    name = "lambert"
    glsl = "lambert.glsl"
    diffuse_map = "albedo"

    def __init__(self, maps: Mapping[str, Tensor], *, normals: str = "map", **settings: Any) -> None:
        check_option(self.name, "normals", normals, NORMALS)
        if normals == "height" and "height" not in maps:
            step = "Give a height map, or normals='map' and a normal map."
            raise ShapeError(message(self.name, "height", "be there for normals='height'", "it is not", step))
        super().__init__(maps, normals=normals, **settings)

    def own_specs(self) -> tuple[MapSpec, ...]:
        albedo = MapSpec("albedo", "diffuse colour", low=0.0, colour=True, linear=True)
        normal = MapSpec("normal", "unit normal, x right, y up", low=-1.0, high=1.0, fixed_range=True, kind="normal")
        return (albedo, normal) if self.options["normals"] == "map" else (albedo,)

    def surface(self) -> Lambert:
        flat = super().surface()
        if self.options["normals"] == "map":
            return flat
        normal = normals_from_slopes(slopes_from_height(self.maps["height"], tiles=self.tiles))
        return flat._unchecked({**flat.maps, "normal": normal}, options={**self.options, "normals": "map"})

    @property
    def derives_normal(self) -> bool:
        return self.options["normals"] == "height"

    def value(self, light: Tensor, view: Tensor) -> Tensor:
        normal = safe.normalise(self.maps["normal"])  # interpolation and integer codes shorten it
        n_dot_l = combine(light, normal[:, None])
        return self.maps["albedo"] * n_dot_l.clamp(min=0)

    def in_one_pass(self, light: Tensor, view: Tensor) -> Tensor | None:
        return fast_sums.lambert(light, view, self.maps["albedo"], self.maps["normal"])


class InSpace(Material):
    """A sum that lies in a `space`: "linear", or "srgb", where the sum is a code of a screen.

    A code of 1 is white; below 0 it is black, and above 1 the curve goes on, for measured values may.
    """

    bright_at_horizon = True

    def __init__(self, maps: Mapping[str, Tensor], *, space: str = LINEAR, **settings: Any) -> None:
        check_option(self.name, "space", space, SPACES)
        super().__init__(maps, space=space, **settings)

    def in_codes(self) -> Self | None:
        if self._is_linear:
            return None
        return self._unchecked({spec.name: self.maps[spec.name] for spec in self.own_specs()}, options={**self.options, "space": LINEAR})

    def _decoded(self, total: Tensor) -> Tensor:
        return total if self.options["space"] == LINEAR else _from_codes(total.clamp(min=0))

    @property
    def _is_linear(self) -> bool:
        return self.options["space"] == LINEAR


class Relightable(InSpace):
    """A model of reflectance transformation imaging: a sum over functions of the light, in a `space` of its own.

    `code_range` is of a material that was read from 8-bit codes: the values (low, high) that code 0 and
    code 255 stand for, for each channel of its maps, by which it is written with the same codes again.
    """

    def __init__(
        self, maps: Mapping[str, Tensor], *, space: str = LINEAR, code_range: Sequence[Sequence[float]] | None = None,
        **settings: Any,
    ) -> None:
        known: dict[str, Any] = {} if code_range is None else {"code_range": [list(pair) for pair in code_range]}
        super().__init__(maps, space=space, **known, **settings)
        self._check_code_range()

    def _check_code_range(self) -> None:
        pairs, count = self.options.get("code_range"), sum(spec.channels for spec in self.own_specs())
        if pairs is None:
            return
        fits = len(pairs) == count and all(len(pair) == 2 and all(map(math.isfinite, pair)) for pair in pairs)
        if not fits:
            fact = f"it has {len(pairs)} entries, or some that are something else"
            raise RangeError(message(self.name, "code_range", f"hold {count} pairs of finite numbers", fact))


def _from_codes(code: Tensor) -> Tensor:
    """Return linear light of codes from 0 on (IEC 61966-2-1): as `colour` does, but with the same bits on any number of threads."""
    curve = safe.power((code + 0.055) / 1.055, torch.tensor(2.4, dtype=code.dtype))
    return torch.where(code > 0.04045, curve, code / 12.92)


class Ptm(Relightable):
    """Polynomial texture map: a biquadratic of the projected light per texel and channel."""

    name = "ptm"
    glsl = "ptm.glsl"

    def own_specs(self) -> tuple[MapSpec, ...]:
        terms = BASES["polynomial"].terms
        return (MapSpec("polynomial", "coefficient per term, RGB", layers=terms, linear=self._is_linear),)

    def value(self, light: Tensor, view: Tensor) -> Tensor:
        weights = BASES["polynomial"].evaluate(light, view)
        return self._decoded(combine(weights, self.maps["polynomial"].unflatten(0, (-1, 3))))

    def in_one_pass(self, light: Tensor, view: Tensor) -> Tensor | None:
        return fast_sums.weighed(light, view, "polynomial", self.maps["polynomial"], codes=not self._is_linear)


class Lptm(Relightable):
    """Luminance PTM: one biquadratic of luminance per texel, times a colour per texel."""

    name = "lptm"
    unsure = "its luminance and its colour share one scale, which a convention sets"
    glsl = "lptm.glsl"

    def own_specs(self) -> tuple[MapSpec, ...]:
        terms = BASES["polynomial"].terms
        return (
            MapSpec("chroma", "colour per unit of luminance", low=0.0, colour=True, linear=self._is_linear),
            MapSpec("luminance", "coefficient per term", layers=terms, layer_channels=1, linear=self._is_linear),
        )

    def value(self, light: Tensor, view: Tensor) -> Tensor:
        weights = BASES["polynomial"].evaluate(light, view)
        return self._decoded(combine(weights, self.maps["luminance"][:, None]) * self.maps["chroma"])

    def in_one_pass(self, light: Tensor, view: Tensor) -> Tensor | None:
        maps, codes = self.maps, not self._is_linear
        return fast_sums.weighed(light, view, "polynomial", maps["luminance"], chroma=maps["chroma"], codes=codes)


class Hsh(Relightable):
    """Hemispherical harmonics of the light: 4, 9 or 16 `terms` per texel and channel."""

    name = "hsh"
    glsl = "hsh.glsl"

    def __init__(self, maps: Mapping[str, Tensor], *, terms: int = 9, **settings: Any) -> None:
        check_option(self.name, "terms", terms, HSH_TERMS)
        self._basis = BASES[f"hsh{int(terms)}"]
        super().__init__(maps, terms=terms, **settings)

    def own_specs(self) -> tuple[MapSpec, ...]:
        return (MapSpec("harmonic", "coefficient per term, RGB", layers=self._basis.terms, linear=self._is_linear),)

    def value(self, light: Tensor, view: Tensor) -> Tensor:
        return self._decoded(combine(self._basis.evaluate(light, view), self.maps["harmonic"].unflatten(0, (-1, 3))))

    def in_one_pass(self, light: Tensor, view: Tensor) -> Tensor | None:
        basis = f"hsh{int(self.options['terms'])}"
        return fast_sums.weighed(light, view, basis, self.maps["harmonic"], codes=not self._is_linear)
