"""The photographs that a report shows: which ones, as measured and as fitted, and how far apart the two are."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchmat import colour, frames
from torchmat.btf import Btf
from torchmat.btf.neighbours import how_far_beyond
from torchmat.fitting import FitResult, predict
from torchmat.metrics import SampleErrors
from torchmat.models import Material

_AS_GOOD_AS_MEASURED = 0.02  # in the parabolic disc: 1 to 2 degrees
_GREY = 0.214  # linear: half of white as displayed
_WHERE_NONE_IS_MEASURED = 16  # photographs that errors are taken of to choose among them


class Measured(NamedTuple):
    """The lights [n, 3] and views [m, 3] that a material knows."""

    lights: Tensor
    views: Tensor

    def beyond(self, light: Tensor, view: Tensor) -> list[bool]:
        """Return which of the pairs of `light` and `view` [k, 3] lie outside of what encloses the measured ones."""
        found = torch.zeros(len(light), dtype=torch.bool)
        for known, wanted in ((self.lights, light), (self.views, view)):
            known, above = known[known[:, 2] > 0], wanted[:, 2] > 0
            if not len(known):
                return [True] * len(light)
            found |= ~above
            if bool(above.any()):
                found[above] |= how_far_beyond(known, wanted[above]) > _AS_GOOD_AS_MEASURED
        return found.tolist()


class Shown(NamedTuple):
    """One photograph beside its fit.

    `why` says for what it was chosen; `target` and `fit` [3, H, W] are linear, divided by `scale` so that they can be seen;
    `difference` [H, W] is signed, fit less target, as displayed: its size the root mean square of the channels. The figures
    are of this photograph alone. `beyond` says that light or view lie outside of what the fit saw.
    """

    why: str
    sample: int
    light_deg: tuple[float, float]
    view_deg: tuple[float, float]
    target: Tensor
    fit: Tensor
    difference: Tensor
    scale: float
    relative_error: float | None
    psnr_db: float | None
    beyond: bool

    @property
    def directions(self) -> str:
        """Where light and view stand, polar angle and azimuth in degrees."""
        return f"light {degrees(self.light_deg)}, view {degrees(self.view_deg)}"

    @property
    def figures(self) -> str:
        """How far off the fit is, in words."""
        error = "" if self.relative_error is None else f"relative error {self.relative_error:.3g}"
        return ", ".join(filter(None, (error, "" if self.psnr_db is None else f"{self.psnr_db:.1f} dB")))

    @property
    def brightness(self) -> str:
        """How the pictures are scaled, in words."""
        return "shown as it is" if self.scale == 1.0 else f"shown {1 / self.scale:.1f} times brighter"


def polar_deg(direction: Tensor) -> tuple[float, float]:
    """Return polar angle and azimuth, 0 to 360, of a direction [3] in degrees."""
    polar, azimuth = (float(torch.rad2deg(angle)) for angle in frames.to_polar(direction))
    return polar, azimuth % 360


def degrees(angles: tuple[float, float]) -> str:
    """Return polar angle and azimuth as text."""
    return f"{angles[0]:.0f}°/{angles[1]:.0f}°"


def telling_samples(btf: Btf, result: FitResult) -> list[tuple[str, int]]:
    """Return (why, sample), no sample twice: of best, median and worst display error, and the most grazing of all.

    They are held-out samples; without any, some of those that were fitted, evenly chosen. What is telling for more than one
    reason stands there once, with all of them.
    """
    indices = result.split.held_out if len(result.split.held_out) else result.split.train
    errors = result.held_out_errors
    if errors is None or len(errors) != len(indices):
        places = torch.linspace(0, len(indices) - 1, min(len(indices), _WHERE_NONE_IS_MEASURED)).round().long()
        indices = indices[places]
        errors = torch.stack([_display_error(btf, result.material, sample) for sample in indices.tolist()])
    order = errors.nan_to_num(torch.inf).argsort(stable=True)
    graze = (btf.light[indices, 2] + btf.view[indices, 2]).argmin()
    chosen: dict[int, list[str]] = {}
    for why, place in (("best", order[0]), ("median", order[(len(order) - 1) // 2]), ("worst", order[-1]), ("most grazing", graze)):
        chosen.setdefault(int(indices[place]), []).append(why)
    return [(", ".join(reasons), sample) for sample, reasons in chosen.items()]


def shown_samples(btf: Btf, result: FitResult) -> list[Shown]:
    """Return the telling samples with their pictures, best first."""
    known = Measured(btf.light[result.split.train], btf.view[result.split.train])
    return [shown(btf, result.material, sample, why, known) for why, sample in telling_samples(btf, result)]


def nearest_sample(btf: Btf, light: Tensor, view: Tensor) -> int:
    """Return the number of the photograph whose light and view lie nearest to two unit vectors [3]: by the sum of both cosines."""
    return int((btf.light.double() @ light.double() + btf.view.double() @ view.double()).argmax())


def shown(btf: Btf, material: Material, sample: int, why: str, known: Measured | None = None) -> Shown:
    """Return one photograph beside what a material makes of it; `known` is what its fit saw, None for not saying so."""
    row = torch.tensor([sample])
    prediction = predict(material, btf, row)
    target = btf.images(row, prediction.dtype)
    errors = _errors(btf, prediction, target, row)
    figures = errors.pooled()
    valid = btf.valid(row)[0].expand_as(target[0])
    scale = _scale(target[0][valid])
    # Grey where nothing counts: off an object, and where nothing was measured.
    target, fit = (torch.where(valid, image[0].float() / scale, _GREY) for image in (target, prediction))
    apart = colour.display(fit) - colour.display(target)
    size = apart.square().mean(dim=0).sqrt()
    angles = polar_deg(btf.light[sample]), polar_deg(btf.view[sample])
    beyond = known is not None and known.beyond(btf.light[row], btf.view[row])[0]
    return Shown(
        why, sample, *angles, target, fit, torch.where(apart.mean(dim=0) < 0, -size, size), scale,
        figures["relative_error"], figures["psnr_db"], beyond,
    )


def _scale(values: Tensor) -> float:
    """Return the brightness that the values [n] of a photograph are divided by: grazing ones would otherwise be black."""
    if not len(values):
        return 1.0
    bright = float(values.float().sort().values[int(0.99 * (len(values) - 1))])
    return 1.0 if bright > 0.5 else max(bright, 1e-6)


def _errors(btf: Btf, prediction: Tensor, target: Tensor, row: Tensor) -> SampleErrors:
    errors = SampleErrors()
    errors.add(prediction, target, btf.valid(row), btf.saturated(row, target), torch.zeros(1, dtype=torch.bool))
    return errors


def _display_error(btf: Btf, material: Material, sample: int) -> Tensor:
    row = torch.tensor([sample])
    prediction = predict(material, btf, row)
    return _errors(btf, prediction, btf.images(row, prediction.dtype), row).per_sample_display()[0]


def difference_range(rows: Sequence[Shown]) -> float:
    """Return the one end of the colour bar of all rows: what a hundredth of the texels of the worst exceed, in two digits."""
    sizes = [row.difference[row.difference != 0].abs().sort().values for row in rows]  # where nothing counts it is 0
    most = max((float(values[int(0.99 * (len(values) - 1))]) for values in sizes if len(values)), default=0.0)
    return max(float(f"{most:.1g}"), 0.01) if most == most else 1.0
