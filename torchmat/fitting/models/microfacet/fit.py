"""Fit of the microfacet material: lobes in closed form over a grid of roughness, then all maps together.

Which parts there are is decided on the way and not by fits from nothing: with and without a part the material goes on for
as many steps, and what it shows then of samples kept back says whether the part pays. Nothing is lost by it: the better
of the two is what the fit goes on from.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Literal

import torch
from torch import Tensor

from torchmat.errors import RangeError, check_option, check_positive, message, notice
from torchmat.fitting.descending import Descending
from torchmat.fitting.models.microfacet.start import find_start
from torchmat.fitting.objective import DISPLAY, Residual, check_objective, mean_value
from torchmat.fitting.relief.surface import Surface, bring_onto
from torchmat.fitting.training import Fitted, Training
from torchmat.geometry import normals_from_slopes, slopes_from_normals
from torchmat.models.microfacet import MICROFACET_PARTS, Microfacet, microfacet_specs
from torchmat.models.storage import STORAGES
from torchmat.progress import progress
from torchmat.repeatable import one_thread
from torchmat.solvers import Minibatch, Stepping

Choice = bool | Literal["auto"]
_STEPS, _RATE = 1600, 0.05  # of a whole fit
_TRIAL, _FEWEST, _LAST = 80, 40, 0.5  # steps of a trial; what of the whole fit is left at least when parts are chosen
_GAIN_DB, _FREE_DB = 0.08, 0.03  # what a part must bring that takes bytes, and one that takes none
_KEPT_BACK, _MEASURED = 10, 200  # one sample in so many says what a part brings; at most so many
_FREE = ("rolloff", "layered")
OPTIONAL = ("anisotropy", "layered", "rolloff", "f90", "coat", "sheen")  # in the order of trying
_OF_ANGLES = ("f90", "coat", "layered")  # told from the lobe's shape by views at several angles alone
_ROUGHNESS_PRIOR, _COLOUR_PRIOR = 0.01, 0.002  # what a mean square of deviations counts, in relative errors


def fit_microfacet(
    training: Training, *, anisotropy: Choice = "auto", normal: bool = True, f90: Choice = "auto", coat: Choice = "auto",
    sheen: Choice = "auto", rolloff: Choice = "auto", layered: Choice = "auto", effort: float = 1.0,
    solver: Stepping = Minibatch(), storage: str = "png8", objective: str | Residual = DISPLAY,
) -> Fitted:
    """Fit the microfacet material to a flat surface.

    Of what is "auto" a part is kept if the fit goes on better with it by 0.08 dB on samples kept back, 0.03 dB where it
    takes no bytes. Roughness and the colour of F0 are drawn to the material's means as far as samples leave them open.

    Args:
        anisotropy: true, false or "auto": roughness along and across a direction for each texel, for brushed and woven surfaces.
        normal: true for a normal map, which on a relief refines the height's normals.
        f90: true, false or "auto": a map of the reflectance at grazing, which else is 1.
        coat: true, false or "auto": a second, grey lobe with its own roughness.
        sheen: true, false or "auto": the sheen of fibres, a colour a texel and one roughness.
        rolloff: true, false or "auto": two numbers for how the diffuse part falls towards grazing.
        layered: true, false or "auto": what lies under the coat or the specular part gets through it both ways.
        effort: factor on the number of steps, above 0: larger is slower and slightly better.
        solver: "minibatch" is Adam on random images, "adam" and "lbfgs" take all at once; a solver's own `steps`, those of the
            fit in all, count instead of `effort`.
    """
    asked = {"anisotropy": anisotropy, "f90": f90, "coat": coat, "sheen": sheen, "rolloff": rolloff, "layered": layered}
    flat = torch.zeros(1, training.btf.height, training.btf.width, dtype=training.dtype)
    surface = bring_onto(training, flat)
    with one_thread():  # numbers that all texels share sum their gradients over all of them
        return _Fit(surface, None, asked, normal, effort, solver, storage, objective).run()


def fit_microfacet_on_relief(
    surface: Surface, height: Tensor | None, *, normal: bool = True, effort: float = 1.0, solver: Stepping = Minibatch(),
    storage: str = "png8", objective: str | Residual = DISPLAY, **asked: Any,
) -> Fitted:
    """Fit the microfacet material over a relief."""
    wanted = {name: asked.get(name, "auto") for name in OPTIONAL}
    with one_thread():
        return _Fit(surface, height, wanted, normal, effort, solver, storage, objective).run()


@dataclass
class _Fit:
    """One fit in progress."""

    surface: Surface
    height: Tensor | None
    asked: dict[str, Choice]
    normal: bool
    effort: float
    solver: Stepping
    storage: str
    objective: str | Residual
    tried: list[dict[str, Any]] = field(default_factory=list)
    history: list[tuple[float, float]] = field(default_factory=list)
    steps: int = 0
    taken: int = 0  # by what the whole fit goes on from

    def __post_init__(self) -> None:
        where = "fit microfacet"
        check_objective(where, self.objective)
        check_option(where, "storage", self.storage, STORAGES)
        check_positive(where, "effort", self.effort)
        self.training = self.surface.training
        self.level = mean_value(self.training)
        self.undetermined = self._undetermined(where)
        self.start = find_start(self.surface, self.level, self.height is not None, self.asked["anisotropy"] is not False)

    def _undetermined(self, where: str) -> dict[str, str]:
        """Return the parts that the samples say nothing of, with the reason, and leave them out; say so."""
        btf, found = self.training.btf, {}
        if len(btf.views) < 2:
            found = dict.fromkeys(_OF_ANGLES, "there is one view")
        half = btf.light.double() + btf.view.double()
        half = (half / half.norm(dim=1, keepdim=True).clamp(min=1e-9))[:, :2]
        spread = torch.linalg.eigvalsh(half.T @ half)
        if float(spread[0]) < 1e-3 * float(spread[1]) or len(btf) < 6:
            found["anisotropy"] = "half vectors lie in one plane"
        for name, why in found.items():
            if self.asked[name] is True:
                step = "Leave it out, or give photographs from more directions."
                raise RangeError(message(where, name, "be determined by the samples", why, step))
        left = [name for name in found if self.asked[name] == "auto"]
        if left:
            notice(where, f"{', '.join(left)} stay undetermined and are left out: {', '.join(dict.fromkeys(found[n] for n in left))}")
        self.asked = {**self.asked, **dict.fromkeys(found, False)}
        return found

    def run(self) -> Fitted:
        parts = [name for name in OPTIONAL if self.asked[name] is True]
        material = self._begin([*parts, "normal"] if self.normal else parts)
        material = self._choose(material)
        fitted = self._whole(material)
        figures = {
            "parts": fitted.material.options["parts"], "trials": self.tried, "undetermined": self.undetermined,
            **fitted.figures, "solver_steps": self.steps,
        }
        return replace(fitted, figures=figures, history=self.history)

    def _begin(self, parts: list[str]) -> Microfacet:
        start = self.start
        maps = {"diffuse": start.diffuse, "specular_f0": start.specular_f0, "roughness": _round(start.roughness)}
        if "normal" in parts:
            own = slopes_from_normals(start.normal)
            maps["normal"] = normals_from_slopes(own - self.surface.slopes if self.height is not None else own)
        if self.height is not None:
            maps |= {"height": self.height, "ambient": start.ambient}
        plain = [name for name in parts if name == "normal"]
        material = Microfacet(maps, parts=plain, storage=self.storage, tiles=self.training.tiles, relief=self.training.relief)
        for name in parts:
            material = material if name in plain else self._with_part(material, name)
        return material

    def _with_part(self, material: Microfacet, name: str) -> Microfacet:
        """Return the material with one more part, of the values from which it grows."""
        maps = {key: value.detach() for key, value in material.maps.items()}
        one, start = torch.ones_like(maps["roughness"][:1]), self.start
        if name == "anisotropy":
            factor = start.roughness / _round(start.roughness)
            maps |= {"roughness": (maps["roughness"] * factor).clamp(0.02, 0.98), "rotation": start.rotation}
        elif name == "f90":
            maps["f90"] = 0.9 * one
        elif name == "coat":
            maps |= {"coat": 0.02 * one, "coat_roughness": 0.7 * maps["roughness"].amin(dim=0, keepdim=True)}
        elif name == "sheen":
            maps |= {"sheen": 0.1 * maps["diffuse"], "sheen_roughness": 0.6 * one[0, 0, :1]}
        elif name == "rolloff":
            maps["rolloff"] = torch.zeros(2, dtype=one.dtype)
        elif name == "layered":
            maps["diffuse"] = maps["diffuse"] / (1 - maps["specular_f0"].clamp(max=0.5)).square()
        found = ((key, self.training.table(key)) for key in ("rolloff", "sheen_roughness") if key in maps)
        table: dict[str, Tensor] = {key: value for key, value in found if value is not None}
        parts = [part for part in MICROFACET_PARTS if part in (*material.options["parts"], name)]
        return Microfacet({**maps, **table}, parts=parts, **material.settings(maps))

    def _choose(self, material: Microfacet) -> Microfacet:
        """Go on with and without each part that is not decided, and keep what pays."""
        left = [name for name in OPTIONAL if self.asked[name] == "auto"]
        btf = self.training.btf
        if not left or len(btf) < 20:
            return material
        generator = torch.Generator().manual_seed(self.training.seed)
        order = torch.randperm(len(btf), generator=generator)
        back, used = order[: max(1, len(btf) // _KEPT_BACK)], torch.zeros(len(btf), dtype=torch.bool)
        used[order[len(back):]] = True
        part = replace(self.surface, training=replace(self.training, used=used))
        steps = max(_FEWEST, round(_TRIAL * min(1.0, self.effort)))
        material, self.taken = self._descended(part, material, 2 * steps), 2 * steps
        back = back[:_MEASURED]
        for name in progress(left, "choosing parts", show=self.training.progress):
            if self.training.watch.spent:
                break
            without = self._descended(part, material, steps)
            rival = self._descended(part, self._with_part(material, name), steps)
            found = [self._psnr(one, back) for one in (without, rival)]
            kept = found[1] - found[0] > (_FREE_DB if name in _FREE else _GAIN_DB)
            self.tried.append({"part": name, "psnr_db": found[1], "without": found[0], "kept": kept})
            material, self.taken = rival if kept else without, self.taken + steps
        return material

    def _descended(self, surface: Surface, material: Microfacet, steps: int) -> Microfacet:
        run = Descending(surface.source, material, ["height"], self.objective, surface, _prior(material))
        watch = surface.training.watch
        fitted = run.run(Minibatch(steps, _RATE), (1.0,)) if not watch.spent else Fitted(material)
        found = fitted.material
        assert isinstance(found, Microfacet)
        return found

    def _psnr(self, material: Microfacet, rows: Tensor) -> float:
        """Return the PSNR of samples after the display root, as far as white."""
        seen = Descending(self.surface.source, material, list(material.maps), self.objective, self.surface).seen
        with torch.no_grad():
            return self.surface.psnr_db(rows, self.level, lambda some: seen.predicted({}, some))

    def _whole(self, material: Microfacet) -> Fitted:
        """Descend on all samples."""
        shared = [spec.name for spec in material.own_specs() if spec.constant]
        kept = ["height", *(shared if self.training.shared is not None else [])]
        usual = _STEPS * self.effort
        wanted: dict[str, Any] = {"steps": self.solver.steps or max(1, round(max(_LAST * usual, usual - self.taken)))}
        if hasattr(self.solver, "rate"):
            wanted["rate"] = self.solver.rate or _RATE
        solver = replace(self.solver, **wanted)
        run = Descending(self.surface.source, material, kept, self.objective, self.surface, _prior(material))
        fitted = run.run(solver, (1.0,))
        self.steps, self.history = int(fitted.figures.get("steps", 0)), fitted.history
        found = fitted.material
        tables = {name: found.maps[name].detach() for name in shared}
        return replace(fitted, shared=replace(fitted.shared, tables=tables))


def _round(roughness: Tensor) -> Tensor:
    """Return one roughness for two: that of the same area of slopes."""
    return (roughness[:1] * roughness[1:]).sqrt()


def _prior(material: Microfacet) -> Any:
    """Return what draws roughness and the colour of F0 to the material's means, in the unit of relative errors."""
    names = [spec.name for spec in microfacet_specs(material.options["parts"]) if spec.name in ("roughness", "coat_roughness")]

    def prior(maps: dict[str, Tensor]) -> Tensor:
        total = torch.zeros((), dtype=material.dtype)
        for name in names:
            if name in maps:
                total = total + _ROUGHNESS_PRIOR * (maps[name] - maps[name].mean(dim=(1, 2), keepdim=True)).square().mean()
        if "specular_f0" in maps:
            f0 = maps["specular_f0"]
            bright = f0.mean(dim=0, keepdim=True)
            usual = f0.mean(dim=(1, 2), keepdim=True) / bright.mean().clamp(min=1e-12)
            apart = (f0 - usual * bright).square().mean() / bright.square().mean().clamp(min=1e-12)
            total = total + _COLOUR_PRIOR * apart
        return total

    return prior
