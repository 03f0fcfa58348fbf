"""Every registered model over hard directions and over all floats of its maps, float32 against float64 against loops.

Float64 is held to the scalar oracles of `reference.materials`, float32 to float64 with the same (rounded) numbers, and
gradients by directions to one-sided differences of the float64 value: where those differ there is a kink, and the
gradient must lie between them. New models are found through `models.examples.CASES`.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import torch
from tests.hard_cases.floats import neighbours, sweep
from tests.models.examples import CASES, make_maps, per_image, specs_of
from tests.reference import materials as oracle
from torch import Tensor

from torchmat.models import MATERIALS, Material

DTYPES = (torch.float32, torch.float64)
_STEP = 1e-6
_WITH_AZIMUTH = ("shading_map", "sphere_images", "pca", "local_pca")
_MODEST = 1e-3  # gradients are held to differences where light and view stand at least so high, and apart from opposite


def pairs(dtype: torch.dtype, count: int, seed: int) -> tuple[Tensor, Tensor]:
    """Return light and view [n, 3] of length 1 within rounding: at most 12 `count` hard ones, `count` random ones.

    From the pole to one ulp above the horizon and below, equal, mirrored, opposite and nearly so.
    """
    info, random = torch.finfo(dtype), np.random.default_rng(seed)
    heights = [
        1.0,
        *neighbours(1.0, dtype)[:1],
        0.6,
        1e-2,
        1e-4,
        1e-7,
        info.eps,
        info.tiny,
        neighbours(0.0, dtype)[2],
        0.0,
        -1e-4,
        -0.5,
    ]
    hard = []
    for height in heights:
        flat = math.sqrt(max(0.0, 1 - height * height))
        for azimuth in (0.0, 0.3, math.pi / 2, math.pi, 0.3 + math.pi):
            hard.append((flat * math.cos(azimuth), flat * math.sin(azimuth), height))
    hard += [(1e-20, -1e-20, 1.0), (info.tiny, 0.0, 1.0), (-0.0, -0.0, 1.0), (1.0, -info.tiny, info.eps)]
    hard = np.array(hard)
    chosen = random.permutation(len(hard) ** 2)[: 12 * count]
    light, view = hard[chosen % len(hard)], hard[chosen // len(hard)]
    z = random.uniform(0, 1, (count, 2)) ** random.choice((1, 4, 16), (count, 2))
    azimuth = random.uniform(0, 2 * np.pi, (count, 2))
    radius = np.sqrt(1 - z * z)
    free = np.stack((radius * np.cos(azimuth), radius * np.sin(azimuth), z), axis=2)
    light, view = np.concatenate((light, free[:, 0])), np.concatenate((view, free[:, 1]))
    return torch.from_numpy(light).to(dtype), torch.from_numpy(view).to(dtype)


def twin(name: str, options: dict, dtype: torch.dtype, width: int = 1, **replaced: Tensor) -> tuple[Material, Material]:
    """Return a material of `dtype` and one of float64 with the same numbers."""
    maps = {**{key: value.to(dtype) for key, value in make_maps(name, options, 1, width).items()}, **replaced}
    double = {key: value.double() for key, value in maps.items()}
    return MATERIALS[name](maps, **options), MATERIALS[name](double, **options)


def digits(error: Tensor, scale: Tensor | float, dtype: torch.dtype) -> Tensor:
    """Return digits lost: log10 of errors in units of eps times `scale`."""
    units = error / (torch.finfo(dtype).eps * scale)
    return torch.nan_to_num(units, nan=math.inf).clamp(min=1).log10()


def row(
    case: str, component: str, dtype: torch.dtype, lost: Tensor, allowed: float, where: list[str], broken: str = ""
) -> dict:
    """Return what is reported of digits lost [n]."""
    worst = int(lost.argmax()) if lost.numel() else 0
    figure = float(lost[worst]) if lost.numel() else 0.0
    note = broken or (f"worst at {where[worst]}" if figure > 0 else "")
    component = f"{component}, {str(dtype).removeprefix('torch.')}"
    passed = not broken and figure <= allowed
    return {
        "case": case,
        "component": component,
        "count": lost.numel(),
        "passed": passed,
        "figure": round(figure, 2),
        "note": note,
    }


def _typical(value: Tensor) -> float:
    """Return the scale of a material's values, which those near 0 are measured by."""
    lit = value[value > 0]
    return float(lit.median()) if lit.numel() else 1.0


def by_reference(name: str, options: dict, material: Material, light: Tensor, view: Tensor) -> Tensor:
    """Return the oracle's values [n, 3] of a 1 x 1 material; NaN where its formulas divide by 0."""
    maps = {key: value.detach().double().numpy() for key, value in material.maps.items()}
    found = []
    for one, other in zip(light.double().numpy(), view.double().numpy(), strict=True):
        try:
            with np.errstate(all="ignore"):
                found.append(oracle.shade(name, maps, options, one[:, None, None], other[:, None, None], 1, 1)[:, 0, 0])
        except (ZeroDivisionError, ValueError):
            found.append(np.full(3, np.nan))
    return torch.from_numpy(np.array(found))


def _true_slopes(double: Material, light: Tensor, view: Tensor) -> dict[str, Tensor]:
    """Return the twin's gradients by direction."""
    leaves = {"light": per_image(light.double()).requires_grad_(), "view": per_image(view.double()).requires_grad_()}
    double.shade(*leaves.values()).sum().backward()
    return {label: leaf.grad for label, leaf in leaves.items()}


def _broken(
    value: Tensor, leaves: dict[str, Tensor], below: Tensor, true_slopes: Callable[[], dict[str, Tensor]]
) -> str:
    """Return what is wrong with values and gradients on principle; a gradient must be finite if the true one fits."""
    if not bool(torch.isfinite(value).all()):
        return f"a value is not finite at pair {int((~torch.isfinite(value)).nonzero()[0, 0])}"
    if bool((value < 0).any()):
        return "a value is negative"
    if bool((value[below] != 0).any()):
        return "a value below the horizon is not 0"
    for label, leaf in leaves.items():
        if leaf.grad is not None and not bool(torch.isfinite(leaf.grad).all()):
            bad = ~torch.isfinite(leaf.grad)
            if label in ("light", "view"):
                bad = bad & (true_slopes()[label].abs() < torch.finfo(value.dtype).max)
            if bool(bad.any()):
                return f"the gradient of {label} is not finite at {bad.nonzero()[0].tolist()}"
        if label in ("light", "view") and leaf.grad is not None and bool((leaf.grad[below] != 0).any()):
            return f"the gradient of {label} below the horizon is not 0"
    return ""


def _said(light: Tensor, view: Tensor) -> list[str]:
    return [f"light {one}, view {other}" for one, other in zip(light.tolist(), view.tolist(), strict=True)]


def sweep_directions(name: str, options: dict, component: str, dtype: torch.dtype, count: int, seed: int) -> list[dict]:
    """Return the rows of a model's values and gradients over directions."""
    light, view = pairs(dtype, count, seed)
    material, double = twin(name, options, dtype)
    leaves = {"light": per_image(light).clone().requires_grad_(), "view": per_image(view).clone().requires_grad_()}
    value = material.shade(leaves["light"], leaves["view"])
    value.sum().backward()
    below = (light[:, 2] <= 0) | (view[:, 2] <= 0)
    broken = _broken(value.detach(), {**leaves, **material.maps}, below, lambda: _true_slopes(double, light, view))
    with torch.no_grad():
        if dtype == torch.float64:
            chosen = _some(
                ((light[:, 2] > 0) & (view[:, 2] > 0) & _comparable(light, view)).nonzero()[:, 0], count, seed
            )
            wanted = by_reference(name, options, double, light[chosen], view[chosen])
        else:
            chosen = torch.arange(len(light))
            wanted = double.shade(per_image(light.double()), per_image(view.double()))[:, :, 0, 0]
    known = torch.isfinite(wanted).all(dim=1) & _comparable(light[chosen], view[chosen])
    chosen, wanted = chosen[known], wanted[known]
    error = (value.detach()[chosen, :, 0, 0].double() - wanted).abs().amax(dim=1)
    scale = wanted.amax(dim=1).clamp(min=_typical(wanted))
    if dtype == torch.float64:
        # The formulas' H.L and H.V are one number for vectors of length 1, which rounding leaves them so nearly.
        scale = scale * (1 + 1 / (light[chosen] + view[chosen]).square().sum(dim=1))
    lost = digits(error, scale, dtype)
    said = _said(light[chosen], view[chosen])
    rows = [
        row(
            "values by direction",
            component,
            dtype,
            lost,
            VALUE_DIGITS.get(name, VALUE_DIGITS[""])[DTYPES.index(dtype)],
            said,
            broken,
        )
    ]
    slopes = [torch.zeros_like(light) if leaf.grad is None else leaf.grad[:, :, 0, 0] for leaf in leaves.values()]
    return [*rows, _gradient_row(name, double, component, light, view, slopes)]


def _comparable(light: Tensor, view: Tensor) -> Tensor:
    """Return at which pairs [n] two precisions must agree.

    Not where what the half vector or the sphere's frame is made of is denormal in one of them, and counts as nothing;
    and not where the oracles' products of two cosines underflow.
    """
    tiny = torch.finfo(light.dtype).tiny
    total, across = (light + view).abs().amax(dim=1), torch.linalg.cross(light, view).abs().amax(dim=1)
    seen = (total >= tiny) & ((across >= tiny) | (light == view).all(dim=1))
    return seen if light.dtype == torch.float32 else seen & (light[:, 2] > 1e-150) & (view[:, 2] > 1e-150)


def _some(pairs: Tensor, count: int, seed: int) -> Tensor:
    """Return at most `count` of the numbers of `pairs`."""
    return pairs[torch.randperm(len(pairs), generator=torch.Generator().manual_seed(seed))[:count]]


def _tangents(direction: Tensor) -> Tensor:
    """Return two unit tangents [2, n, 3] of directions [n, 3]: along the horizon, and across."""
    x, y, _ = direction.T
    radius = torch.hypot(x, y)
    there = radius > 0
    along = torch.stack((-y, x, torch.zeros_like(x)), dim=1) / torch.where(there, radius, 1.0)[:, None]
    along = torch.where(there[:, None], along, along.new_tensor([1.0, 0, 0]))
    return torch.stack((along, torch.linalg.cross(direction, along)))


def _smooth_around(name: str, light: Tensor, view: Tensor) -> Tensor:
    """Return the pairs [n] whose gradients are held to differences: others turn over shorter ways than the step.

    Where an azimuth has no meaning, at the pole and where light and view coincide, some models have gradient 0.
    """
    found = (light[:, 2] > _MODEST) & (view[:, 2] > _MODEST) & ((light + view).norm(dim=1) > _MODEST)
    if name in _WITH_AZIMUTH:
        for vector in (light, view, light + view, light - view):
            found &= vector[:, :2].norm(dim=1) > _MODEST
    return found


def _gradient_row(
    name: str, double: Material, component: str, light: Tensor, view: Tensor, slopes: list[Tensor]
) -> dict:
    """Hold gradients along the sphere to differences of the float64 value from either side."""
    dtype, both = light.dtype, [light.double(), view.double()]
    high = _smooth_around(name, *both)
    both = [one[high] for one in both]

    def total(moved: list[Tensor]) -> Tensor:
        return double.shade(*(per_image(one) for one in moved)).sum(dim=(1, 2, 3))

    with torch.no_grad():
        here, excess, scale = total(both), [], []
        for which in (0, 1):
            for tangent in _tangents(both[which]):
                found = (slopes[which][high].double() * tangent).sum(dim=1)
                sides = [_one_sided(total, both, which, tangent, side, here) for side in (-1, 1)]
                low, top = torch.minimum(*sides), torch.maximum(*sides)
                excess.append(torch.maximum(low - found, found - top).clamp(min=0))
                scale.append(torch.maximum(low.abs(), top.abs()))
    scale = torch.stack(scale).amax(dim=0).clamp(min=_typical(here))
    share = torch.stack(excess).amax(dim=0) / scale
    # As digits of the gradient that agree, 10 at most: differences in double precision have no more.
    agree = -share.clamp(min=1e-10).log10()
    least, where = (float(agree.min()), int(agree.argmin())) if len(agree) else (10.0, 0)
    allowed = GRADIENT_DIGITS.get(name, GRADIENT_DIGITS[""])[DTYPES.index(dtype)]
    said = _said(light[high][where : where + 1], view[high][where : where + 1])[0]
    return {
        "case": "gradients by direction (digits kept)",
        "component": f"{component}, {str(dtype).removeprefix('torch.')}",
        "count": len(agree),
        "passed": least >= allowed,
        "figure": round(least, 2),
        "note": f"worst at {said}",
    }


def _one_sided(total, both: list[Tensor], which: int, tangent: Tensor, side: int, here: Tensor) -> Tensor:
    """Return the derivative along a tangent from one side, its error of the second order."""
    # Near the horizon and near opposite directions values turn over shorter ways.
    reach = torch.minimum(both[0][:, 2], both[1][:, 2]).minimum((both[0] + both[1]).norm(dim=1)).clamp(min=1e-4)
    found = []
    for part in (1.0, 0.5):
        step = (side * part * _STEP * reach)[:, None]
        moved = both[which] * torch.cos(step) + tangent * torch.sin(step)
        pair = [moved, both[1]] if which == 0 else [both[0], moved]
        found.append((total(pair) - here) / step[:, 0])
    return 2 * found[1] - found[0]


def sweep_maps(name: str, options: dict, component: str, dtype: torch.dtype, count: int, seed: int) -> list[dict]:
    """Return a row for each map of one value a texel, swept over all floats of its range."""
    light, view = torch.tensor([0.3, -0.2, 0.9327379], dtype=dtype), torch.tensor([-0.4, 0.1, 0.9110434], dtype=dtype)
    light, view = light[:, None, None], view[:, None, None]
    rows = []
    for spec in specs_of(name, options):
        if spec.index or spec.constant or not spec.per_texel:
            continue
        random = np.random.default_rng(seed)
        low, high = (-math.inf if spec.low is None else spec.low), (math.inf if spec.high is None else spec.high)
        columns = [sweep(dtype, count, random, low, high) for _ in range(spec.channels)]
        planes = torch.stack(columns)[:, None]
        single, double = twin(name, options, dtype, planes.shape[-1], **{spec.name: planes})
        rows.append(_map_row(f"{component}.{spec.name}", spec.name, single, double, light, view))
    return rows


def _map_row(component: str, key: str, single: Material, double: Material, light: Tensor, view: Tensor) -> dict:
    """Compare one material with its float64 twin; where the twin's value or gradient does not fit, nothing is asked."""
    dtype = light.dtype
    most = torch.finfo(dtype).max / 1e3
    value, wanted = single.shade(light, view), double.shade(light.double(), view.double())
    for one in (value, wanted):
        one.sum().backward()
    slope, true = single.maps[key].grad, double.maps[key].grad
    fits = torch.isfinite(wanted).all(dim=0) & (wanted.abs() < most).all(dim=0) & (true.abs() < most).all(dim=0)
    largest = single.maps[key].detach().abs().amax(dim=0)
    # A denormal vector counts as none.
    fits &= (largest < most) & ((largest >= torch.finfo(dtype).tiny) | (largest == 0))
    bad = ~torch.isfinite(value).all(dim=0) | ~torch.isfinite(slope).all(dim=0)
    broken = "" if not bool((bad & fits).any()) else f"not finite for {single.maps[key][:, bad & fits][:, 0].tolist()}"
    values = double.maps[key].detach()
    terms = (true * values).abs().sum(dim=0)
    size = torch.stack((values.abs().amax(dim=0), wanted.detach().amax(dim=0), terms)).amax(dim=0).clamp(min=1)
    error = (value.detach().double() - wanted.detach()).abs().amax(dim=0) - torch.finfo(dtype).tiny
    # What large numbers of one map cancel to is measured by them.
    lost = torch.where(fits, digits(error.clamp(min=0), size, dtype), 0.0).flatten()
    said = [str(texel) for texel in single.maps[key].detach()[:, 0].T.tolist()]
    return row("values by map", component, dtype, lost, MAP_DIGITS, said, broken)


# Digits that float32 may lose against float64, and float64 against the oracles: measured over 10,000 pairs, rounded up.
VALUE_DIGITS: dict[str, tuple[float, float]] = {
    "": (1.5, 2.0),
    # Of equally far neighbours rounding chooses, and the last one's weight is 1e-3 of the first's.
    "pca": (5.0, 13.0), "local_pca": (5.0, 13.0),
    "shading_map": (1.5, 7.0),  # a table's first axis is the root of the half vector's angle: 1e-16 becomes 1e-8
    "sphere_images": (2.0, 3.0),
}
# Digits kept by gradients in float32 and float64 against one-sided differences, which keep 7 themselves.
GRADIENT_DIGITS: dict[str, tuple[float, float]] = {
    "": (1.5, 4.0),
    "pca": (-1.0, -1.0), "local_pca": (-1.0, -1.0),  # values jump by 1e-3 where neighbours change
}
MAP_DIGITS = 2.0


def run(count: int = 60, seed: int = 0) -> list[dict]:
    """Return the rows of all cases of all models."""
    rows = []
    for case in CASES:
        name, options = case.values
        for dtype in DTYPES:
            rows += sweep_directions(name, options, case.id, dtype, count, seed)
            rows += sweep_maps(name, options, case.id, dtype, count, seed)
    return rows
