"""Fit of the neural material: Adam on random texels under random samples."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torchmat.errors import check_option, check_positive
from torchmat.fitting.geometry import RECOVER
from torchmat.fitting.objective import Objective, Residual, check_objective
from torchmat.fitting.recipe import Recipe, Rung, Tiling
from torchmat.fitting.training import Fitted, Training
from torchmat.models.neural import Neural, angles, check_count, root_of_value, widths
from torchmat.models.storage import STORAGES
from torchmat.repeatable import one_thread, product, wide_product
from torchmat.solvers import Minibatch, Problem

_PAIRS = 8192  # texels x samples of one step
FEWEST_TEXELS, _MOST_GROUPS = 512, 128
POOL_VALUES, _BLOCK_VALUES = 64_000_000, 2_000_000  # decoded values held at a time (256 MB), and decoded at a time
_PASSES = 2  # over what is held before other samples take its place
_STEPS = 12000
_VISITS = 200  # of each group at least
_LEVEL_SAMPLES = 256
_START = 0.5  # spread of the latent numbers
_RATE, _LATENT = 1e-2, 4.0  # of the tables, and how many times faster latent numbers go
ROOT = "root"


class _Product(torch.autograd.Function):
    """A product whose gradients, too, round alike on any number of threads."""

    @staticmethod
    def forward(ctx: Any, weight: Tensor, columns: Tensor) -> Tensor:
        ctx.save_for_backward(weight, columns)
        return wide_product(weight, columns)

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, Tensor | None]:
        weight, columns = ctx.saved_tensors
        of_weight = product(gradient, columns.T) if ctx.needs_input_grad[0] else None
        of_columns = wide_product(weight.T.contiguous(), gradient) if ctx.needs_input_grad[1] else None
        return of_weight, of_columns


def fit_neural(
    training: Training, *, latent: int = 8, hidden: int = 32, layers: int = 2, effort: float = 1.0,
    storage: str = "png8", solver: Minibatch = Minibatch(), objective: str | Residual = ROOT,
) -> Fitted:
    """Fit a latent texture and a network by Adam, on random texels under random samples.

    The error is that of the root of the value. Texels are dealt into groups once, and a step takes one group under some of
    the samples: a latent number moves only when its texel is looked at. Only some of the images are held in memory at
    a time. With a limit of seconds the rate falls to its end within them.

    Args:
        latent: numbers a texel, 1 to 1024.
        hidden: units of a hidden layer, 1 to 1024.
        layers: hidden layers, 1 to 1024.
        effort: factor on the number of steps, above 0.
        solver: a Minibatch may say `steps`, the `rate` (0.01; latent numbers go four times as fast) and the `batch` of samples
            of a step.
        objective: "root" is the error of the root of the value, which the network gives.
    """
    where = "fit neural"
    check_option(where, "storage", storage, STORAGES)
    for name, count in (("latent", latent), ("hidden", hidden), ("layers", layers)):
        check_count(where, name, count)
    check_positive(where, "effort", effort)
    check_objective(where, objective, (ROOT,))
    return _Fit(training, latent, hidden, layers, effort, storage, solver, objective).run()


class _Pool(NamedTuple):
    """Decoded samples: `rows` [k] among the training samples, `root` [k, 3, texels] in units of the level, `weight`."""

    rows: Tensor
    root: Tensor
    weight: Tensor


class _Fit:
    """One fit in progress; texels are kept in the order in which they were dealt into groups."""

    def __init__(
        self, training: Training, latent: int, hidden: int, layers: int, effort: float, storage: str, solver: Minibatch,
        objective: str | Residual,
    ) -> None:
        btf = training.btf
        self.training, self.storage = training, storage
        self.options = {"latent": latent, "hidden": hidden, "layers": layers}
        generator = torch.Generator().manual_seed(training.seed)
        texels = len(btf.inside)
        self.order = btf.inside[torch.randperm(texels, generator=generator)]
        size = min(texels, max(FEWEST_TEXELS, math.ceil(texels / _MOST_GROUPS)))
        self.groups = [slice(first, min(first + size, texels)) for first in range(0, texels, size)]
        self.batch = solver.batch or max(1, _PAIRS // size)
        steps = max(1, round(effort * max(_STEPS, _VISITS * len(self.groups))))
        self.solver = replace(solver.filled(steps=steps, rate=_RATE), batch=self.batch)
        counts = training.used if training.importance is None else training.used & (training.importance > 0)
        self.rows = counts.nonzero()[:, 0]
        self.known = None if btf.near is not None else self._known_of_all()
        self.level = self._mean_value()
        self.objective = None if objective == ROOT else Objective(objective, self.level)
        self._start(generator)
        self.pool: _Pool | None = None
        self.turn = 0

    def _known_of_all(self) -> Tensor:
        """Return what the network is told of the directions of all samples, [8, sample, 1]."""
        known = angles(*self.training.planes(self.rows))
        return known[:, :, :, 0].movedim(1, 0).contiguous()

    def _known(self, rows: Tensor, texels: slice) -> Tensor:
        """Return what the network is told of the directions of samples [k], [8, k, 1], or of each of some texels, [8, k, t]."""
        if self.known is not None:
            return self.known[:, rows]
        btf, dtype, sample = self.training.btf, self.training.dtype, self.rows[rows]
        assert btf.near is not None
        planes = []
        for which, far in zip(("light", "view"), (btf.light, btf.view), strict=True):
            found = btf.near.at(which, sample, self.order[texels], dtype)
            planes.append(far[sample].to(dtype)[:, :, None, None] if found is None else found[:, :, None])
        return angles(*planes)[:, :, 0].movedim(1, 0).contiguous()

    def _mean_value(self) -> float:
        """Return the mean of some images, the unit that the network works in."""
        chosen = self.rows[torch.linspace(0, len(self.rows) - 1, min(len(self.rows), _LEVEL_SAMPLES)).round().long()]
        total = weight = 0.0
        with one_thread():
            for row in chosen.split(8):
                counts = self.training.btf.weights(row).double()
                total += float((self.training.btf.images(row).clamp(min=0) * counts).sum(dtype=torch.float64))
                weight += 3 * float(counts.sum())
        return max(total / max(weight, 1e-12), 1e-12)

    def _start(self, generator: torch.Generator) -> None:
        """Draw the latent numbers and the tables, in double precision so that both precisions start alike."""

        def normal(*shape: int) -> Tensor:
            return torch.randn(*shape, generator=generator, dtype=torch.float64)

        self.latents = [_START * normal(self.options["latent"], group.stop - group.start) for group in self.groups]
        self.tables = []
        for outputs, inputs in widths(**self.options):
            gain = math.sqrt((1 if outputs == 3 else 2) / inputs)  # He et al. 2015, but for the last
            bias = torch.zeros(outputs, 1, dtype=torch.float64)
            self.tables.append(torch.cat((gain * normal(outputs, inputs), bias), dim=1))
        self.tables[-1][:, -1] = 0.5
        for values in (self.latents, self.tables):
            values[:] = [value.to(self.training.dtype) for value in values]

    def run(self) -> Fitted:
        parameters = [*self.latents, *self.tables]
        rates = [_LATENT] * len(self.latents) + [1.0] * len(self.tables)
        for value in parameters:
            value.requires_grad_()
        training = self.training
        found = self.solver.descend(Problem(
            parameters, self._error, rates, self._draw, self.batch, training.seed, watch=training.watch, made=self._material,
            show=training.progress,
        ))
        for value in parameters:
            value.requires_grad_(False)
        figures = {"adam_steps": found.steps, "network_numbers": sum(table.numel() for table in self.tables)}
        return Fitted(self._material(), found.reason, None, figures, history=found.history)

    def _draw(self, generator: torch.Generator) -> Tensor:
        """Decode as many samples as memory is meant for; return their places, shuffled, twice for each group."""
        count = min(len(self.rows), max(1, POOL_VALUES // (3 * len(self.order))))
        if self.pool is None or count < len(self.rows):
            self.pool = self._decode(torch.randperm(len(self.rows), generator=generator)[:count].sort().values)
        return torch.cat([torch.randperm(count, generator=generator) for _ in range(_PASSES * len(self.groups))])

    def _decode(self, rows: Tensor) -> _Pool:
        btf, dtype = self.training.btf, self.training.dtype
        root = torch.empty(len(rows), 3, len(self.order), dtype=dtype)
        weight = torch.empty(len(rows), 1, len(self.order), dtype=dtype)
        for part in torch.arange(len(rows)).split(max(1, _BLOCK_VALUES // (3 * len(self.order)))):
            sample = self.rows[rows[part]]
            weight[part] = self.training.counted(btf.weights(sample).flatten(2)[:, :, self.order].to(dtype), sample)
            value = btf.images(sample, dtype).flatten(2)[:, :, self.order].clamp(min=0) / self.level
            root[part] = torch.where(weight[part] > 0, value.sqrt(), 0.0)
        return _Pool(rows, root, weight)

    def _error(self, chosen: Tensor | None) -> float:
        """Return the error of the next group of texels under some of the decoded samples; leave its gradient."""
        group = self.turn % len(self.groups)
        self.turn += 1
        texels = self.groups[group]
        assert self.pool is not None and chosen is not None
        target, weight = self.pool.root[chosen, :, texels], self.pool.weight[chosen, :, texels]
        with torch.enable_grad():
            known = self._known(self.pool.rows[chosen], texels)
            root = root_of_value(self.latents[group], known, self.tables, _Product.apply)
            if self.objective is not None:
                return self._step_toward(self.objective, root.movedim(0, 1), target, weight)
        gap = root.detach().movedim(0, 1) - target
        # Below 0 the value is 0 whatever the root: only a target above it pulls.
        gap = torch.where((gap < 0) & (target == 0), 0.0, gap)
        weighted = gap * weight
        root.backward((weighted * (2 / weighted.numel())).movedim(0, 1))
        with one_thread():
            return float((weighted * gap).mean())

    def _step_toward(self, objective: Objective, root: Tensor, target: Tensor, weight: Tensor) -> float:
        """Return the error of roots [k, 3, texels] by an objective over values; leave its gradient."""
        values, wanted = (one.clamp(min=0).square()[..., None] * self.level for one in (root, target))
        loss = objective.squares(values, wanted, weight[..., None]).mean() / objective.unit
        loss.backward()
        return float(loss.detach())

    def _material(self) -> Neural:
        btf = self.training.btf
        dealt = torch.cat([value.detach() for value in self.latents], dim=1)
        latent = dealt.new_zeros(len(dealt), btf.height * btf.width)
        latent[:, self.order] = dealt
        maps = {"latent": latent.unflatten(1, (btf.height, btf.width))}
        for number, table in enumerate(self.tables):
            unit = math.sqrt(self.level) if number == len(self.tables) - 1 else 1.0
            maps[f"layer_{number}"] = table.detach()[None] * unit
        return Neural(maps, **self.options, storage=self.storage, tiles=self.training.tiles)


_REFUSED = ("has one network for all texels", "Leave tile_size, memory_mb and work out: it holds only some of the images and texels at a time.")
NEURAL = Recipe(
    Neural, fit_neural, near=True, bytes_per_texel="8", solvers=("minibatch",), descends=False, objective=ROOT,
    quick={"effort": 0.1}, rungs=(Rung("network", "neural", 8, last=True),),
    tiling=Tiling(refused=_REFUSED), geometry=RECOVER,
)
