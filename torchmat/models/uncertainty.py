"""Uncertainty: how far the maps of a fit may be off, texel by texel, as tensors beside the maps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from torchmat.errors import RangeError, message


def check_sure(where: str, kind: Any) -> None:
    """Raise RangeError for a material, or a class of them, whose maps have no standard errors of their own."""
    if kind.unsure is not None:
        step = "Fit another model, such as ptm, hsh, phong_srf, distribution or microfacet."
        raise RangeError(message(where, f"uncertainty of {kind.name}", "be asked of maps that have one", kind.unsure, step))


@dataclass(frozen=True)
class Uncertainty:
    """Standard errors of the maps of a fit: one standard deviation of what other photographs of the same noise would give.

    They stand for the noise and the misfit that the residual shows, and for how well the directions tell the numbers of
    a texel apart; what all texels share counts as known, and a misfit that all of them have in common is not in them.

    Args:
        error: standard error of each map, [C, H, W] in the map's unit; of a unit normal or a rotation that of its
            components. As large as the map's natural range (`span`) it says that nothing is known; 0 outside of an object.
        freedom: degrees of freedom of the residual at each texel, [1, H, W], at least 1.
        sigma: standard deviation of a residual in red, green and blue, over all texels, in the space of the fit.
        space: where residuals were taken: "linear", "srgb" (codes of a screen), "display" or what the objective is called.
        span: the natural range of each map, which no standard error exceeds.
        samples: how many photographs were looked at, and of how many.
    """

    error: dict[str, Tensor]
    freedom: Tensor
    sigma: tuple[float, float, float]
    space: str
    span: dict[str, float]
    samples: tuple[int, int]

    def interval(self, level: float = 0.95) -> dict[str, Tensor]:
        """Return half the width of the interval about each map, [C, H, W], that holds the truth with probability `level`.

        By Student's t of the degrees of freedom of each texel. Raises RangeError unless 0 < level < 1.
        """
        if not 0 < level < 1:
            raise RangeError(message("Uncertainty.interval", "level", "lie in (0, 1)", f"it is {level}", "0.95 is usual."))
        from scipy.special import stdtrit

        factor = torch.from_numpy(stdtrit(self.freedom.double().numpy(), 0.5 + level / 2))
        return {name: error * factor.to(error.dtype) for name, error in self.error.items()}

    def as_table(self) -> dict[str, Any]:
        """Return what a report says: of each map the usual and the largest standard error, and what they rest on."""
        maps = {
            name: {"median": float(one.median()), "largest": float(one.max()), "span": self.span[name]}
            for name, one in self.error.items()
        }
        return {
            "maps": maps, "sigma": list(self.sigma), "space": self.space, "samples": self.samples[0], "of": self.samples[1],
            "freedom": float(self.freedom.median()),
        }

    @classmethod
    def of_table(cls, error: dict[str, Tensor], freedom: Tensor, table: Mapping[str, Any]) -> Uncertainty:
        """Return the uncertainty that `as_table` describes, of these maps."""
        red, green, blue = map(float, table["sigma"])
        span = {name: float(one["span"]) for name, one in table["maps"].items()}
        return cls(error, freedom, (red, green, blue), str(table["space"]), span, (int(table["samples"]), int(table["of"])))
