"""Fit of the distribution material: starts from what is known, then all maps together by Adam on surface samples.

The residual is taken after ``(x + e) ^ (1 / 2.2)``: to the eye, and to 8-bit pictures, a step in the dark counts as
much as one in the light, and a highlight a thousand times brighter than the cloth counts 23 times as much - neither lost
nor all that matters. The height stays: what the appearance wants of it is as often its own error. It moves in the finish.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import torch
from torch import Tensor

from torchmat.fast.distribution_misfit import Samples
from torchmat.fast.roughness import roughness
from torchmat.fitting.models.distribution.choose import Choice
from torchmat.fitting.models.distribution.options import DistributionOptions
from torchmat.fitting.models.distribution.parameters import (
    EXPONENT, SCHLICK, DistributionShared, Parts, group_texels, inside_of, maps_of, rates_of, raw_maps, to_one,
)
from torchmat.fitting.models.distribution.start import find_starts
from torchmat.fitting.objective import DISPLAY, DISPLAY_POWER, Objective, Residual, mean_value, power
from torchmat.fitting.relief.surface import Surface, bring_onto
from torchmat.fitting.training import Fitted, Training
from torchmat.geometry import normals_from_slopes
from torchmat.models import Distribution
from torchmat.progress import whole, working
from torchmat.solvers import LBFGS, Adam, Descent, Minibatch, Problem, Stepping
from torchmat.solvers.clock import Watch
from torchmat.solvers.multiplicative import sweep
from torchmat.solvers.stop_reasons import DIVERGED, NOT_FINITE

_BATCH_VALUES, _FEWEST_IMAGES = 49152, 4  # texels x images of one step
_LEAST_GRADIENT = 1e-8 * 4096  # of a texel; the loss is a mean, so all gradients shrink with the number of texels
_RATE = 0.06
_ROUNDS = (1100, 900)  # steps before and after parts are decided
# A texel that hardly a sample sees is like those beside it: a squared residual of the data's unit, 1 in display values of its
# mean, weighs as much as three thousand differences of 1 between the logarithms of neighbours.
_SMOOTH, _SMALL = 1e-4, 0.1
_FEWER = {Adam: 4, LBFGS: 10}  # steps on all samples at once do so many times as much
# Passes of the multiplicative start, and images of each. Only a hurried fit begins so: a whole one gets there by Adam, and
# ends up to 0.3 dB better. With fewer values for each entry of a specular map the passes learn their noise.
_SWEEPS, _SWEPT, _HURRIED, _FEWEST_VALUES = 6, 256, 0.75, 400


def fit_distribution(
    training: Training, *, lobes: int | Literal["auto"] = "auto", fresnel: bool | Literal["auto"] = "auto",
    rotation: bool | Literal["auto"] = "auto", tilt: bool | Literal["auto"] = False, normal: bool = True,
    specular_mask: bool = True, specular_size: int = 48, effort: float = 1.0, solver: Stepping = Minibatch(),
    storage: str = "png8", objective: str | Residual = DISPLAY, denominator: Literal["smith", "ashikhmin", "tilt"] = "smith",
    fresnel_exponent: float | Literal["auto"] = "auto", specular_spacing: Literal["auto", "even", "dense"] = "auto",
) -> Fitted:
    """Fit the distribution material to a flat surface.

    Of what is "auto" a part is kept if it gains 0.08 dB on samples kept back: of lobes and tilt in a short run from the start,
    of Fresnel and rotation in the nearly whole fit (`choose`).

    Args:
        lobes: specular maps, 0 to 12; "auto" lets the data choose 1 to 3, 0 leaves them out with all that belongs to them.
        fresnel: true, false or "auto": a map of the reflectance at normal incidence.
        rotation: true, false or "auto": a map that turns each texel's highlight, for brushed and woven surfaces.
        tilt: true, false or "auto": one curve for the whole material that changes how it darkens toward grazing, in place of
            what the denominator says of that; true is the same as denominator="tilt".
        normal: true for a normal map, which on a relief refines the height's normals.
        specular_mask: true for a map of how strong each texel's highlight is.
        specular_size: texels on a side of the specular maps, 4 to 1024.
        effort: factor on the number of steps, above 0: larger is slower and slightly better.
        solver: "minibatch" is Adam on random images, "adam" and "lbfgs" take all at once; a solver's own `steps`, those of the
            fit in all, count instead of `effort`.
        denominator: how highlights grow toward grazing: "smith" by masking with two roughnesses for the whole material, in
            each texel's turned frame (Heitz 2014); "ashikhmin" by D as the thesis prints it; "tilt" by D with a curve.
        fresnel_exponent: how a part of the light rises to all of it towards grazing: 5 is Schlick's, 1 the thesis's printed
            formula, "auto" finds one for the whole material: Schlick's is a quarter too dark at 60 degrees on glass.
        specular_spacing: how the texels of the specular maps lie: "even" as in the thesis, "dense" with more of them at the centre;
            "auto" tries both where highlights are sharp.
    """
    given = DistributionOptions(
        lobes, fresnel, rotation, tilt, normal, specular_mask, specular_size, effort, solver, storage, objective, denominator,
        fresnel_exponent, specular_spacing,
    )
    flat = torch.zeros(1, training.btf.height, training.btf.width, dtype=training.dtype)
    return DistributionFit(bring_onto(training, flat), None, given).run()


def fit_distribution_on_relief(surface: Surface, height: Tensor, **options: Any) -> Fitted:
    """Fit the distribution material over a relief."""
    return DistributionFit(surface, height, DistributionOptions(**options)).run()


def roughness_of(log_specular: Tensor) -> Tensor:
    """Return the sum of the differences between neighbours, as their squares where they are small: a peak costs little more than noise."""
    found = roughness(log_specular, _SMALL)
    if found is not None:
        return found
    across, down = (torch.sqrt(one * one + _SMALL * _SMALL) - _SMALL for one in (log_specular.diff(dim=-1), log_specular.diff(dim=-2)))
    # Dimension by dimension, which rounds alike on any number of threads.
    return across.sum(dim=-1).sum(dim=-1).sum() + down.sum(dim=-1).sum(dim=-1).sum()


@dataclass
class DistributionFit:
    """One fit in progress."""

    surface: Surface
    height: Tensor | None
    options: DistributionOptions
    history: list[tuple[float, float]] = field(default_factory=list)
    templates: dict[tuple[str, ...], Distribution] = field(default_factory=dict)
    known: dict[str, Tensor] = field(default_factory=dict)  # parameters that are no unknowns here

    def __post_init__(self) -> None:
        training = self.surface.training
        known = training.shared_as(DistributionShared)
        self.level = mean_value(training) if known is None else known.level
        self.objective = Objective(self.options.objective, self.level)

    def run(self) -> Fitted:
        with working("finding where to start", self.surface.training.progress):
            starts = find_starts(self.surface, self.level)
        self.choice = Choice(self)
        begun, taken = self.choice.start(starts)
        with working("taking the first steps", self.surface.training.progress):
            raw = self.begin(starts, self.choice.parts) if begun is None else begun
        raw, found = self._rounds(raw, _ROUNDS if self.choice.open else (sum(_ROUNDS),), taken)
        parts = self.choice.parts
        figures = {"parts": parts.names, "lobes": parts.lobes, "trials": self.choice.tried, "solver_steps": found.steps}
        shared = self._shared(raw, parts, starts)
        return Fitted(self._material(raw, parts), found.reason, None, figures, history=self.history, shared=shared)

    def _rounds(self, raw: dict[str, Tensor], rounds: tuple[int, ...], gone: int) -> tuple[dict[str, Tensor], Descent]:
        """Solve for all maps, of which `gone` steps are done; a limit of seconds is shared out as the steps are.

        Before the last round the parts that are open are decided; what that takes of steps is a part of the round.
        """
        training = self.surface.training
        solvers = [self._solver(steps, sum(rounds), number > 0) for number, steps in enumerate(rounds)]
        first = solvers[0].steps or 0
        taken, watch = min(gone, first // 3) if isinstance(solvers[0], Minibatch) else 0, training.watch  # by such steps, too
        solvers[0] = replace(solvers[0], steps=first - taken)
        every = sum(solver.steps or 0 for solver in solvers)
        with whole("fitting", every, "fitting", watch.limit - watch.seconds, training.progress):
            for number, (steps, solver) in enumerate(zip(rounds, solvers, strict=True)):
                if number == len(rounds) - 1 and self.choice.open:
                    raw, gone = self.choice.prune(raw)
                    solver = replace(solver, steps=max(1, (solver.steps or 0) - gone))
                    taken += gone
                now, share = watch.seconds, steps / sum(rounds[number:])
                until = now + (watch.limit - now) * share
                found = self.solve(raw, self.choice.parts, solver, self.choice.samples, until, watch)
                taken += found.steps
                self.history += found.history
                if found.reason in (NOT_FINITE, DIVERGED) or watch.spent:
                    break
        return raw, replace(found, steps=taken)

    @property
    def rate(self) -> float:
        return getattr(self.options.solver, "rate", None) or _RATE

    def _solver(self, steps: int, every: int, again: bool) -> Stepping:
        """Return the solver of a round of so many of `every` step, slower where it goes on from an earlier one."""
        asked = self.options.solver
        own = max(1, round(steps * self.options.effort)) // _FEWER.get(type(asked), 1)
        wanted: dict[str, Any] = {"steps": max(1, own if asked.steps is None else round(asked.steps * steps / every))}
        if hasattr(asked, "rate"):
            wanted["rate"] = self.rate * 2 / 3 if again else self.rate
        return replace(asked, **wanted)

    def begin(self, starts: dict[str, Tensor], parts: Parts) -> dict[str, Tensor]:
        """Return the parameters at the start, in a hurried fit with what only adds light as bright as the data."""
        training = self.surface.training
        raw = raw_maps(starts, parts, self.options.specular_size, training, self._given_exponent)
        known = training.shared_as(DistributionShared)
        if known is not None:
            self.known = {name: value for name, value in known.parameters.items() if name in raw}
            raw = {name: value for name, value in raw.items() if name not in self.known}
        hurried = self.options.effort < _HURRIED or math.isfinite(training.watch.limit)
        if hurried and training.shared is None and self._values_of_an_entry(raw) >= _FEWEST_VALUES:
            self._brighten(raw, parts)
        return raw

    def _values_of_an_entry(self, raw: dict[str, Tensor]) -> float:
        """Return how many values of the passes fall on one entry of a specular map, on average."""
        if "specular" not in raw:
            return math.inf
        btf, entries = self.surface.training.btf, raw["specular"].numel() / 3
        return min(len(btf), _SWEPT) * btf.height * btf.width / entries

    def _brighten(self, raw: dict[str, Tensor], parts: Parts) -> None:
        """Change `raw` by a few multiplicative passes."""
        samples = len(self.surface.training.btf)
        rows = torch.linspace(0, samples - 1, min(samples, _SWEPT)).round().long()
        batches = rows.split(self._images)
        additive = [name for name in ("diffuse", "ambient", "specular") if name in raw]
        additive = [name for name in additive if name != "ambient" or self.height is not None]

        def observed(batch: Tensor) -> tuple[Tensor, Tensor]:
            values, valid = self.surface.values(batch)
            # The slope of the display root, squared: a step in the dark counts as much as one in the light.
            return values, valid * power(values.clamp(min=0) + self.objective.darkest, 2 * (DISPLAY_POWER - 1))

        for number in range(_SWEEPS):
            last = number == _SWEEPS - 1 and "specular_mask" in raw
            names = [*(n for n in additive if n != "specular"), "specular_mask"] if last else additive
            sweep([raw[name] for name in names], lambda batch: self.predict(raw, parts, self.surface, batch), observed, batches)

    @property
    def _images(self) -> int:
        """Images of one batch; texels that share nothing unknown take the same steps whatever others are fitted with them."""
        training = self.surface.training
        texels = training.btf.height * training.btf.width
        alone = training.shared is not None
        return _FEWEST_IMAGES if alone else max(_FEWEST_IMAGES, _BATCH_VALUES // texels)

    def _shared(self, raw: dict[str, Tensor], parts: Parts, starts: dict[str, Tensor]) -> DistributionShared:
        """Return what other texels of the material need: the unit, the specular maps, and what groups texels."""
        training = self.surface.training
        known = training.shared_as(DistributionShared)
        if known is not None:
            return known
        features = inside_of(starts["features"], training.btf.mask)
        groups = None if parts.lobes < 2 else group_texels(features, parts.lobes, training.seed)
        return DistributionShared(
            level=self.level, log_specular=raw.get("specular"), logit_tilt=raw.get("tilt"), log_masking=raw.get("masking"),
            groups=groups,
        )

    @property
    def _given_exponent(self) -> float | None:
        asked = self.options.fresnel_exponent
        return None if asked == "auto" else asked

    def exponent(self, raw: dict[str, Tensor]) -> float:
        """Return the exponent of Fresnel's rise as it stands."""
        found = maps_of({name: value for name, value in (raw | self.known).items() if name == EXPONENT})
        return float(found[EXPONENT]) if found else self._given_exponent or SCHLICK

    def predict(self, raw: dict[str, Tensor], parts: Parts, surface: Surface, rows: Tensor) -> Tensor:
        """Return what the surface shows in samples `rows`, [k, 3, H, W]."""
        btf = surface.training.btf
        flat, ambient = self._shown(raw, parts)
        shaded = flat.value(*btf.directions(rows, surface.training.dtype))
        return shaded if self.height is None else shaded * surface.lit[btf.light_index[rows]] + ambient

    def misfit(self, raw: dict[str, Tensor], parts: Parts, rows: Tensor, share: float) -> Tensor:
        """Return `share` of the mean squared residual of samples `rows` of the surface."""
        surface, asked = self.surface, self.objective.asked
        if isinstance(asked, str) and surface.training.btf.near is None:
            flat, ambient = self._shown(raw, parts)
            light, view = surface.training.btf.directions(rows, surface.training.dtype)
            found = flat.misfit(light, view, self._samples(rows, ambient, share / (len(rows) * 3 * flat.texels)))
            if found is not None:
                return found
        values, valid = surface.values(rows)
        squares = self.objective.squares(self.predict(raw, parts, surface, rows), values, valid)
        return squares.mean() * (squares.numel() / values.numel() * share)

    def _samples(self, rows: Tensor, ambient: Tensor, each: float) -> Samples:
        """Return samples of the surface as the compiled part is given them, each of which counts so much."""
        surface, raised = self.surface, self.height is not None
        return Samples(
            torch.from_numpy(surface.pixels), torch.from_numpy(surface.flags), rows, surface.weights * each, surface.lit if raised else None,
            surface.training.btf.light_index[rows] if raised else None, ambient if raised else None, self.objective.darkest,
            DISPLAY_POWER if self.objective.asked == DISPLAY else 0.0,
        )

    def _shown(self, raw: dict[str, Tensor], parts: Parts) -> tuple[Distribution, Tensor]:
        """Return the material of parameters on the flat surface, with the height's normals, and the ambient."""
        maps = maps_of(raw | self.known)
        ambient, exponent = maps.pop("ambient"), maps.pop(EXPONENT, None)
        if "normal" not in maps and self.height is not None:
            maps["normal"] = normals_from_slopes(self.surface.slopes)
        return self._flat(maps, parts, exponent), ambient

    def _flat(self, maps: dict[str, Tensor], parts: Parts, exponent: Tensor | None) -> Distribution:
        names = (*parts.names, *(["normal"] if "normal" in maps and not parts.normal else []))
        key = (str(parts.lobes), parts.spacing, *names)
        if key not in self.templates:
            found = {name: value.detach() for name, value in maps.items()}
            own = self._given_exponent or SCHLICK
            self.templates[key] = Distribution(found, lobes=parts.lobes, parts=names, fresnel_exponent=own, specular_spacing=parts.spacing)
        # Not checked again at each step: maps that are no longer finite show in the error.
        flat = self.templates[key].sharing(maps)
        return flat if exponent is None else flat.with_rise(exponent)

    def solve(
        self, raw: dict[str, Tensor], parts: Parts, solver: Stepping, samples: Tensor, until: float, watch: Watch | None
    ) -> Descent:
        """Change `raw` by `solver`, all texels and maps at once, on some `samples`; only what has a `watch` is noted."""
        training = self.surface.training
        texels = training.btf.height * training.btf.width

        def objective(rows: Tensor | None) -> float:
            total, every = 0.0, samples if rows is None else rows
            for batch in every.split(self._images):
                with torch.enable_grad():
                    loss = self.misfit(raw, parts, batch, len(batch) / len(every) / self.objective.unit)
                total += float(loss.detach())
                if not math.isfinite(total):  # look-ups in places that are none may end the process
                    return total
                loss.backward()
            if "specular" in raw:
                with torch.enable_grad():
                    rough = roughness_of(raw["specular"]) * (_SMOOTH / (len(samples) * texels))
                rough.backward()
                total += float(rough.detach())
            return total

        parameters = [value.requires_grad_() for value in raw.values()]
        least = 1e-8 if training.shared is None else _LEAST_GRADIENT / texels
        found = solver.descend(Problem(
            parameters, objective, rates_of(raw), lambda generator: training.drawn(samples, generator), self._images,
            training.seed, least, until, watch or training.watch,
            (lambda: self._material(raw, parts)) if watch else None,
            training.progress,
        ))
        for value in parameters:
            value.requires_grad_(False).grad = None
        return found

    def _material(self, raw: dict[str, Tensor], parts: Parts) -> Distribution:
        maps = maps_of(raw | self.known)
        ambient = maps.pop("ambient")
        maps.pop(EXPONENT, None)
        if self.surface.training.shared is None:  # else other texels share the maps, and say what is the most
            maps |= to_one(maps, self.surface.training.btf.mask)
        if self.height is not None:
            maps |= {"height": self.height, "ambient": ambient}
            if parts.normal:
                maps["normal"] = normals_from_slopes(raw["normal"] - self.surface.slopes)
        return Distribution(
            {name: value.detach() for name, value in maps.items()}, lobes=parts.lobes, parts=parts.names,
            fresnel_exponent=self.exponent(raw), specular_spacing=parts.spacing, storage=self.options.storage, tiles=self.surface.training.tiles,
            relief=self.surface.training.relief,
        )
