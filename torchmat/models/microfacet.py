"""What renderers call a material: diffuse and GGX lobes of a roughness, F0 and direction per texel, and optional parts.

``value = (C_d T(L) T(V) + pi D(H) G(L, V) F(L.H) / (4 (N.L)(N.V))) (N.L)`` with GGX's D (Walter et al. 2007), Smith's
height-correlated G (Heitz 2014), ``F = F0 + (F90 - F0)(1 - L.H)^5`` (Schlick 1994), F90 = min(1, 50 F0) (Lagarde & de Rousiers
2014), and alpha the square of the roughness (Burley 2012), which is that of glTF and OpenPBR. On a relief parallax, shadow
and ambient light come on top.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torchmat import frames, safe
from torchmat.errors import check_option
from torchmat.fast import microfacet as fast_microfacet
from torchmat.geometry import normals_from_slopes, slopes_from_height, slopes_from_normals
from torchmat.models.base import Material, combine
from torchmat.models.ggx import Stretched, ggx_share, schlick_rise, squared_alpha, stretched_share, usual_f90
from torchmat.models.storage import MapSpec

MICROFACET_PARTS = ("normal", "anisotropy", "f90", "coat", "sheen", "rolloff", "layered")
_GRAZING = 1e-4  # as in the distribution material: N.L and the denominator reach 0 together
_SHEEN_RANGE = (0.1, 1.0)  # of its roughness: 1 / alpha is an exponent
_AXES = ("along", "across")


def microfacet_specs(parts: Sequence[str]) -> tuple[MapSpec, ...]:
    """Return what each map of a microfacet material with these optional `parts` is."""
    specs = [
        MapSpec("diffuse", "diffuse albedo", low=0.0, colour=True, linear=True),
        MapSpec("specular_f0", "reflectance along the normal, F0", low=0.0, colour=True),
        MapSpec(
            "roughness", "square root of GGX's alpha", layers=_AXES if "anisotropy" in parts else (), layer_channels=1,
            low=0.0, high=1.0, fixed_range=True,
        ),
    ]
    own = {
        "normal": [MapSpec(
            "normal", "unit normal; on a relief, its refinement", low=-1.0, high=1.0, fixed_range=True, kind="normal",
        )],
        "anisotropy": [MapSpec(
            "rotation", "cosine (x) and sine (y) of the turn of the direction `along`", layers=("x", "y"), layer_channels=1,
            low=-1.0, high=1.0, fixed_range=True, kind="rotation",
        )],
        "f90": [MapSpec("f90", "share of the reflectance at grazing, F90", layer_channels=1, low=0.0, high=1.0, fixed_range=True)],
        "coat": [
            MapSpec("coat", "F0 of a clear coat", layer_channels=1, low=0.0, high=1.0),
            MapSpec("coat_roughness", "square root of the coat's alpha", layer_channels=1, low=0.0, high=1.0, fixed_range=True),
        ],
        "sheen": [
            MapSpec("sheen", "colour of the sheen of fibres", low=0.0, colour=True, linear=True),
            MapSpec(
                "sheen_roughness", "square root of the sheen's alpha", layer_channels=1, constant=True,
                low=_SHEEN_RANGE[0], high=_SHEEN_RANGE[1],
            ),
        ],
        "rolloff": [MapSpec("rolloff", "T(c) = 1 + a (1 - c) + b (1 - c)^5 of the diffuse part", layer_channels=2, constant=True)],
        "layered": [],
    }
    return tuple(specs + [spec for part in MICROFACET_PARTS if part in parts for spec in own[part]])


class _Prepared(NamedTuple):
    """What the maps alone say: squared alphas, F90, the texels' frames (None for the plane's own), and those stretched."""

    squares: Tensor
    f90: Tensor
    frame: Tensor | None
    stretched: Stretched | None


class Microfacet(Material):
    """Diffuse and microfacet lobes, of which every map is one that renderers know.

    Always there: `diffuse` [3, H, W], `specular_f0` [3, H, W] (0 and up; above 1 nothing that conserves energy) and `roughness`
    [1, H, W], 0 to 1, whose square is GGX's alpha. `parts` names what else there is; an absent part costs nothing:

    - "normal": `normal` [3, H, W]; on a relief it refines the height's.
    - "anisotropy": `roughness` is [2, H, W], along and across the direction that `rotation` [2, H, W], cosine and sine, turns
      from the tangent (filtered as a vector; its length does not matter, and of length 0 it is no turn).
    - "f90": `f90` [1, H, W], 0 to 1, what there is of the reflectance at grazing, all of it without the part.
    - "coat": a second lobe, isotropic and grey: `coat` [1, H, W], its F0, and `coat_roughness` [1, H, W].
    - "sheen": fibres, `sheen` [3, H, W], with Charlie's distribution (Estevez & Kulla 2017) of one `sheen_roughness` [1].
    - "rolloff": `rolloff` [2], T of both directions' cosines on the diffuse part.
    - "layered": what lies below gets through ``(1 - F(N.L)) (1 - F(N.V))``: of the coat, where there is one, else the diffuse
      part through the specular one.

    As glTF and OpenPBR name them: base colour and metalness or specular colour (`torchmat.models.renderers`), roughness,
    anisotropy with its direction, normal, coat, sheen. Alpha is at least 1e-3, so that nothing is infinite.
    """

    name = "microfacet"
    glsl = "microfacet.glsl"
    diffuse_map = "diffuse"

    def __init__(self, maps: Mapping[str, Tensor], *, parts: Sequence[str] = (), **settings: Any) -> None:
        for part in parts:
            check_option(self.name, "parts", part, MICROFACET_PARTS)
        self._kept: tuple[list[Tensor], list[tuple], _Prepared] | None = None
        super().__init__(maps, parts=[part for part in MICROFACET_PARTS if part in parts], **settings)

    def own_specs(self) -> tuple[MapSpec, ...]:
        return microfacet_specs(self.options["parts"])

    def surface(self) -> Microfacet:
        flat = super().surface()
        if not self.has_relief:
            return flat
        slopes = slopes_from_height(self.maps["height"], tiles=self.tiles)
        if "normal" in self.maps:
            slopes = slopes + slopes_from_normals(safe.normalise(self.maps["normal"]))
        parts = [part for part in MICROFACET_PARTS if part in (*self.options["parts"], "normal")]
        return flat._unchecked({**flat.maps, "normal": normals_from_slopes(slopes)}, options={**self.options, "parts": parts})

    @property
    def derives_normal(self) -> bool:
        return self.has_relief

    def from_surface(self, maps: Mapping[str, Tensor]) -> dict[str, Tensor]:
        found = super().from_surface(maps)
        if self.has_relief and "normal" in found:
            own = slopes_from_height(self.maps["height"], tiles=self.tiles)
            found["normal"] = normals_from_slopes(slopes_from_normals(maps["normal"]) - own)
        return found

    def value(self, light: Tensor, view: Tensor) -> Tensor:
        maps, parts = self.maps, self.options["parts"]
        total = light + view
        squared = (total * total).sum(dim=-3, keepdim=True).clamp(min=1e-24)
        half, rise = total * torch.rsqrt(squared), schlick_rise((1 - torch.sqrt(squared) / 2).clamp(min=0))
        known = self._prepared()
        if known.stretched is None:
            share = ggx_share(light, view, half, known.squares, _GRAZING)
            cosines = [direction[..., 2:3, :, :].clamp(min=0) for direction in (light, view)]
        else:
            share, *cosines = stretched_share(light, view, half, known.stretched, _GRAZING)
        found = torch.addcmul(share * (rise * known.f90), share * (1 - rise), maps["specular_f0"])
        diffuse = cosines[0]
        if "rolloff" in parts:
            diffuse = diffuse * self._rolled(cosines[0]) * self._rolled(cosines[1])
        through = self._through(known.f90, *cosines) if "layered" in parts else None
        if through is not None and "coat" not in parts:
            diffuse = diffuse * through
        found = torch.addcmul(found, maps["diffuse"], diffuse)
        if "coat" not in parts and "sheen" not in parts:
            return found
        if known.frame is not None:
            light, view, half = (combine(direction, known.frame) for direction in (light, view, half))
        if "coat" in parts:
            coat = ggx_share(light, view, half, squared_alpha(maps["coat_roughness"]), _GRAZING)
            found = (found if through is None else found * through) + coat * torch.lerp(maps["coat"], usual_f90(maps["coat"]), rise)
        return found + self._sheen(half, *cosines) if "sheen" in parts else found

    def in_one_pass(self, light: Tensor, view: Tensor) -> Tensor | None:
        return fast_microfacet.shown(light, view, dict(self.maps.items()), "layered" in self.options["parts"])

    def _rolled(self, cosine: Tensor) -> Tensor:
        first, last = self.maps["rolloff"].unbind()
        return (1 + first * (1 - cosine) + last * schlick_rise(1 - cosine)).clamp(min=0)

    def _f90(self) -> Tensor:
        usual = usual_f90(self.maps["specular_f0"])
        return usual * self.maps["f90"] if "f90" in self.maps else usual

    def _through(self, f90: Tensor, *cosines: Tensor) -> Tensor:
        """Return what gets through the coat, or the specular part, both ways: 1 - F of either cosine."""
        reflected = self.maps["coat"] if "coat" in self.maps else self.maps["specular_f0"]
        most = usual_f90(reflected) if "coat" in self.maps else f90
        one, other = ((1 - reflected - (most - reflected) * schlick_rise(1 - cosine)).clamp(min=0) for cosine in cosines)
        return one * other

    def _sheen(self, half: Tensor, n_dot_l: Tensor, n_dot_v: Tensor) -> Tensor:
        exponent = 1 / self.maps["sheen_roughness"].square()[:, None, None]
        sine = half[..., 0:1, :, :].square() + half[..., 1:2, :, :].square()
        peak = (2 + exponent) / 8 * safe.power(sine, exponent / 2)
        return self.maps["sheen"] * (peak * n_dot_l / (n_dot_l + n_dot_v - n_dot_l * n_dot_v + _GRAZING))

    def _prepared(self) -> _Prepared:
        """Return what the maps alone say. Without gradients it is kept for the next picture, as long as they are unchanged."""
        sources = [self.maps[name] for name in ("specular_f0", "roughness", "normal", "rotation", "f90") if name in self.maps]
        if torch.is_grad_enabled() or any(tensor.is_inference() for tensor in sources):
            return self._prepare()
        versions = [(tensor._version, tensor.data_ptr(), tensor.dtype) for tensor in sources]
        known = self._kept
        if known and known[1] == versions and all(a is b for a, b in zip(known[0], sources, strict=True)):
            return known[2]
        prepared = self._prepare()
        self._kept = (sources, versions, prepared)
        return prepared

    def _prepare(self) -> _Prepared:
        squares, frame = squared_alpha(self.maps["roughness"]), self._make_frame()
        return _Prepared(squares, self._f90(), frame, None if frame is None else Stretched.of(frame, squares))

    def _make_frame(self) -> Tensor | None:
        """Return tangent, bitangent and normal, turned by the rotation, as [xyz, 3, H, W]; None for the plane's own."""
        if "normal" not in self.maps and "rotation" not in self.maps:
            return None
        if "normal" in self.maps:
            normal = safe.normalise(self.maps["normal"])
        else:
            normal = torch.zeros(3, *self.size, dtype=self.dtype)
            normal[2] = 1
        tangent, bitangent = frames.tangent_frame(normal)
        if "rotation" in self.maps:
            cosine, sine = safe.normalise(self.maps["rotation"]).split(1)
            cosine = cosine + ((cosine == 0) & (sine == 0))  # a direction that is none is no turn
            tangent, bitangent = cosine * tangent + sine * bitangent, cosine * bitangent - sine * tangent
        return torch.stack((tangent, bitangent, normal), dim=1)
