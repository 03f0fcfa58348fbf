"""Microfacet maps as renderers name them: glTF 2.0 with its extensions, OpenPBR, and metalness; and back.

Roughness is the same number in all of them, the square root of GGX's alpha (Burley 2012). What changes is how two alphas
become a roughness and an anisotropy, and how diffuse and F0 become a base colour.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchmat import safe
from torchmat.models.ggx import usual_f90
from torchmat.models.microfacet import Microfacet

DIELECTRIC = 0.04  # F0 of an index of refraction of 1.5
_NEARLY_METAL = 1 - 1e-4


class Gltf(NamedTuple):
    """Maps [C, H, W] in the terms of glTF 2.0, linear; metalness is 0 and KHR_materials_specular holds F0.

    `base_colour`, `roughness`; `specular` is F90 and `specular_colour` F0 over 0.04 F90 (above 1 where it reflects more). With
    KHR_materials_anisotropy `anisotropy` is its strength and `direction` [2, H, W] where the highlight is longest, cosine
    and sine from the tangent. KHR_materials_clearcoat has `clearcoat` (above 1 where F0 is above 0.04) and `clearcoat_roughness`,
    KHR_materials_sheen `sheen_colour` and `sheen_roughness`. None is a part that is not there.
    """

    base_colour: Tensor
    roughness: Tensor
    specular_colour: Tensor
    specular: Tensor
    anisotropy: Tensor | None = None
    direction: Tensor | None = None
    normal: Tensor | None = None
    clearcoat: Tensor | None = None
    clearcoat_roughness: Tensor | None = None
    sheen_colour: Tensor | None = None
    sheen_roughness: Tensor | None = None


class OpenPbr(NamedTuple):
    """Maps [C, H, W] in the terms of OpenPBR 1.1, linear, with a base_metalness of 0.

    `specular_colour` is F0 over 0.04, that of the specular_ior of 1.5; `specular_roughness` and `specular_roughness_anisotropy` are
    its r and a, ``alpha_t = r^2 sqrt(2 / (1 + (1 - a)^2))`` and ``alpha_b = (1 - a) alpha_t``, with `direction` [2, H, W] the tangent.
    """

    base_colour: Tensor
    specular_colour: Tensor
    specular_roughness: Tensor
    specular_roughness_anisotropy: Tensor
    direction: Tensor


def sorted_alphas(material: Microfacet) -> tuple[Tensor, Tensor, Tensor]:
    """Return the larger and the smaller alpha [1, H, W], and the direction [2, H, W] of the larger."""
    roughness = material.maps["roughness"].detach()
    alpha = roughness * roughness
    if "rotation" not in material.maps:
        turn = torch.zeros(2, *material.size, dtype=material.dtype)
        turn[0] = 1
        return alpha, alpha, turn
    turn = safe.normalise(material.maps["rotation"].detach())
    across = alpha[1:] > alpha[:1]
    return alpha.amax(dim=0, keepdim=True), alpha.amin(dim=0, keepdim=True), torch.where(across, torch.stack((-turn[1], turn[0])), turn)


def as_gltf(material: Microfacet) -> Gltf:
    """Return the material's maps as glTF names them; its height, ambient light and `rolloff` have no place there.

    ``alpha_b = roughness^2`` and ``alpha_t = alpha_b + (1 - alpha_b) anisotropy^2`` are the smaller and the larger alpha.
    """
    maps = {name: value.detach() for name, value in material.maps.items()}
    most, least, direction = sorted_alphas(material)
    turned = "rotation" in maps
    f90 = usual_f90(maps["specular_f0"]) * maps.get("f90", 1.0)
    return Gltf(
        maps["diffuse"], least.sqrt(), safe.divide(maps["specular_f0"], DIELECTRIC * f90), f90,
        safe.sqrt(safe.divide(most - least, 1 - least)) if turned else None, direction if turned else None, maps.get("normal"),
        maps["coat"] / DIELECTRIC if "coat" in maps else None, maps.get("coat_roughness"), maps.get("sheen"), maps.get("sheen_roughness"),
    )


def as_openpbr(material: Microfacet) -> OpenPbr:
    """Return the material's base and specular maps as OpenPBR names them."""
    most, least, direction = sorted_alphas(material)
    ratio = safe.divide(least, most) + (most == 0)  # a mirror has no direction
    roughness = safe.sqrt(safe.divide(most, torch.sqrt(2 / (1 + ratio * ratio))))
    maps = material.maps
    return OpenPbr(maps["diffuse"].detach(), maps["specular_f0"].detach() / DIELECTRIC, roughness, 1 - ratio, direction)


def alphas_of_openpbr(roughness: Tensor, anisotropy: Tensor) -> Tensor:
    """Return alpha along and across [2, H, W] of OpenPBR's specular_roughness and specular_roughness_anisotropy."""
    along = roughness.square() * torch.sqrt(2 / (1 + (1 - anisotropy).square()))
    return torch.cat((along, (1 - anisotropy) * along))


def alphas_of_gltf(roughness: Tensor, anisotropy: Tensor) -> Tensor:
    """Return alpha along and across [2, H, W] of glTF's roughness and anisotropy strength."""
    across = roughness.square()
    return torch.cat((across + (1 - across) * anisotropy.square(), across))


def from_metalness(base_colour: Tensor, metalness: Tensor, f0: float = DIELECTRIC) -> tuple[Tensor, Tensor]:
    """Return diffuse and F0 [3, H, W] of a base colour and a metalness [1, H, W]: ``base (1 - m)``, ``f0 (1 - m) + base m``."""
    return base_colour * (1 - metalness), f0 * (1 - metalness) + base_colour * metalness


def to_metalness(diffuse: Tensor, specular_f0: Tensor, f0: float = DIELECTRIC) -> tuple[Tensor, Tensor]:
    """Return base colour [3, H, W] and metalness [1, H, W] from which `from_metalness` makes the nearest to both maps.

    Both are met exactly where there is a base colour that gives both; else the brightest channels d and s decide, by the root of ``f0 m^2 + (d + s - 2 f0) m + f0 - s = 0``, as in Khronos's conversion of specular and glossiness.
    """
    d, s = diffuse.amax(dim=0, keepdim=True), specular_f0.amax(dim=0, keepdim=True)
    linear, constant = d + s - 2 * f0, (f0 - s).clamp(max=0)
    root = safe.sqrt(linear.square() - 4 * f0 * constant)
    metalness = torch.where(s > f0, ((root - linear) / (2 * f0)).clamp(0, 1), torch.zeros_like(s))
    matte, shining = safe.divide(diffuse, 1 - metalness), safe.divide(specular_f0 - f0 * (1 - metalness), metalness).clamp(min=0)
    shining = torch.where(metalness > 0, shining, torch.zeros_like(shining))
    matte = torch.where(metalness < _NEARLY_METAL, matte, torch.zeros_like(matte))
    return torch.lerp(matte, shining, metalness * metalness), metalness
