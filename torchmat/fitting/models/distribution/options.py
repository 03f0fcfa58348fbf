"""What the fit of the distribution material may be asked for."""

from __future__ import annotations

from dataclasses import dataclass

from torchmat.errors import RangeError, check_option, check_positive, message
from torchmat.models.storage import STORAGES

DISTRIBUTION_SOLVERS = ("minibatch", "adam", "lbfgs")
AUTO, YES_NO = ("auto", "yes", "no"), ("yes", "no")
_WHERE = "fit distribution"


@dataclass(frozen=True)
class DistributionOptions:
    """The options of `fit_distribution`, checked; their meaning stands there."""

    lobes: int = 0
    specular: str = "yes"
    fresnel: str = "auto"
    rotation: str = "auto"
    tilt: str = "no"
    normal: str = "yes"
    specular_mask: str = "yes"
    specular_size: int = 48
    effort: float = 1.0
    solver: str = "minibatch"
    storage: str = "png8"

    def __post_init__(self) -> None:
        for name in ("fresnel", "rotation", "tilt"):
            check_option(_WHERE, name, getattr(self, name), AUTO)
        for name in ("specular", "normal", "specular_mask"):
            check_option(_WHERE, name, getattr(self, name), YES_NO)
        check_option(_WHERE, "solver", self.solver, DISTRIBUTION_SOLVERS)
        check_option(_WHERE, "storage", self.storage, STORAGES)
        if self.lobes < 0 or self.lobes > 12:
            raise RangeError(message(_WHERE, "lobes", "lie in 0 (automatic) to 12", f"it is {self.lobes}"))
        asked = [name for name in ("fresnel", "rotation", "tilt") if getattr(self, name) == "yes"]
        asked += ["lobes"] if self.lobes else []
        if self.specular == "no" and asked:
            step = f"Leave {asked[0]} out, or specular at 'yes'."
            raise RangeError(message(_WHERE, asked[0], "be left out without specular maps", f"it is {getattr(self, asked[0])!r}", step))
        if not 4 <= self.specular_size <= 1024:
            raise RangeError(message(_WHERE, "specular_size", "lie in 4 to 1024", f"it is {self.specular_size}"))
        check_positive(_WHERE, "effort", self.effort)
