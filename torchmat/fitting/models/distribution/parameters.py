"""What the fit of the distribution material turns: unbounded parameters, their starts, and the maps that they stand for."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from torchmat import colour, safe
from torchmat.btf import Btf
from torchmat.fitting.objective import OUTSTANDING
from torchmat.fitting.relief.surface import Surface
from torchmat.fitting.shared import Shared
from torchmat.fitting.training import Training
from torchmat.frames import half_vector, tangent_frame
from torchmat.geometry import normals_from_slopes
from torchmat.models.distribution import DISTRIBUTION_PARTS, default_tilt, distribution_specs
from torchmat.models.indirect import AMBIENT
from torchmat.models.parabolic import EVEN, evenly, texel_places
from torchmat.models.storage import MapSpec
from torchmat.models.unbounded import map_of, relative_rate
from torchmat.repeatable import one_thread

BLOCK_VALUES = 2_000_000
_SHARPEST = 0.1  # roughness to begin with: moments of samples degrees apart do not tell what is sharper
EXPONENT = "fresnel_exponent"
SCHLICK = 5.0  # the exponent of his approximation, where the fit of one begins
_LEVEL = 1e-3  # of the tilt at 0 and 90 degrees, which a logit does not reach


@dataclass(frozen=True)
class Parts:
    """What the material is made of: without lobes nothing that belongs to them."""

    lobes: int
    fresnel: bool
    rotation: bool
    tilt: bool = False
    normal: bool = True
    specular_mask: bool = True
    masking: bool = True
    spacing: str = EVEN

    @property
    def names(self) -> list[str]:
        """The optional parts of the model, the normal among them; a tilt takes the place of masking."""
        of_lobes = ("specular_mask", "fresnel", "rotation", "tilt", "masking")
        there = [name for name in of_lobes if self.lobes and getattr(self, name)]
        there = [name for name in there if name != "masking" or not self.tilt]
        return ["normal", *there] if self.normal else there


@dataclass(frozen=True)
class DistributionShared(Shared):
    """What all texels of a distribution material have in common, as its fit turns it.

    `level` is the mean value of the data, `groups` what groups its texels (`group_texels`), `log_specular`, `logit_tilt` and
    `log_masking` the parameters of the tables, `log_exponent` that of Fresnel's rise (less 1); None is a part that is not there.
    """

    level: float = 1.0
    log_specular: Tensor | None = None
    logit_tilt: Tensor | None = None
    log_masking: Tensor | None = None
    log_exponent: Tensor | None = None
    groups: Tensor | None = None

    @property
    def parameters(self) -> dict[str, Tensor]:
        """The parameters of the tables by the names of their maps."""
        found = {"specular": self.log_specular, "tilt": self.logit_tilt, "masking": self.log_masking, EXPONENT: self.log_exponent}
        return {name: value for name, value in found.items() if value is not None}

    @property
    def specular(self) -> Tensor:
        """The specular maps, in the scale in which masks of several fits compare."""
        return maps_of({"specular": self.parameters["specular"]})["specular"]


def sample_runs(btf: Btf) -> list[slice]:
    """Return runs of samples, each of few enough values to be worked on at once."""
    step = max(1, BLOCK_VALUES // (3 * btf.height * btf.width))
    return [slice(first, min(first + step, len(btf))) for first in range(0, len(btf), step)]


def raw_maps(
    starts: dict[str, Tensor], parts: Parts, size: int, training: Training, exponent: float | None = None
) -> dict[str, Tensor]:
    """Return the unbounded parameters that stand for the maps, at their starting values; one for an `exponent` of None."""
    dtype, mean = training.dtype, starts["mean"]
    generator = torch.Generator().manual_seed(training.seed)
    distance = evenly(texel_places(size, dtype), parts.spacing).square().sum(dim=0)
    noise = torch.randn(3 * parts.lobes, 1, 1, generator=generator, dtype=torch.float64).to(dtype)
    inside = inside_of(mean, training.btf.mask)
    with one_thread():
        brightness = float(inside.clamp(max=OUTSTANDING * float(inside.median())).mean())
    raw = {
        "diffuse": mean.log(),
        "ambient": (0.05 * mean).log(),
        "normal": starts["slopes"].clone(),
        "specular": (math.log(0.1 * brightness) + 0.01 * noise - 4 * distance).contiguous(),
        "specular_mask": torch.zeros_like(mean[:1]),
        "fresnel": torch.full_like(mean[:1], -2.0),
        "rotation": starts["rotation"].clone(),
        "tilt": torch.logit(default_tilt(dtype).clamp(_LEVEL, 1 - _LEVEL)),
        "masking": _start_masking(starts["width"], parts.rotation),
    }
    raw[EXPONENT] = torch.tensor([SCHLICK - 1], dtype=dtype).log()
    there = {"diffuse", "ambient", *parts.names} | ({"specular"} if parts.lobes else set())
    there |= {EXPONENT} if exponent is None and "fresnel" in there else set()
    raw = {name: value for name, value in raw.items() if name in there}
    if parts.lobes > 1:
        known = training.shared_as(DistributionShared)
        groups = None if known is None else known.groups
        if groups is None:
            groups = group_texels(inside_of(starts["features"], training.btf.mask), parts.lobes, training.seed)
        raw["index"] = _start_index(starts["features"], parts.lobes, groups)
    return raw


def _start_masking(width: Tensor, turned: bool) -> Tensor:
    """Return the logarithms of Smith's a_u, a_v: those of the highlights as they are, one for both where none is turned."""
    return (width if turned else width.square().mean().sqrt().expand(2)).log().clone()


def inside_of(maps: Tensor, mask: Tensor | None) -> Tensor:
    """Return maps [C, H, W] of an object's texels alone, [C, t, 1]; all of them without a mask."""
    return maps if mask is None or not bool(mask.any()) else maps[:, mask][:, :, None]


def to_one(maps: dict[str, Tensor], inside: Tensor | None = None) -> dict[str, Tensor]:
    """Return mask and specular maps of the same products, with a mask whose largest value is 1; nothing without a mask.

    The largest is that of the texels `inside` an object, bool [H, W], None for all.
    """
    if "specular_mask" not in maps:
        return {}
    mask = maps["specular_mask"]
    most = inside_of(mask, inside).max().clamp(min=torch.finfo(mask.dtype).tiny)
    return {"specular_mask": mask / most, "specular": maps["specular"] * most}


def group_texels(features: Tensor, lobes: int, seed: int) -> Tensor:
    """Return what groups texels by their features [C, ...]: rows mean, spread, and a centre a group, [2 + k, C].

    Centres are those of k-means over the features less their mean, by their spread; at most `lobes`, float64.
    """
    from sklearn.cluster import KMeans
    from threadpoolctl import threadpool_limits  # comes with scikit-learn

    rows = features.flatten(1).double()
    with one_thread():
        mean, spread = rows.mean(dim=1), rows.std(dim=1, correction=0).clamp(min=1e-3)
    scaled = ((rows.T - mean) / spread).numpy()
    some = scaled[:: max(1, len(scaled) // 20000)]
    clusters = min(lobes, len(np.unique(some, axis=0)))
    # Threads of k-means add their sums in the order in which they finish.
    with threadpool_limits(1, user_api="openmp"):
        found = KMeans(clusters, n_init=4, random_state=seed).fit(some)
    return torch.stack((mean, spread, *torch.from_numpy(found.cluster_centers_)))


def _start_index(features: Tensor, lobes: int, groups: Tensor) -> Tensor:
    """Return logits [lobes, H, W] that give each texel to its nearest group."""
    mean, spread, centres = groups[0, :, None, None], groups[1, :, None, None], groups[2:, :, None, None]
    placed = (features.double() - mean) / spread
    nearest = torch.stack([(placed - centre).square().sum(dim=0) for centre in centres]).argmin(dim=0)
    chosen = torch.nn.functional.one_hot(nearest, lobes).movedim(-1, 0).to(features.dtype)
    return (2 * chosen - 1).contiguous()


# No map of the material, which holds it as an option: the rise towards grazing of what reflects a part of the light.
_RISE = MapSpec(EXPONENT, "exponent of Fresnel's rise", layer_channels=1, low=1.0, constant=True)
_SPECS = {spec.name: spec for spec in (*distribution_specs(2, DISTRIBUTION_PARTS), AMBIENT, _RISE)}


def maps_of(raw: dict[str, Tensor]) -> dict[str, Tensor]:
    """Return the maps on the surface that parameters stand for: the `normal` is the whole one, height's and all."""
    return {name: map_of(_SPECS[name], value) for name, value in raw.items()}


def rates_of(raw: dict[str, Tensor]) -> list[float]:
    """Return how fast each parameter may go, relative to the others."""
    return [relative_rate(_SPECS[name]) for name in raw]


def anisotropy(surface: Surface, mean: Tensor, slopes: Tensor) -> dict[str, Tensor]:
    """Return the direction `rotation` [1, H, W] in which each texel's highlight is stretched, `features` [C, H, W], `width` [2].

    Second moments of what exceeds the mean, over the half vector's place on the parabolic map; features are the
    moments' size and shape, free of the direction, and the colour. The width is the roughness, along and across, of
    a surface with such moments.
    """
    btf, dtype = surface.training.btf, surface.training.dtype
    normal = normals_from_slopes(slopes)
    frame = torch.stack((*tangent_frame(normal), normal), dim=1).flatten(1)  # [xyz, rows of the frame x texels]
    sums = torch.zeros(6, btf.height * btf.width, dtype=dtype)
    level = colour.luminance(mean).flatten()
    for run in sample_runs(btf):
        values, valid = surface.values(run)
        along = _along(btf, run, frame)
        u, v = (safe.divide(axis, 1 + along[2].clamp(min=0)) for axis in along[:2])
        excess = (colour.luminance(values, dim=1).flatten(1) - level).clamp(min=0) * valid[:, 0].flatten(1)
        terms = (torch.ones_like(u), u, v, u * u - v * v, 2 * u * v, u * u + v * v)
        sums += torch.stack([(excess * term).sum(dim=0) for term in terms])
    with one_thread():
        return _moments(sums, level, mean, len(btf))


def _along(btf: Btf, run: slice, frame: Tensor) -> Sequence[Tensor]:
    """Return the half vectors of samples along the three rows of frames [3, 3 x texels], [k, texels] each."""
    if btf.near is None:
        half = half_vector(btf.light[run].to(frame.dtype), btf.view[run].to(frame.dtype), dim=-1)
        return (half @ frame).unflatten(1, (3, -1)).unbind(1)
    half = half_vector(*btf.directions(range(run.start, run.stop), frame.dtype)).flatten(2)
    return [(half * axis).sum(dim=1) for axis in frame.unflatten(1, (3, -1)).unbind(1)]


def _moments(sums: Tensor, level: Tensor, mean: Tensor, samples: int) -> dict[str, Tensor]:
    size = mean.shape[-2:]
    total = sums[0].clamp(min=1e-12)
    stretch = torch.stack((sums[3] - (sums[1] ** 2 - sums[2] ** 2) / total, sums[4] - 2 * sums[1] * sums[2] / total)) / total
    angle = torch.atan2(stretch[1], stretch[0]) / 2
    strength = stretch.square().sum(dim=0).sqrt()
    bright = torch.log1p(total / samples / level.clamp(min=1e-12))
    share = mean.flatten(1) / mean.flatten(1).sum(dim=0).clamp(min=1e-12)
    features = torch.stack((*share, bright, strength * 10))
    spread = (sums[5] - (sums[1] ** 2 + sums[2] ** 2) / total) / total
    axes = torch.stack(((spread + strength) / 2, (spread - strength) / 2)).clamp(min=0)
    # Half a slope is the place on the map, and half the square of a roughness the slopes' variance along each axis.
    width = (8 * (axes * sums[0]).sum(dim=1) / sums[0].sum().clamp(min=1e-12)).sqrt().clamp(_SHARPEST, 1)
    return {"rotation": angle.reshape(1, *size), "features": features.reshape(-1, *size), "width": width}
