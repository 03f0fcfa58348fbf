"""What a candidate of the choice is judged by: its errors on samples kept back, and the one that decides.

Decibels clamp at white and pool all values alike: a lacquer whose every highlight is missing has 26 dB, as highlights are
few. So what is brighter than the rest is measured by itself, and a wish in dB is met where that is kept as well.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from torchmat.fitting.wanted import Target

# Of the error, by which the samples kept back must be better than wanted: 0.22 dB. It is no bound: held-out samples were
# measured from 0.4 dB below those kept back (13 images) to 1.0 dB above them (128, with a few bright highlights).
MARGIN = 0.05
HIGHLIGHTS = 0.1  # the relative error on highlights that a wish in dB keeps besides: of their brightness a third, rms
# What highlights weigh where no error is wanted: those of a tenth as much as an error of 25 dB.
_EXCHANGE = 10**-2.5 / HIGHLIGHTS
PSNR, HIGHLIGHT, RELATIVE = "psnr_db", "highlight_error", "relative_error"


class Measured(NamedTuple):
    """Errors on the samples kept back, as `metrics` defines them; `relative_error` is infinite where black was missed.

    `highlight_error` is the relative error where the images or the material show a highlight (`kept_back`), None
    where the images show none.
    """

    psnr_db: float
    relative_error: float
    psnr_log_db: float = math.nan
    highlight_error: float | None = None

    def cost(self, target: Target) -> float:
        """Return the error that the target asks for as one number, at most `wanted_cost` where it is met.

        Of a wish in dB it is the mean square on a display, or where that is larger the error on highlights in the same
        unit; what both have above the target adds up, lest one be paid for with the other. Without any wish it is their
        weighted sum.
        """
        if target.error is not None:
            return self.relative_error
        display, highlights = 10 ** (-self.psnr_db / 10), self.highlight_error or 0.0
        wanted = wanted_cost(target)
        if wanted is None:
            return display + _EXCHANGE * highlights * (most_on_highlights(target) < 1)
        pivot = wanted * (1 - MARGIN)
        both = display, self._in_its_unit(target, wanted)
        return min(max(both), pivot) + sum(max(0.0, one - pivot) for one in both)

    def decided_by(self, target: Target) -> str:
        """Return the name of the figure that decided whether the target is met."""
        if target.error is not None:
            return RELATIVE
        display, wanted = 10 ** (-self.psnr_db / 10), wanted_cost(target)
        if wanted is None:
            heavier = _EXCHANGE * (self.highlight_error or 0.0) * (most_on_highlights(target) < 1) > display
        else:
            heavier = self._in_its_unit(target, wanted) > display
        return HIGHLIGHT if heavier else PSNR

    def loses_highlights(self, target: Target) -> bool:
        """Return whether the highlights are worse than usual, or than is wanted."""
        return self.highlight_error is not None and self.highlight_error > min(HIGHLIGHTS, most_on_highlights(target))

    def short_by_db(self, target: Target) -> float | None:
        """Return by how many dB the error that is wanted, but for highlights, is missed; None where none is wanted."""
        wanted = wanted_cost(target)
        if wanted is None:
            return None
        error = self.relative_error if target.error is not None else 10 ** (-self.psnr_db / 10)
        return max(0.0, 10 * math.log10(max(error, 1e-20) / (wanted * (1 - MARGIN))))

    def gap_text(self, target: Target) -> str:
        """Return in words by what the target is missed; empty where it is met."""
        short, parts = self.short_by_db(target), []
        if short:
            parts.append(f"by {short:.2f} dB")
        most = most_on_highlights(target)
        if short is not None and target.error is None and self.highlight_error is not None and most < 1:
            if self.highlight_error > most * (1 - MARGIN):
                parts.append(f"on highlights, with a relative error of {self.highlight_error:.3g} where at most {most:g} is wanted")
        return f"misses the target {' and '.join(parts)}" if parts else ""

    def _in_its_unit(self, target: Target, wanted: float) -> float:
        """Return the error on highlights as a mean square on a display that is as far from what is wanted."""
        most = most_on_highlights(target)
        return 0.0 if self.highlight_error is None or most >= 1 else self.highlight_error / most * wanted


def most_on_highlights(target: Target) -> float:
    """Return the largest relative error on highlights that meets the target; 1 and above lets them go."""
    return HIGHLIGHTS if target.highlights is None else target.highlights


def wanted_cost(target: Target) -> float | None:
    """Return the largest cost that meets the target, None where no error is wanted."""
    if target.error is not None:
        return target.error
    return None if target.psnr is None else 10 ** (-target.psnr / 10)
