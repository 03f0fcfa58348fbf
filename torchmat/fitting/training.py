"""What every fit is given, and what it gives back."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import torch
from torch import Tensor

from torchmat.btf import Btf
from torchmat.btf.near import far_only
from torchmat.errors import FitError, message
from torchmat.fitting.scene.share import SceneShare
from torchmat.fitting.shared import Shared
from torchmat.geometry import Relief
from torchmat.models import Material
from torchmat.models.masked import neutral_outside
from torchmat.models.relief_maps import FAST
from torchmat.solvers.clock import Watch
from torchmat.solvers.stop_reasons import CLOSED_FORM

_Kind = TypeVar("_Kind", bound=Shared)


@dataclass(frozen=True)
class Training:
    """The samples a fit may look at: `used` is bool [sample], lights above the horizon and not held out.

    `tiles` says that the surface repeats, `relief` how one that has a height is followed (`Material`), `finish`
    whether fits on a fine one are finished (`fitting.finish`), `indirect` how light between its texels is told
    (`fitting.between`). `importance` [sample] is what a sample counts (None: all
    alike); `watch` is the fit's clock. `shared` is what all texels have in common where that is known already
    (`Fitted.shared`), else None: a fit that is given it finds only what each texel has of its own, whatever other texels
    there are.
    """

    btf: Btf
    used: Tensor
    seed: int = 0
    tiles: bool = True
    dtype: torch.dtype = torch.float32
    progress: bool | None = None
    importance: Tensor | None = None
    watch: Watch = field(default_factory=Watch)
    shared: Shared | None = None
    relief: str = FAST
    finish: bool = False
    indirect: str = "auto"

    def table(self, name: str) -> Tensor | None:
        """Return a map that all texels share where it is known already."""
        return None if self.shared is None else self.shared.tables.get(name)

    def shared_as(self, kind: type[_Kind]) -> _Kind | None:
        """Return what all texels have in common, of the class that the model's recipe names, where it is known already."""
        return self.shared if isinstance(self.shared, kind) else None

    def counted(self, weight: Tensor, samples: range | Tensor) -> Tensor:
        """Return weights [k, ...] of samples, a run or their numbers, times what each sample counts."""
        if self.importance is None:
            return weight
        rows = slice(samples.start, samples.stop) if isinstance(samples, range) else samples
        some = self.importance[rows].to(weight.dtype)
        return weight * some.reshape(-1, *[1] * (weight.ndim - 1))

    def drawn(self, rows: Tensor, generator: torch.Generator) -> Tensor:
        """Return as many of `rows` in a random order: each once, or as often as it counts."""
        if self.importance is None:
            return rows[torch.randperm(len(rows), generator=generator)]
        return rows[torch.multinomial(self.importance[rows].double(), len(rows), replacement=True, generator=generator)]

    def planes(self, samples: Tensor) -> tuple[Tensor, Tensor]:
        """Return light and view of some samples in the fit's precision: [k, 3, 1, 1], or [k, 3, H, W] of what is near."""
        return self.btf.directions(samples, self.dtype)

    @property
    def light(self) -> Tensor:
        """Light of each sample as planes [sample, 3, 1, 1]; raises RangeError where lights or cameras are near (`planes`)."""
        far_only("fit", self.btf.near)
        return self.btf.light[:, :, None, None]

    @property
    def view(self) -> Tensor:
        """View of each sample as planes [sample, 3, 1, 1]; raises RangeError where lights or cameras are near (`planes`)."""
        far_only("fit", self.btf.near)
        return self.btf.view[:, :, None, None]


def make_training(
    btf: Btf, train: Tensor, seed: int, tiles: bool, dtype: torch.dtype, progress: bool | None, watch: Watch | None = None
) -> Training:
    """Return the Training for sample indices `train`; raises FitError when no light is above the horizon."""
    used = torch.zeros(len(btf), dtype=torch.bool)
    used[train] = True
    used &= btf.light[:, 2] > 0
    if not bool(used.any()):
        step = "Check the light directions: z points away from the surface."
        raise FitError(message("fit", "the data", "have a sample lit from above", "none of the fitted ones is", step))
    return Training(btf, used, seed, tiles, dtype, progress, watch=watch or Watch())


@dataclass(frozen=True)
class Fitted:
    """A material, why the solver stopped, the share of its unknowns each texel's samples determine, and figures.

    `coverage` [1, H, W] or None where it has no meaning; `figures` go into the report under the model's own keys, for
    readers: no code looks into them. `relief` is the geometry that was recovered and used; `history` lists (seconds,
    error) of a solver in its own terms; `shared` is what all texels have in common: a fit of other texels takes it as
    `Training.shared`. `options` are those of the model that was chosen, None where they are those that were
    asked for; `scene` what a fit for a scene looked at.
    """

    material: Material
    stop_reason: str = CLOSED_FORM
    coverage: Tensor | None = None
    figures: dict[str, Any] = field(default_factory=dict)
    relief: Relief | None = None
    history: list[tuple[float, float]] = field(default_factory=list)
    shared: Shared = Shared()
    options: dict[str, Any] | None = None
    scene: SceneShare | None = None

    def settled(self, mask: Tensor | None) -> Fitted:
        """Return the same fit, neutral and without coverage outside of an object's `mask`, bool [H, W]."""
        if mask is None:
            return self
        coverage = None if self.coverage is None else self.coverage * mask
        return replace(self, material=neutral_outside(self.material, mask), coverage=coverage)

    def with_material(self, material: Material) -> Fitted:
        """Return the same findings with another material."""
        return replace(self, material=material)
