"""What the fit of the distribution material may be asked for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from torchmat.errors import RangeError, check_option, check_positive, message
from torchmat.fitting.objective import DISPLAY, Residual, check_objective
from torchmat.models.parabolic import SPACINGS
from torchmat.models.storage import STORAGES
from torchmat.solvers import Minibatch, Stepping

MOST_LOBES = 12
DENOMINATORS = ("smith", "ashikhmin", "tilt")
_WHERE = "fit distribution"


@dataclass(frozen=True)
class DistributionOptions:
    """The options of `fit_distribution`, checked; their meaning stands there."""

    lobes: int | Literal["auto"] = "auto"
    fresnel: bool | Literal["auto"] = "auto"
    rotation: bool | Literal["auto"] = "auto"
    tilt: bool | Literal["auto"] = False
    normal: bool = True
    specular_mask: bool = True
    specular_size: int = 48
    effort: float = 1.0
    solver: Stepping = Minibatch()
    storage: str = "png8"
    objective: str | Residual = DISPLAY
    denominator: Literal["smith", "ashikhmin", "tilt"] = "smith"
    fresnel_exponent: float | Literal["auto"] = "auto"
    specular_spacing: Literal["auto", "even", "dense"] = "auto"

    def __post_init__(self) -> None:
        check_objective(_WHERE, self.objective)
        check_option(_WHERE, "storage", self.storage, STORAGES)
        check_option(_WHERE, "denominator", self.denominator, DENOMINATORS)
        check_option(_WHERE, "specular_spacing", self.specular_spacing, ("auto", *SPACINGS))
        if self.lobes != "auto" and not 0 <= self.lobes <= MOST_LOBES:
            raise RangeError(message(_WHERE, "lobes", f"lie in 0 to {MOST_LOBES}, or be 'auto'", f"it is {self.lobes!r}"))
        asked = [name for name in ("fresnel", "rotation", "tilt") if getattr(self, name) is True]
        asked += ["denominator"] if self.denominator == "tilt" else []
        if self.lobes == 0 and asked:
            step = f"Leave {asked[0]} out, or give lobes."
            raise RangeError(message(_WHERE, asked[0], "be left out without lobes", "lobes is 0", step))
        if not 4 <= self.specular_size <= 1024:
            raise RangeError(message(_WHERE, "specular_size", "lie in 4 to 1024", f"it is {self.specular_size}"))
        check_positive(_WHERE, "effort", self.effort)
        if self.fresnel_exponent != "auto":
            check_positive(_WHERE, "fresnel_exponent", self.fresnel_exponent, "5 is Schlick's; \"auto\" fits it.")
