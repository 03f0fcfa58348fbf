"""Rungs of the automatic choice, from cheap to dear: models, and the parts of the distribution material."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from torch import Tensor

from torchmat.fitting.recipes import default_options
from torchmat.models.storage import StoredAs

_NUMBER = StoredAs((1, 1))


@dataclass(frozen=True)
class Rung:
    """One candidate: a model with its options, and maps that are stored as numbers from the start.

    `bytes` is what its maps take a texel, in 8 bits.
    """

    name: str
    model: str
    bytes: float
    options: Mapping[str, Any] = field(default_factory=dict)
    stored: Mapping[str, StoredAs] = field(default_factory=dict)

    @property
    def settings(self) -> dict[str, Any]:
        """The options of the fit: 8-bit textures, which some maps may be too good for (`shrink`)."""
        return {**self.options, "storage": "png8"}


def named(rung: Rung, height: Tensor | None) -> str:
    """Return the name of a candidate, flat or on a relief."""
    return rung.name if height is None else f"{rung.name} on relief"


# In the order of their bytes; what two rungs share is fitted once.
CLOSED_FORMS = (
    Rung("constant", "texture", 0, {}, {"albedo": _NUMBER}),
    Rung("Phong", "phong_srf", 0, {"residual": "cosine"}, {"residual": _NUMBER}),
    Rung("texture", "texture", 3),
    Rung("Phong + texture", "phong_srf", 3, {"residual": "cosine"}),
    Rung("Lambert", "lambert", 6),
    Rung("luminance PTM", "lptm", 9),
    Rung("Phong + residual of the half vector", "phong_srf", 9, {"residual": "half"}),
    Rung("4 harmonics", "hsh", 12, {"terms": 4}),
    Rung("PTM", "ptm", 18),
    Rung("Phong + residual of half vector and light", "phong_srf", 21, {"residual": "half_light"}),
    Rung("9 harmonics", "hsh", 27, {"terms": 9}),
)
RELIEF_BYTES = 5  # height and ambient

_BARE = {"lobes": 1, "fresnel": "no", "rotation": "no", "normal": "no", "specular_mask": "no", "tilt": "no"}


@dataclass(frozen=True)
class Part:
    """Something that may be added to the distribution material: bytes a texel of its map, the options that ask for it."""

    name: str
    bytes: float
    options: Mapping[str, Any] = field(hash=False)

    @property
    def lobes(self) -> int:
        """How many lobes it makes, 0 if it is about something else."""
        return self.options.get("lobes", 0)


_PARTS = (
    Part("mask", 1, {"specular_mask": "yes"}), Part("Fresnel", 1, {"fresnel": "yes"}),
    Part("rotation", 2, {"rotation": "yes"}), Part("normal", 3, {"normal": "yes"}), Part("2 lobes", 2, {"lobes": 2}),
    Part("3 lobes", 1, {"lobes": 3}), Part("tilt", 0, {"tilt": "yes"}),
)


def distribution_rung(options: Mapping[str, Any], parts: tuple[str, ...] = ()) -> Rung:
    """Return the distribution material with these options, called after its parts."""
    return Rung(" + ".join(("distribution", *parts)), "distribution", 4, options)


def bare_distribution() -> dict[str, Any]:
    """Return the options of the distribution material with the fewest parts."""
    return {name: value for name, value in _BARE.items() if name in default_options("distribution")}


def distribution_parts() -> list[Part]:
    """Return what may be added to it, in the order of trying."""
    return [part for part in _PARTS if set(part.options) <= set(default_options("distribution"))]
