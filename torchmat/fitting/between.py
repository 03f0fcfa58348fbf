"""How the light between texels is told, chosen per material: a map of it, the radiosity of the relief, or nothing."""

from __future__ import annotations

import math
from dataclasses import replace

import torch

from torchmat.errors import RangeError, message
from torchmat.fitting.evaluate import evaluate
from torchmat.fitting.training import Fitted, Training
from torchmat.models import Material
from torchmat.models.indirect import AMBIENT, FALLOFF, INDIRECT

AUTO, MAP, RADIOSITY, NONE = "auto", "map", "radiosity", "none"
WAYS = (AUTO, MAP, RADIOSITY, NONE)
_FACTORS = (0.5, 0.8, 1.0, 1.25, 1.6)  # of the radiosity of the diffuse colours, which may hold less or more than all that is sent
_SAMPLES = 24
_SHARE = 0.3  # of an ambient map that goes with the light's cosine, at first


def settled(training: Training, fitted: Fitted) -> Fitted:
    """Return a fit on a relief with its light between texels told as the training says; "auto" leaves it to the finish.

    Raises RangeError for radiosity of a material without a diffuse colour.
    """
    material, way = fitted.material, training.indirect
    if way == AUTO or not material.has_relief:
        return fitted
    if way == RADIOSITY:
        if not can_radiate(material):
            fact = f"{material.name} has no diffuse colour that sends light"
            step = 'Leave it out, or say indirect="map".'
            raise RangeError(message("fit", "indirect", "be possible for the model", fact, step))
        material = with_radiosity(training, material)
    elif way == NONE:
        material = without(material)
    return replace(fitted, material=material, figures={**fitted.figures, "indirect": way})


def can_radiate(material: Material) -> bool:
    """Return whether the light between texels can be told by radiosity."""
    return material.has_relief and material.diffuse_map is not None


def without(material: Material) -> Material:
    """Return the material on its relief without any light between texels."""
    return material.on_relief(material.maps["height"].detach())


def with_radiosity(training: Training, material: Material) -> Material:
    """Return the material with radiosity in the place of its map; its factor is that of a few which shows the samples best."""
    rows = training.used.nonzero()[:, 0]
    rows = rows[torch.linspace(0, len(rows) - 1, min(_SAMPLES, len(rows))).round().long()]
    best, found = -math.inf, without(material)
    for factor in _FACTORS:
        one = torch.tensor([factor], dtype=material.dtype)
        rival = material.on_relief(material.maps["height"].detach(), indirect=one)
        error = evaluate(rival, training.btf, rows, perceptual=False).report["psnr_db"]
        if error > best:
            best, found = error, rival
    return found


def with_falloff(training: Training, material: Material) -> Material:
    """Return the material with an ambient map that falls with the light's cosine, as bright as before on average."""
    if AMBIENT.name not in material.maps or FALLOFF.name in material.maps:
        return material
    cosine = float(training.btf.light[training.used][:, 2].double().clamp(min=0).mean())
    ambient = material.maps[AMBIENT.name].detach() / (1 - _SHARE + _SHARE * cosine)
    share = torch.tensor([_SHARE], dtype=material.dtype)
    return material.on_relief(material.maps["height"].detach(), ambient).with_maps(**{FALLOFF.name: share})


def way_of(material: Material) -> str:
    """Return how a material tells the light between texels: "map", "radiosity" or "none"."""
    if INDIRECT.name in material.maps:
        return RADIOSITY
    return MAP if AMBIENT.name in material.maps else NONE


def rivals(training: Training, material: Material) -> list[Material]:
    """Return the material in the ways among which a finish chooses, the present one first."""
    found = [with_falloff(training, material)]
    if training.indirect == AUTO and can_radiate(material) and way_of(material) == MAP:
        found.append(with_radiosity(training, material))
    return found


def chosen(errors: list[float], worth: float) -> int:
    """Return the number of the way to go on with: radiosity takes no map, which pays for being `worth` dB worse."""
    return max(range(len(errors)), key=lambda number: errors[number] + (worth if number else 0.0))
