"""A stack of ever brighter images, looked up by the brightness that a BRDF asks for (Kautz 2005, GPU Gems 2, ch. 11).

A BRDF says how bright a point should be under a light and view; the stack says how a texel looks when the surface is
as bright as that. So small shadows and highlights come from photographs of one view, everything else from the BRDF.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torchmat import frames, safe
from torchmat.brdf.analytic import ANALYTIC
from torchmat.brdf.analytic_brdf import AnalyticBrdf
from torchmat.brdf.base import Brdf
from torchmat.brdf.merl import MerlBrdf, tabulate
from torchmat.errors import RangeError, ShapeError, check_finite, check_option, message
from torchmat.models.base import Material, combine
from torchmat.models.storage import MapSpec

OVERFLOWS = ("clamp", "scale")
TABLE = "table"
SLICES = 8  # the chapter's number
TABLE_RESOLUTION = (90, 45, 36)  # bins of a measured BRDF's table: half polar, difference polar, difference azimuth
_MOST_SLICES, _MOST_AZIMUTHS = 64, 36


class ShadingMap(Material):
    """Stack of `slices` images per texel and one BRDF for the whole surface.

    The BRDF's value ``r = pi * f_r * cos(light)``, averaged over the channels, plus `ambient_level`, picks the layer
    ``r / brightest * (slices - 1)``, filtered linearly between slices (and within them, by `at`). (The chapter writes
    ``f_r cos`` and leaves its scale to the artist; with a value, r has the unit of the images' means.) `overflow` says
    what happens above `brightest`: "clamp" shows the last slice, "scale" multiplies it by ``r / brightest``.

    `brdf` is a key of ANALYTIC, "phong" being the chapter's, or "table" for any isotropic Brdf (`with_brdf`). Maps:
    `slices` [3 * azimuths * slices, H, W], an RGB texture a slice, slice 0 the darkest (the chapter's is black);
    `brightest` [1], the chapter's a_max; the BRDF's parameters `lobe`, or for "table" `reflectance` [1, half,
    difference * azimuth], a MerlBrdf's grey table in 1/sr with 36 bins of the azimuth. Past the chapter: with
    `azimuths` > 1 there is one stack for each of so many directions of the light, which are interpolated
    (`sector_weights`); sector 0 is lit from +x, its layers come first.
    """

    name = "shading_map"
    glsl = "shading_map.glsl"

    def __init__(
        self, maps: Mapping[str, Tensor], *, slices: int = SLICES, brdf: str = "phong", overflow: str = "clamp",
        azimuths: int = 1, ambient_level: float = 0.0, **settings: Any,
    ) -> None:
        check_slices(self.name, slices)
        check_azimuths(self.name, azimuths)
        check_option(self.name, "brdf", brdf, (*ANALYTIC, TABLE))
        check_option(self.name, "overflow", overflow, OVERFLOWS)
        if not 0 <= ambient_level < math.inf:
            fact = f"it is {ambient_level!r}"
            raise RangeError(message(self.name, "ambient_level", "be at least 0 and finite", fact, "0 is none."))
        self._lobe = ANALYTIC.get(brdf)
        options: dict[str, Any] = {
            "slices": slices, "brdf": brdf, "overflow": overflow, "azimuths": azimuths, "ambient_level": ambient_level,
        }
        super().__init__(maps, **options, **settings)
        self.isotropic = azimuths == 1 and (self._lobe is None or self._lobe.axis is None)
        if self._lobe is not None:
            AnalyticBrdf.from_parameters(brdf, self.maps["lobe"].detach())  # raises RangeError beyond the formula's bounds
        elif self.maps["reflectance"].shape[-1] % TABLE_RESOLUTION[-1]:
            requirement = f"be [1, half, {TABLE_RESOLUTION[-1]} * difference]"
            fact = f"it is {tuple(self.maps['reflectance'].shape)}"
            raise ShapeError(message(self.name, "reflectance", requirement, fact, "Use with_brdf."), map="reflectance")

    def own_specs(self) -> tuple[MapSpec, ...]:
        if self._lobe is None:
            # Mirrors exceed what a half holds.
            brdf = MapSpec("reflectance", "BRDF, 1/sr", layer_channels=1, low=0.0, per_texel=False, storage="float")
        else:
            names = self._lobe.names
            brdf = MapSpec("lobe", f"BRDF: {', '.join(names)}", layer_channels=len(names), constant=True)
        meaning = "surface as bright as the layer says"
        return (
            MapSpec("slices", meaning, layers=self._layers(), low=0.0, colour=True, linear=True),
            brdf,
            MapSpec("brightest", "mean value of the last slice", layer_channels=1, low=0.0, constant=True),
        )

    def _layers(self) -> tuple[str, ...]:
        slices, azimuths = self.options["slices"], self.options["azimuths"]
        if azimuths == 1:
            return tuple(map(str, range(slices)))
        return tuple(f"{sector}_{layer}" for sector in range(azimuths) for layer in range(slices))

    @property
    def parameters_by_name(self) -> dict[str, float]:
        """The BRDF's parameters by their names; none of a table."""
        if self._lobe is None:
            return {}
        return dict(zip(self._lobe.names, self.maps["lobe"].tolist(), strict=True))

    def with_brdf(self, brdf: Brdf) -> ShadingMap:
        """Return the material with another BRDF: a formula keeps its parameters, anything else becomes a table.

        `brightest` stays: scale it, or the BRDF, for another brightness. Raises RangeError for a BRDF that is neither a
        formula nor isotropic.
        """
        if isinstance(brdf, AnalyticBrdf):
            if brdf.parameters.ndim != 1:
                fact = f"its parameters are {tuple(brdf.parameters.shape)}"
                raise ShapeError(message(f"{self.name}.with_brdf", "brdf", "be one formula, not a batch", fact))
            name, parts = brdf.name, {"lobe": brdf.parameters.detach().to(self.dtype)}
        else:
            table = tabulate(brdf, TABLE_RESOLUTION).table.mean(dim=0, keepdim=True)
            name, parts = TABLE, {"reflectance": table.flatten(2).to(self.dtype)}
        kept = {key: value for key, value in self.maps.items() if key not in ("lobe", "reflectance")}
        options = {**self.options, "brdf": name}
        return ShadingMap({**kept, **parts}, **self.settings({**kept, **parts}), **options)

    def brightness(self, light: Tensor, view: Tensor) -> Tensor:
        """Return r [..., 1, h, w]: the BRDF's value, never negative, mean of the channels, plus `ambient_level`."""
        if self._lobe is None:
            value = MerlBrdf(self.maps["reflectance"].unflatten(2, (-1, TABLE_RESOLUTION[-1]))).value(light, view)
        else:
            value = self._lobe.evaluate(self.maps["lobe"], light, view)
        return value.mean(dim=-3, keepdim=True).clamp(min=0) + self.options["ambient_level"]

    def value(self, light: Tensor, view: Tensor) -> Tensor:
        r, brightest = self.brightness(light, view), self.maps["brightest"][:, None, None]
        place, count = layer_place(r, brightest, self.options["slices"]), self.options["slices"]
        stack = self.maps["slices"].unflatten(0, (-1, 3))
        if self.options["azimuths"] > 1:
            layers = layer_weights(place, count)
            sectors = sector_weights(light, self.options["azimuths"])
            found = combine((sectors[..., :, None, :, :] * layers[..., None, :, :, :]).flatten(-4, -3), stack)
        else:
            found = look_up_layer(stack, place)
        if self.options["overflow"] == "scale":
            found = found * torch.where(r > brightest, safe.divide(r, brightest), torch.ones_like(r))
        return found


def check_slices(where: str, count: object) -> None:
    """Raise RangeError unless `count` is a number of slices: the black one and at least one more."""
    if not isinstance(count, int) or isinstance(count, bool) or not 2 <= count <= _MOST_SLICES:
        step = f"Slice 0 is black, so at least one more is needed; {SLICES} is usual."
        requirement = f"be a whole number from 2 to {_MOST_SLICES}"
        raise RangeError(message(where, "slices", requirement, f"it is {count!r}", step))


def check_azimuths(where: str, count: object) -> None:
    """Raise RangeError unless `count` is a number of sectors."""
    if not isinstance(count, int) or isinstance(count, bool) or not 1 <= count <= _MOST_AZIMUTHS:
        step = "1 is the chapter's: one stack for all directions of the light."
        requirement = f"be a whole number from 1 to {_MOST_AZIMUTHS}"
        raise RangeError(message(where, "azimuths", requirement, f"it is {count!r}", step))


def layer_place(r: Tensor, brightest: Tensor, count: int) -> Tensor:
    """Return the layer ``r / brightest * (count - 1)``, within [0, count - 1]; 0 where `brightest` is 0."""
    # Above the brightest slice the gradient is 0, so the quotient is taken of what is not above: it cannot overflow.
    return safe.divide(torch.minimum(r, brightest), brightest).clamp(0, 1) * (count - 1)


def layer_weights(place: Tensor, count: int) -> Tensor:
    """Return the weight of each layer [..., count, h, w] at `place` [..., 1, h, w]: linear between neighbours."""
    below = place.detach().floor().clamp(max=count - 2)
    return _between(place - below, below, below + 1, count)


def sector_weights(light: Tensor, count: int) -> Tensor:
    """Return the weight of each sector [..., count, h, w] for light directions [..., 3, h, w]; they sum to 1.

    Sector j is lit from azimuth ``2 pi j / count``; weights are linear between neighbours, all the way round. The
    azimuth has no meaning where the light is at the normal, so with s the sine of the polar angle a share 1 - s goes to
    all sectors alike, and the value changes smoothly there.
    """
    if count == 1:
        return torch.ones_like(light[..., :1, :, :])
    _, azimuth = frames.to_polar(light, dim=-3)
    x, y = light[..., 0:1, :, :], light[..., 1:2, :, :]
    sine = safe.sqrt(x * x + y * y).clamp(max=1)
    place = azimuth.unsqueeze(-3) * (count / (2 * math.pi))
    below = place.detach().floor()
    near = _between(place - below, below % count, (below + 1) % count, count)
    return (1 - sine) / count + sine * near


def _between(share: Tensor, below: Tensor, above: Tensor, count: int) -> Tensor:
    """Return weights [..., count, h, w]: `share` for number `above`, the rest for `below`, each [..., 1, h, w].

    Sums of absolute values and clamps would give the same, but at the very numbers a gradient of neither side.
    """
    numbers = torch.arange(count, dtype=share.dtype)[:, None, None]
    rest = torch.where(numbers == above, share, torch.zeros((), dtype=share.dtype))
    return torch.where(numbers == below, 1 - share, rest)


def look_up_layer(stack: Tensor, place: Tensor) -> Tensor:
    """Return layers [K, 3, H, W] at `place` [..., 1, h, w], linear between two neighbours.

    One image needs two slices; many at once are one matrix product; per-texel places gather two values a texel, not K.
    """
    count = len(stack)
    below = place.detach().floor().clamp(max=count - 2).long()
    if place.shape[-2:] != (1, 1):
        return _gathered(stack, place, below)
    if place.numel() == 1:
        first = int(below)
        found = torch.lerp(stack[first], stack[first + 1], (place - first).reshape(()))
        return found.reshape(*place.shape[:-3], *stack.shape[1:])
    return combine(layer_weights(place, count), stack)


def _gathered(stack: Tensor, place: Tensor, below: Tensor) -> Tensor:
    lead, size = place.shape[:-3], tuple(stack.shape[-2:])
    index = below.expand(*lead, 3, *size).reshape(-1, 3, *size)
    share = (place - below).reshape(-1, 1, *place.shape[-2:])
    found = torch.lerp(stack.gather(0, index), stack.gather(0, index + 1), share)
    return found.reshape(*lead, 3, *size)


def assemble(images: Tensor, count: int = SLICES) -> tuple[Tensor, Tensor]:
    """Resample images [k, 3, H, W] to a stack [3 * count, H, W] whose mean grows linearly; return it and a_max [1].

    Slice i has the mean ``r_i = a_max * i / (count - 1)`` (eq. 1), a_max being the largest mean of an image: the blend
    of the two images whose means lie below and above r_i. A black image stands below the darkest, so slice 0 is black.
    Images are sorted by their means, which need not grow with the angle of the light; of several with one mean those
    above use the last, those below the first. Values are linear and at least 0. Raises ShapeError, RangeError for
    values that are negative or not finite, and when every image is black.
    """
    check_slices("assemble", count)
    if images.ndim != 4 or images.shape[1] != 3 or 0 in images.shape or not images.is_floating_point():
        fact = f"they are {tuple(images.shape)} of {images.dtype}"
        raise ShapeError(message("assemble", "images", "be floating point, [k, 3, H, W] with no dimension of 0", fact))
    means = images.mean(dim=(2, 3)).double().mean(dim=1)
    _check_images(images, means)
    found = brackets(means, count)
    return blend_brackets(images, found).flatten(0, 1), found.brightest.to(images.dtype)


class Brackets(NamedTuple):
    """For each slice above the black one: ``(1 - share) * image[lower] + share * image[upper]``; lower -1 is black.

    `lower`, `upper` [count - 1] are numbers of images, `share` [count - 1] in [0, 1]; `brightest` [1] is a_max.
    """

    lower: Tensor
    upper: Tensor
    share: Tensor
    brightest: Tensor


def brackets(means: Tensor, count: int) -> Brackets:
    """Return which two of the images with `means` [k], float64, one of them positive, each slice is blended of."""
    means, order = means.sort(stable=True)
    brightest = means[-1:]
    wanted = brightest * torch.arange(1, count, dtype=torch.float64) / (count - 1)
    wanted[-1] = means[-1]
    upper = torch.searchsorted(means, wanted)  # the first image that is at least as bright, so the one below is darker
    lower = torch.where(upper > 0, order[(upper - 1).clamp(min=0)], torch.tensor(-1))
    low = torch.where(upper > 0, means[(upper - 1).clamp(min=0)], torch.zeros((), dtype=torch.float64)).clamp(min=0)
    return Brackets(lower, order[upper], (wanted - low) / (means[upper] - low), brightest)


def blend_brackets(images: Tensor, found: Brackets) -> Tensor:
    """Return the slices [count, 3, H, W], slice 0 black, of images [k, 3, H, W]."""
    slices = images.new_zeros(len(found.upper) + 1, *images.shape[1:])
    numbers = zip(found.lower.tolist(), found.upper.tolist(), found.share.tolist(), strict=True)
    for slot, (lower, upper, share) in zip(slices[1:], numbers, strict=True):
        slot.copy_(torch.lerp(images[lower] if lower >= 0 else torch.zeros_like(slot), images[upper], share))
    return slices


def _check_images(images: Tensor, means: Tensor) -> None:
    if not bool(torch.isfinite(means).all()):
        check_finite("assemble", "images", images, "Repair those values.")
    lowest = float(images.min())
    if lowest < 0:
        step = "Set noise below 0 to 0."
        raise RangeError(message("assemble", "images", "be at least 0", f"the least value is {lowest:.6g}", step))
    if not bool(means.max() > 0):
        step = "Check the exposure and the directions of the lights."
        raise RangeError(message("assemble", "images", "hold one that is not black", f"all {len(images)} are", step))
