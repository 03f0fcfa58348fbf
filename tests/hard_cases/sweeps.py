"""Values and gradients of every public function of the elementary rooms, over all floats, against mpmath at 60 digits.

A table of entries says for each function how it is called on columns of floats and what the true result is; a function
without an entry fails a test. A figure is the number of decimal digits lost to rounding, beyond the one ulp that every
result has: log10 of the worst error in units of eps times its scale. Gradients are held to central differences in 60
digits; at a kink, where those from the two sides differ, to lie between them.
"""

from __future__ import annotations

import importlib
import inspect
import math
from collections.abc import Callable, Sequence
from types import ModuleType
from typing import NamedTuple

import mpmath
import numpy as np
import torch
from tests.hard_cases.floats import sweep
from mpmath import mpf
from torch import Tensor

ROOMS = (
    "safe", "frames", "colour", "geometry.normals", "geometry.rays", "geometry.integrate",
    "geometry.photometric_stereo", "geometry.from_photographs",
)
DTYPES = (torch.float32, torch.float64)
_STEP = mpf(2) ** -80
_SAME = mpf(10) ** -6  # relative difference of one-sided derivatives, above which there is a kink


class Interval(NamedTuple):
    """What one input is swept over."""

    low: float = -math.inf
    high: float = math.inf
    kinks: tuple[float, ...] = ()


class Entry(NamedTuple):
    """A function as the sweep sees it.

    `call` maps columns [n], one for each of `inputs`, to [outputs, n]; `exact` maps the dtype's limits and numbers of
    mpmath to the outputs, or to None where only finite numbers are promised. An error counts relative to "each" output,
    to the "largest" of the point (of derivatives: of its Jacobian), to "one" or more, or to the "terms",
    |f| + sum |x df/dx|: what rounding the inputs costs; a derivative by directions also to the "value", if more.
    `value` and `gradient` are the digits that may be lost; a `gradient` of None means that it has none. `share` of the
    wanted count is swept. `prepare` turns the columns into what the function asks for (unit vectors); `check` returns
    what is wrong with the outputs as a whole, or nothing.
    """

    call: Callable[..., Tensor]
    exact: Callable[..., Sequence | None]
    inputs: tuple[Interval, ...]
    value: float = 0.7
    gradient: float | None = 1.0
    scale: str = "each"
    gradient_scale: str = "each"
    share: float = 1.0
    prepare: Callable[[list[Tensor]], list[Tensor]] | None = None
    check: Callable[..., str] | None = None


def public_functions(module: ModuleType) -> list[str]:
    """Return the names of the public functions that a module defines."""
    return [
        name for name, value in vars(module).items()
        if inspect.isfunction(value) and value.__module__ == module.__name__ and not name.startswith("_")
    ]


def all_functions() -> list[str]:
    """Return ``room.function`` for every public function of the elementary rooms."""
    found = []
    for room in ROOMS:
        found += [f"{room}.{name}" for name in public_functions(importlib.import_module(f"torchmat.{room}"))]
    return found


class Worst:
    """The worst error so far, in digits, and where it was."""

    def __init__(self) -> None:
        self.digits, self.where, self.broken = 0.0, "", ""

    def add(self, found: float, wanted: mpf, scale: mpf, floor: float, eps: float, where: Sequence[float]) -> None:
        """Count one result; `floor` is an absolute error that does not count."""
        if not math.isfinite(found):
            self.broken = self.broken or f"{found} instead of {mpmath.nstr(wanted, 5)} at {_said(where)}"
            return
        error = abs(mpf(found) - wanted) - floor
        if error <= 0:
            return
        digits = float(mpmath.log10(error / (eps * scale))) if scale > 0 else math.inf
        if digits > self.digits:
            self.digits, self.where = digits, _said(where)

    def row(self, case: str, component: str, count: int, allowed: float) -> dict:
        """Return what is reported."""
        passed = not self.broken and self.digits <= allowed
        note = self.broken or (f"worst at {self.where}" if self.where else "")
        return {
            "case": case,
            "component": component,
            "count": count,
            "passed": passed,
            "figure": round(self.digits, 2),
            "note": note,
        }


def _said(where: Sequence[float]) -> str:
    return "(" + ", ".join(f"{x!r}" for x in where) + ")"


def columns_of(entry: Entry, dtype: torch.dtype, count: int, seed: int) -> list[Tensor]:
    """Return a column of floats for each input, of one length, in orders that do not go together."""
    random = np.random.default_rng(seed)
    found = [sweep(dtype, max(2, int(count * entry.share)), random, *interval) for interval in entry.inputs]
    longest = max(map(len, found))
    found = [one.repeat(-(-longest // len(one)))[:longest] for one in found]
    return found if entry.prepare is None else entry.prepare(found)


def _nothing(info: torch.finfo) -> float:
    """Return the log10 of the step from 0."""
    return math.log10(info.smallest_normal) + 2 * math.log10(info.eps)


def digits_for(point: Sequence[float], info: torch.finfo) -> int:
    """Return with how many digits differences at a point are found: the square of what lies apart, and some more."""
    exponents = [0.0, *(math.log10(abs(x)) if x != 0 else _nothing(info) for x in point)]
    return 70 + int(2 * (max(exponents) - min(exponents)))


def jacobian(outputs: Tensor, leaves: Sequence[Tensor]) -> list[list[list[float]]]:
    """Return d output / d input at every point: [output][input][point]."""
    found = []
    for row in outputs:
        if not row.requires_grad:
            found.append([[0.0] * len(leaf) for leaf in leaves])
            continue
        parts = torch.autograd.grad(row.sum(), leaves, retain_graph=True, allow_unused=True)
        found.append(
            [[0.0] * len(leaf) if part is None else part.tolist() for part, leaf in zip(parts, leaves, strict=True)]
        )
    return found


def one_sided(
    exact: Callable, info: torch.finfo, point: list[mpf], index: int, here: Sequence
) -> list[tuple[mpf, mpf, mpf]] | None:
    """Return (left, central, right) differences of each output along one input."""
    least = min((abs(x) for x in point if x != 0), default=mpf(1))
    step = min(least * _STEP, mpf(10) ** mpf(_nothing(info))) if point[index] == 0 else least * _STEP
    moved = [exact(info, *point[:index], point[index] + side * step, *point[index + 1 :]) for side in (-1, 1)]
    if None in moved:
        return None
    pairs = zip(moved[0], here, moved[1], strict=True)
    return [((at - below) / step, (above - below) / (2 * step), (above - at) / step) for below, at, above in pairs]


def _scale(kind: str, wanted: Sequence[mpf], number: int, terms: mpf) -> mpf:
    if kind == "each":
        return abs(wanted[number])
    if kind in ("largest", "one"):
        return max(mpf(kind == "one"), *(abs(one) for one in wanted))
    return abs(wanted[number]) + terms


def _smooth(left: mpf, right: mpf) -> bool:
    return abs(right - left) <= _SAME * max(abs(left), abs(right))


def _count_gradient(
    worst: Worst, found: float, sides: tuple[mpf, mpf, mpf], scale: mpf, info: torch.finfo, floor: float, where
) -> None:
    left, central, right = sides
    if _smooth(left, right):
        if abs(central) <= info.max:
            worst.add(found, central, scale, floor, info.eps, where)
        return
    low, high = min(left, right), max(left, right)
    if not math.isfinite(found):
        if min(abs(left), abs(right)) <= info.max:
            worst.add(found, central, scale, 0.0, info.eps, where)
        return
    # At a kink any number between the two is a subgradient.
    nearest = min(max(mpf(found), low), high)
    worst.add(found, nearest, max(scale, abs(nearest)), floor, info.eps, where)


def sweep_entry(name: str, entry: Entry, dtype: torch.dtype, count: int, seed: int) -> list[dict]:
    """Return the rows of one function: its values, and its gradients where it has any."""
    info = torch.finfo(dtype)
    leaves = [one.requires_grad_(entry.gradient is not None) for one in columns_of(entry, dtype, count, seed)]
    outputs = entry.call(*leaves)
    slopes = jacobian(outputs, leaves) if entry.gradient is not None else None
    values, inputs = outputs.tolist(), [leaf.tolist() for leaf in leaves]
    value, gradient = Worst(), Worst()
    for point in range(len(inputs[0])):
        where = [column[point] for column in inputs]
        with mpmath.workdps(digits_for(where, info)):
            _at_point(entry, info, where, [row[point] for row in values], slopes, point, (value, gradient))
    if entry.check is not None:
        value.broken = value.broken or entry.check([leaf.detach() for leaf in leaves], outputs.detach())
    component = f"{name}, {str(dtype).removeprefix('torch.')}"
    rows = [value.row("values", component, len(inputs[0]), entry.value)]
    if entry.gradient is not None:
        rows.append(gradient.row("gradients", component, len(inputs[0]), entry.gradient))
    return rows


def _at_point(
    entry: Entry, info: torch.finfo, where: list[float], found: list[float], slopes, point: int, worst
) -> None:
    numbers = [mpf(x) for x in where]
    wanted = entry.exact(info, *numbers)
    if wanted is None:
        steep = [row[point] for part in slopes or [] for row in part]
        for tracker, numbers in zip(worst, (found, steep), strict=True):
            if not all(map(math.isfinite, numbers)):
                tracker.broken = tracker.broken or f"not finite at {_said(where)}"
        return
    if any(abs(one) > info.max for one in wanted):
        return
    needed = entry.gradient is not None or entry.scale == "terms"
    sides = [one_sided(entry.exact, info, numbers, index, wanted) for index in range(len(numbers))] if needed else []
    none = [(mpf(0),) * 3] * len(wanted)
    table = [[(side or none)[number] for side in sides] for number in range(len(wanted))]
    steepest = max((abs(side[1]) for row in table for side in row), default=mpf(0))
    for number, one in enumerate(found):
        terms = sum((abs(x * side[1]) for x, side in zip(numbers, table[number], strict=needed)), mpf(0))
        if entry.scale == "terms" and abs(wanted[number]) + terms > info.max:
            continue  # a partial sum may overflow
        worst[0].add(one, wanted[number], _scale(entry.scale, wanted, number, terms), info.tiny, info.eps, where)
        condition = 1 + (terms / abs(wanted[number]) if wanted[number] else 0)
        for index, side in enumerate(table[number] if slopes is not None else ()):
            if sides[index] is None:
                continue
            scale = abs(side[1]) if entry.gradient_scale in ("each", "terms") else steepest
            scale = max(scale, *(abs(x) for x in wanted)) if entry.gradient_scale == "value" else scale
            scale = scale * condition if entry.gradient_scale == "terms" else scale
            # What underflows takes its derivative with it.
            lost = (
                info.tiny / min(max(abs(where[index]), info.tiny), 1.0)
                if entry.gradient_scale == "terms"
                else info.tiny
            )
            _count_gradient(worst[1], slopes[number][index][point], side, scale, info, lost, where)


def run(count: int = 60, seed: int = 0, only: Sequence[str] | None = None) -> list[dict]:
    """Return the rows of all functions, or of those whose names are in `only`, in both precisions."""
    from tests.hard_cases.sweep_entries import ENTRIES

    rows = []
    for name, entry in ENTRIES.items():
        if isinstance(entry, str) or (only is not None and name not in only):
            continue
        for dtype in DTYPES:
            rows += sweep_entry(name, entry, dtype, count, seed)
    return rows
