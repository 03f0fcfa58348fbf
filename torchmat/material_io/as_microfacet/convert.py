"""Which way a material becomes a microfacet one: its maps as they are, its lobes fitted, or all of it sampled."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from torchmat.errors import RangeError, message
from torchmat.material_io.as_microfacet.error import shading_error, thinned
from torchmat.material_io.as_microfacet.lobes import Lobes, fit_lobes, kinds_of, schlick_terms, weights_of
from torchmat.material_io.as_microfacet.sampled import from_samples
from torchmat.models import Distribution, Lambert, Material, Microfacet, Texture
from torchmat.models.ggx import usual_f90
from torchmat.models.microfacet import MICROFACET_PARTS

_TRIED_ON = 512  # texels
_NEVER = ("pca", "local_pca")  # what is known at the measured directions alone


def as_microfacet(material: Material) -> Microfacet:
    """Return the microfacet material, flat and without gradients, that shades like the surface of any other.

    A microfacet material is its own, without its relief: normals are the whole ones. Of a distribution material every
    texel keeps diffuse, normal, mask, Fresnel and rotation, and its specular maps become GGX lobes. Of others,
    sampled over the hemisphere, diffuse and F0 are found in closed form, with one roughness, or one a texel where that pays.
    `shading_error` says how near it comes. Opacity stays. Raises RangeError for a model that knows measured directions
    alone.
    """
    if material.name in _NEVER:
        step = "Fit 'microfacet' or 'distribution' to the same images."
        fact = f"{material.name} knows the directions that were measured and no others"
        raise RangeError(message("as_microfacet", "the material", "be a BRDF", fact, step))
    way = next((one for kind, one in _WAYS.items() if isinstance(material, kind)), from_samples)
    with torch.no_grad():
        found = way(material if material.dtype == torch.float32 else _single(material))
    opacity = {"opacity": material.maps["opacity"].detach().float()} if "opacity" in material.maps else {}
    maps = {name: value.detach().clone() for name, value in found.maps.items()}
    return Microfacet({**maps, **opacity}, parts=found.options["parts"], tiles=material.tiles, storage=material.storage, cutout=material.cutout)


def _single(material: Material) -> Material:
    return material._like({name: value.detach().float() for name, value in material.maps.items()})


def _itself(material: Material) -> Material:
    return material.surface()


def _matte(albedo: Tensor, normal: Tensor | None) -> Microfacet:
    maps = {"diffuse": albedo, "specular_f0": torch.zeros_like(albedo), "roughness": torch.ones_like(albedo[:1])}
    return Microfacet(maps if normal is None else {**maps, "normal": normal}, parts=() if normal is None else ("normal",))


def _of_texture(material: Material) -> Microfacet:
    return _matte(material.maps["albedo"], None)


def _of_lambert(material: Material) -> Microfacet:
    flat = material.surface()
    return _matte(flat.maps["albedo"], flat.maps["normal"])


def _of_distribution(material: Material) -> Microfacet:
    assert isinstance(material, Distribution)
    flat = material.surface()
    maps = flat.maps
    if not material.options["lobes"]:
        return _matte(maps["diffuse"], maps["normal"] if "normal" in maps else None)
    one = torch.ones_like(maps["diffuse"][:1])
    mask, fresnel = (maps[name] if name in maps else one for name in ("specular_mask", "fresnel"))
    mass = mask.mean(dim=0, keepdim=True)
    r0 = float(((mass * fresnel).sum() / mass.sum()).clamp(0, 1)) if bool(mass.sum() > 0) else 1.0
    kinds, terms = kinds_of(maps["index"] if "index" in maps else one), schlick_terms(material.options["fresnel_exponent"])
    few, shapes = thinned(flat, _TRIED_ON), _shapes(flat, kinds, r0)
    ends = [r0 + (1 - r0) * end for end in (terms[0], sum(terms))]
    # F90 cannot be above 1, which the fit of a lobe does not know: what comes of both says which to take.
    tried = [fit_lobes(shapes, ends[0], ends[1], lifted) for lifted in (False, True)]
    errors = [shading_error(few, _assembled(few, kinds, lobes, terms)) for lobes in tried]
    return _assembled(flat, kinds, tried[1] if errors[1] < errors[0] else tried[0], terms)


def _assembled(flat: Material, kinds: Tensor, lobes: Lobes, terms: tuple[float, float]) -> Microfacet:
    """Return the microfacet material of a flat distribution one whose mixtures `kinds` of specular maps are `lobes`."""
    maps, (a, b) = flat.maps, terms
    one = torch.ones_like(maps["diffuse"][:1])
    mask, fresnel = (maps[name] if name in maps else one for name in ("specular_mask", "fresnel"))
    weights = weights_of(maps["index"] if "index" in maps else one, kinds)

    def mixed(values: Tensor) -> Tensor:
        return torch.einsum("jhw,j...->...hw", weights, values.to(weights.dtype))

    strength, bright = mask * mixed(lobes.strength), lobes.strength.mean(dim=1)
    usual = mixed(bright).clamp(min=1e-12)
    roots = torch.stack([mixed(bright * root.square()) / usual for root in (lobes.along, lobes.across)]).sqrt().clamp(1e-3, 1)
    f0 = strength * (fresnel + (1 - fresnel) * a)
    grazing = mixed(bright * lobes.lift) / usual * (fresnel + (1 - fresnel) * (a + b))
    f90 = strength.mean(dim=0, keepdim=True) * grazing / usual_f90(f0).clamp(min=1e-6)
    made = {
        "diffuse": maps["diffuse"] + mask * mixed(lobes.diffuse), "specular_f0": f0, "f90": f90.clamp(0, 1), "roughness": roots,
    }
    parts = {"f90", "anisotropy"}
    if "normal" in maps:
        made["normal"] = maps["normal"]
        parts.add("normal")
    turns = [mixed(bright * turn(2 * lobes.turn)) for turn in (torch.cos, torch.sin)]
    made["rotation"] = _turned(maps["rotation"] if "rotation" in maps else None, *turns)
    if "rotation" not in maps and bool((roots[0] - roots[1]).abs().max() < 1e-3):
        made["roughness"] = roots.mean(dim=0, keepdim=True)
        del made["rotation"]
        parts -= {"anisotropy"}
    return Microfacet(made, parts=[part for part in MICROFACET_PARTS if part in parts])


def _turned(rotation: Tensor | None, cosine: Tensor, sine: Tensor) -> Tensor:
    """Return a rotation [2, H, W] turned further by half the angle of (cosine, sine) [H, W]."""
    angle = torch.atan2(sine, cosine) / 2
    cosine, sine = torch.cos(angle), torch.sin(angle)
    if rotation is None:
        return torch.stack((cosine, sine))
    x, y = rotation
    return torch.stack((x * cosine - y * sine, y * cosine + x * sine)).clamp(-1, 1)


def _shapes(flat: Distribution, kinds: Tensor, r0: float) -> Distribution:
    """Return one texel of each mixture of lobes: neither diffuse nor mask nor turn, and one Fresnel."""
    count, dtype = len(kinds), flat.dtype
    maps = {"diffuse": torch.zeros(3, 1, count, dtype=dtype), "specular": flat.maps["specular"]}
    maps |= {name: flat.maps[name] for name in ("tilt", "masking") if name in flat.maps}
    if flat.options["lobes"] > 1:
        maps["index"] = kinds.T[:, None].to(dtype)
    maps["fresnel"] = torch.full((1, 1, count), r0, dtype=dtype)
    parts = [name for name in ("fresnel", "tilt", "masking") if name in maps]
    kept = {name: flat.options[name] for name in ("lobes", "fresnel_exponent", "specular_spacing") if name in flat.options}
    return Distribution(maps, parts=parts, **kept)


_WAYS: dict[type[Material], Callable[..., Material]] = {
    Microfacet: _itself, Texture: _of_texture, Lambert: _of_lambert, Distribution: _of_distribution,
}
