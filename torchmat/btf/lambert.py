"""How far Lambert's law explains a capture of one view: a figure for its lights, its encoding and its intensities."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import torch
from torch import Tensor

from torchmat.errors import RangeError, message
from torchmat.geometry.lambert import estimate_intensities, lambert_residual
from torchmat.geometry.from_photographs import Relief, relief_from_stereo
from torchmat.geometry.photometric_stereo import Stereo, photometric_stereo

if TYPE_CHECKING:
    from torchmat.btf.btf import Btf

TEXELS = 1024  # are looked at, evenly chosen: sixteen times as many change the figures by less than three hundredths of them
GOOD, WRONG = 0.1, 0.25  # residuals of matte surfaces, and of lights that do not belong to their photographs
_STEREO_VALUES = 32_000_000  # of photometric stereo at a time
_SMALL, _TINY = 0.05, 0.01  # a residual below leaves nothing for other intensities, and for another encoding, to explain: smooth relief has little
_BETTER = 0.6  # another encoding or other intensities must leave less than so much of the residual, before they are named
_FAR_BETTER = 0.3  # where the residual is small: of noise alone, which a curve makes twice as strong, the other way leaves half
_NO_BETTER = 0.5  # of what lights dealt out at random leave: above, the pairing explains little
_UNLIKE = 1.1  # lights whose intensities differ by less are taken for equal


class Lambert(NamedTuple):
    """What Lambert's law leaves of a capture (`lambert_residual`).

    `residual` with lights and `encoding` as they are taken, `shuffled` with the same lights dealt out at random,
    `estimated` with intensities that fit best, `others` the best of other encodings (both only where the residual is not
    small anyway).
    """

    residual: float
    shuffled: float
    encoding: str
    estimated: float | None
    others: dict[str, float]

    def sentence(self) -> str:
        """Return the figure in words."""
        word = "good" if self.residual < GOOD else "fair" if self.residual < WRONG else "poor"
        return f"{self.residual:.3f} ({word}; lower is better, lights dealt out at random leave {self.shuffled:.3f})"

    def warnings(self) -> list[str]:
        """Return what the residuals say against the lights, their intensities, or the encoding."""
        found, best = [], self.residual if self.estimated is None else min(self.residual, self.estimated)
        for other, residual in self.others.items():
            if residual < (_BETTER if self.residual >= _SMALL else _FAR_BETTER) * best:
                found.append(
                    f"read as {self.encoding} the photographs leave a Lambert residual of {best:.3f}, read as {other} {residual:.3f}: "
                    f"if they are {other}, say --encoding {other} (encoding={other!r})"
                )
        if not found and best < _BETTER * self.residual:
            found.append(
                f"the lights seem not to be equally bright: with intensities that fit best the Lambert residual falls from "
                f"{self.residual:.3f} to {best:.3f}. Give --intensities FILE, or --intensities estimate (intensities=\"estimate\")"
            )
        least = min((best, *self.others.values()))
        if least > WRONG or least > _NO_BETTER * self.shuffled:
            found.append(
                f"the lights hardly explain the photographs (Lambert residual {self.residual:.3f}, {self.shuffled:.3f} with lights dealt "
                "out at random): check which photograph has which light, and whether the surface is matte"
            )
        return found

    def with_intensities(self, after: Lambert) -> Lambert:
        """Return the figures of the same capture `after` it was divided by estimated intensities."""
        return after._replace(others=after.others or self.others)

    def report(self) -> dict[str, Any]:
        """Return the figures, and the warnings, for a report."""
        return {**self._asdict(), "meaning": self.sentence(), "warnings": self.warnings()}


class _Sample(NamedTuple):
    """Some texels of the most frontal view, under the lights above the surface."""

    btf: Btf
    rows: Tensor

    def read_as(self, encoding: str) -> _Sample:
        return _Sample(self.btf.read_as(encoding), self.rows)

    def _seen(self) -> tuple[Tensor, Tensor]:
        """Return images [n, 3, h, w] and weights [n, 1, h, w], of an object alone [n, ..., t, 1]."""
        images, weight, mask = self.btf.images(self.rows), self.btf.weights(self.rows), self.btf.mask
        if mask is None or not bool(mask.any()):
            return images, weight
        return images[:, :, mask][..., None], weight[:, :, mask][..., None]

    def residual(self, order: Tensor | None = None, intensity: Tensor | None = None) -> float:
        """Return the residual, with the lights in another `order` [n] or divided by intensities [n, 3]."""
        images, weight = self._seen()
        if intensity is not None:
            images = images / intensity[:, :, None, None].to(images.dtype)
        light = self._lights(self.rows if order is None else self.rows[order])
        return lambert_residual(images, light, photometric_stereo(images, light, weight))

    def _lights(self, rows: Tensor) -> Tensor:
        """Return the lights of samples as photometric stereo takes them, of an object alone where there is a mask."""
        light, mask = lights_of(self.btf, rows), self.btf.mask
        return light[:, :, mask][..., None] if light.ndim == 4 and mask is not None and bool(mask.any()) else light

    def intensities(self) -> Tensor | None:
        images, weight = self._seen()
        return estimate_intensities(images, self._lights(self.rows), weight)

    def best(self, known: float) -> float:
        """Return the residual with the intensities that fit best, if it is below what is `known`."""
        found = self.intensities()
        return known if found is None else min(known, self.residual(intensity=found))


def lights_of(btf: Btf, rows: Tensor, dtype: torch.dtype | None = None) -> Tensor:
    """Return the lights of samples as photometric stereo takes them: [n, 3], or [n, 3, H, W] of near ones."""
    light = btf.directions(rows, dtype)[0]
    return light[:, :, 0, 0] if btf.light_position is None else light


def stereo_of(btf: Btf, rows: Tensor, dtype: torch.dtype) -> Stereo:
    """Return what photometric stereo finds of samples of one view, so many rows of texels at a time that memory is bounded."""
    some = max(1, _STEREO_VALUES // (3 * len(rows) * btf.width))
    bands = [btf.window(top, 0, min(some, btf.height - top), btf.width) for top in range(0, btf.height, some)]
    found = [_stereo_of(band, rows, dtype) for band in bands]
    return Stereo(*(torch.cat(maps, dim=1) for maps in zip(*found, strict=True)))


def _stereo_of(band: Btf, rows: Tensor, dtype: torch.dtype) -> Stereo:
    """Return what some rows of texels show; where none of them shows the object their weights alone say so."""
    mask = band.mask if band.mask is not None and bool(band.mask.any()) else None
    return photometric_stereo(band.images(rows, dtype), lights_of(band, rows, dtype), band.weights(rows), mask)


def relief_of_one_view(
    btf: Btf, rows: Tensor, dtype: torch.dtype, tiles: bool = False, integration: str = "poisson"
) -> Relief:
    """Return the relief that samples of one view show (`relief_from_photographs`).

    Under near lights it is found twice: directions and fall-off of the second time are those of texels as high as the first
    time found them. What is left of the height's own error changes neither by much. One view does not say how high all of it
    stands: a surface lies around the plane of the positions, an object inside a mask with its border on it.
    """
    found = relief_from_stereo(stereo_of(btf, rows, dtype), tiles, integration, btf.mask)
    if btf.light_position is None:
        return found
    base = 0.0 if btf.mask is None else float(found.height[:, ~btf.mask].mean())
    raised = btf.with_near(btf.near and btf.near.raised(found.height - base))
    return relief_from_stereo(stereo_of(raised, rows, dtype), tiles, integration, btf.mask)


def _sample(btf: Btf) -> _Sample:
    step = max(1, int((btf.height * btf.width / TEXELS) ** 0.5))
    return _Sample(btf.window(0, 0, btf.height, btf.width, step), (btf.light[:, 2] > 0).nonzero()[:, 0])


def one_view(btf: Btf) -> bool:
    """Tell whether a capture is of one view, under lights that photometric stereo can do with."""
    light = btf.light[btf.light[:, 2] > 0].double()
    if len(btf.views) > 1 or len(light) < 4:
        return False
    values = torch.linalg.svdvals(light)
    return float(values[2]) > 0.02 * float(values[0])


def lambert_of(btf: Btf) -> Lambert | None:
    """Return how far Lambert's law explains a capture of one view, on some texels; None where it says nothing."""
    if not one_view(btf):
        return None
    sample = _sample(btf)
    order = torch.randperm(len(sample.rows), generator=torch.Generator().manual_seed(0))
    residual, shuffled = sample.residual(), sample.residual(order)
    if residual < _TINY:
        return Lambert(residual, shuffled, btf.encoding, None, {})
    others = {}
    if btf.stored_dtype in ("uint8", "uint16"):
        others = {name: sample.read_as(name) for name in ("srgb", "linear") if name != btf.encoding}
    return Lambert(
        residual, shuffled, btf.encoding, None if residual < _SMALL else sample.best(residual),
        {name: other.best(other.residual()) for name, other in others.items()},
    )


def with_estimated_intensities(btf: Btf, only_if_better: bool = False) -> Btf:
    """Return a capture of one view divided by the intensities of its lights, estimated on some of its texels.

    `only_if_better` where that takes a good part of the Lambert residual away; a note says what was found. Raises
    RangeError where there are several views, or too few lights, or some below the surface.
    """
    if not one_view(btf) or not bool((btf.light[:, 2] > 0).all()):
        fact = f"there are {len(btf.views)} views and {len(btf.lights)} lights"
        step = "Give a file of intensities, or none."
        requirement = "be of one view under 4 lights or more, above the surface and not in a plane"
        raise RangeError(message(btf.source.path, "photographs whose intensities are estimated", requirement, fact, step))
    sample = _sample(btf)
    intensity = sample.intensities()
    if intensity is None:
        return btf.noted("the lights are taken to be equally bright: no intensities explain the photographs better")
    before, after = sample.residual(), sample.residual(intensity=intensity)
    spread = f"{float(intensity.min()):.3g} to {float(intensity.max()):.3g}"
    if only_if_better and (before < _SMALL or after > _BETTER * before or float(intensity.max() / intensity.min()) < _UNLIKE):
        return btf.noted(
            "no intensities are given, and the lights are taken to be equally bright (those that fit best, "
            f"{spread}, leave a Lambert residual of {after:.3f}, not {before:.3f})"
        )
    note = f"intensities of the lights are estimated, {spread}: the Lambert residual goes from {before:.3f} to {after:.3f}"
    return btf.divided_by(intensity if btf.intensity is None else intensity * btf.intensity, note)
