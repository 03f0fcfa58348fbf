"""plan: the lights and views of the next photographs, by what those taken leave open."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from torchmat import frames
from torchmat.btf import Btf
from torchmat.errors import RangeError, ShapeError, check_option, check_unit, message
from torchmat.fitting.certainty.expected import Design, likeness
from torchmat.fitting.certainty.information import blocks_of
from torchmat.fitting.certainty.jacobian import jacobian_of
from torchmat.fitting.certainty.observed import Observed, Some, observe
from torchmat.fitting.certainty.search import CRITERIA, MEAN, choose
from torchmat.fitting.config import FitConfig
from torchmat.fitting.fit import fit
from torchmat.fitting.training import make_training
from torchmat.models import Material
from torchmat.models.uncertainty import check_sure
from torchmat.progress import working

FIXED, FREE = VIEWS = ("fixed", "free")
_LIGHTS, _FREE_LIGHTS, _FREE_VIEWS = 400, 60, 14  # of the hemisphere
_TARGETS = 240
_PLASTIC = 0.7548776662466927  # 1 / the plastic number
_TEXELS = 16  # that stand for all where texels differ
_FLATTEST = (60.0, 80.0)  # degrees: the lights of a plan go as far down as those taken, within this
_LEAST = 0.02  # of a map's range: no prior is narrower
_UNSEEN = 0.05  # of what is usual: how far off a fit is where no residual says so


@dataclass(frozen=True)
class Plan:
    """The photographs to take next, the one that helps most first.

    Args:
        light, view: unit vectors [count, 3].
        expected: the error that a fit is expected to have over the hemisphere, [count + 1]: of the photographs taken, then with
            each of the new ones; root mean square in the space of the fit.
        taken_light, taken_view: of the photographs that there are, [n, 3].
        target_light, target_view: where the error was expected, [m, 3].
        before, after: the expected error there, [m], of the photographs taken and with all new ones.
        space: of the fit: "linear", "srgb" (codes of a screen) or "display".
    """

    light: Tensor
    view: Tensor
    expected: Tensor
    taken_light: Tensor
    taken_view: Tensor
    target_light: Tensor
    target_view: Tensor
    before: Tensor
    after: Tensor
    space: str


def plan(
    btf: Btf, model: str | Path | FitConfig | Material = "hsh", *, count: int = 8, views: str | None = None, criterion: str = MEAN,
    polar_deg: float | None = None, candidates: tuple[Tensor, Tensor] | None = None, progress: bool | None = None, **options: Any,
) -> Plan:
    """Return the lights and views whose photographs would reduce the expected error of a fit most, given those taken.

    The expected error is that of a fit of the model to the photographs, over the directions that can be taken: what noise makes
    of it, and a misfit, as large as the residual, that photographs near each other repeat. Shadow and parallax are not looked at;
    near lights count as those of the centre.

    Args:
        btf: the photographs that were taken.
        model: name of a model, or what else `fit` takes, fitted flat here; or a material that was fitted to them.
        count: how many photographs to propose, from 1.
        views: "fixed" keeps to the views that were taken, "free" proposes views too; None is fixed for one view, else free.
        criterion: "mean" for the least expected error over the hemisphere, "D" for the least volume that is left to the maps.
        polar_deg: the largest polar angle of proposed lights, in degrees below 90; None is that of the lights taken, at least 60
            and at most 80.
        candidates: lights and views [n, 3] that can be taken, in place of the hemisphere; the error is then expected over them.
        progress: whether to show a bar; None shows it on a terminal.
        options: the model's options, as in `fit`.

    Raises RangeError for a model whose maps have no errors (`uncertainty`), ShapeError for a material of another size.
    """
    where = "plan"
    check_option(where, "criterion", criterion, CRITERIA)
    views = views or (FIXED if len(btf.views) == 1 else FREE)
    check_option(where, "views", views, VIEWS)
    if count < 1:
        raise RangeError(message(where, "count", "be at least 1", f"it is {count}"))
    light, view = _possible(btf, views, polar_deg) if candidates is None else _given(candidates)
    if count > len(light):
        raise RangeError(message(where, "count", f"be at most {len(light)}, the directions that can be taken", f"it is {count}"))
    material = _fitted(btf, model, options, progress)
    with working("planning", progress), torch.no_grad():
        return _plan(btf, material, light, view, count, criterion)


def _fitted(btf: Btf, model: str | Path | FitConfig | Material, options: dict[str, Any], progress: bool | None) -> Material:
    if isinstance(model, Material):
        if model.size != (btf.height, btf.width):
            fact = f"it is {model.size[0]} x {model.size[1]} and the images {btf.height} x {btf.width}"
            raise ShapeError(message("plan", "material", "have the size of the images", fact, "Give the images that were fitted."))
        check_sure("plan", model)
        return model
    ways = {"geometry": "flat", "holdout": 0.0, "measure": "none", "uncertainty": False, "progress": progress}
    material = fit(btf, model, **{**ways, **options}).material
    check_sure("plan", material)
    return material


def _given(candidates: tuple[Tensor, Tensor]) -> tuple[Tensor, Tensor]:
    light, view = (torch.as_tensor(direction).double() for direction in candidates)
    if light.shape != view.shape or light.ndim != 2 or light.shape[1] != 3:
        fact = f"they are {tuple(light.shape)} and {tuple(view.shape)}"
        raise ShapeError(message("plan", "candidates", "be lights and views [n, 3]", fact))
    for name, direction in (("light", light), ("view", view)):
        check_unit("plan", name, direction, "Divide each by its length.")
    above = (light[:, 2] > 0) & (view[:, 2] > 0)
    return light[above], view[above]


def _possible(btf: Btf, views: str, polar_deg: float | None) -> tuple[Tensor, Tensor]:
    """Return the pairs of light and view [n, 3] that can be taken: a spiral of lights under the views taken, or two spirals."""
    if polar_deg is not None and not 0 < polar_deg < 90:
        raise RangeError(message("plan", "polar_deg", "lie in (0, 90)", f"it is {polar_deg}"))

    def lowest(taken: Tensor) -> float:
        found = math.degrees(math.acos(min(max(float(taken[taken[:, 2] > 0, 2].min()), 0.0), 1.0)))
        return math.cos(math.radians(polar_deg or min(max(found, _FLATTEST[0]), _FLATTEST[1])))

    if views == FIXED:
        some = btf.views.double()
        lights = frames.spiral(max(_LIGHTS // len(some), _FREE_LIGHTS), lowest(btf.lights.double()))
    else:
        some = frames.spiral(_FREE_VIEWS, lowest(btf.views.double()))
        lights = frames.spiral(_FREE_LIGHTS, lowest(btf.lights.double()))
    return lights.repeat(len(some), 1), some.repeat_interleave(len(lights), dim=0)


def _plan(btf: Btf, material: Material, light: Tensor, view: Tensor, count: int, criterion: str) -> Plan:
    every = torch.arange(len(btf))
    training = make_training(btf, every, 0, material.tiles, material.dtype, False)
    rows = training.used.nonzero()[:, 0]
    observed = _few_texels(observe(material.surface(), training))
    taken_light, taken_view = btf.light[rows].double(), btf.view[rows].double()
    design = design_of(observed, torch.cat((taken_light, light)), torch.cat((taken_view, view)))
    taken, possible = list(range(len(rows))), list(range(len(rows), len(rows) + len(light)))
    targets = [possible[number] for number in _evenly(len(light)).tolist()]
    chosen = choose(design, taken, possible, targets, count, criterion)
    errors = [design.errors([*taken, *chosen[:some]], targets) for some in range(count + 1)]
    picked = torch.tensor(chosen) - len(rows)
    around = torch.tensor(targets) - len(rows)
    return Plan(
        light[picked], view[picked], torch.stack([one.mean().sqrt() for one in errors]), taken_light, taken_view,
        light[around], view[around], errors[0].sqrt(), errors[-1].sqrt(), observed.space.name,
    )


def _evenly(count: int) -> Tensor:
    """Return the numbers of some pairs that are as dense as all are: by a fraction that no spiral's turn repeats."""
    return (torch.arange(count, dtype=torch.float64) * _PLASTIC % 1).argsort()[:_TARGETS].sort().values


def _few_texels(observed: Observed) -> Observed:
    """Return some texels of the object, evenly chosen, as one row."""
    inside = observed.btf.inside
    some = inside[torch.linspace(0, len(inside) - 1, min(_TEXELS**2, len(inside))).round().long()]
    images = torch.cat([observed.btf.images(part, observed.flat.dtype).flatten(2)[..., some] for part in torch.arange(len(observed.btf)).split(16)])
    weight = torch.cat([observed.btf.valid(part).flatten(2)[..., some] for part in torch.arange(len(observed.btf)).split(16)])
    btf = Btf.from_tensors(images[:, :, None], observed.btf.light, observed.btf.view, weight[:, :, None])
    tables = {spec.name for spec in observed.flat.specs() if not spec.per_texel or spec.constant}
    maps = {
        name: value.detach() if name in tables else value.detach().flatten(1)[:, None, some] for name, value in observed.flat.maps.items()
    }
    return Observed(observed.material, observed.flat.sharing(maps), btf, observed.space)


def design_of(observed: Observed, light: Tensor, view: Tensor) -> Design:
    """Return what photographs of pairs [n, 3] would tell of texels, with the noise that their residuals show."""
    jacobian, dtype = jacobian_of(observed), observed.flat.dtype
    noise, width = _noise(observed, len(jacobian.ways)), observed.btf.width
    shape = (len(light), 1, 1, 1)
    some = Some(light[:, :, None, None].to(dtype), view[:, :, None, None].to(dtype), torch.zeros(len(light), 3, 1, width, dtype=dtype), torch.ones(shape, dtype=dtype), None)
    slope = jacobian.of(observed, some).double()[:, :, :, 0].permute(3, 0, 1, 2)  # [texel, pair, colour, way]
    prior = torch.tensor([_prior(observed, way) for way in jacobian.ways], dtype=torch.float64)
    parts = []
    for numbers, colours in blocks_of(jacobian):
        part = slope[:, :, colours][..., numbers] * prior[numbers]
        alike = bool((part - part[:1]).abs().max() <= 1e-5 * part.abs().max())  # of what is linear all texels tell the same
        chosen = torch.linspace(0, len(part) - 1, 1 if alike else min(_TEXELS, len(part))).round().long()
        parts.append(part[chosen])
    parts = parts if all(part.shape == parts[0].shape for part in parts) else parts[:1]
    return Design(torch.cat(parts), noise, likeness(light, view, light, view))


def _prior(observed: Observed, way: Any) -> float:
    """Return how large a number of a texel is usually: what is known of it before any photograph."""
    value = observed.flat.maps[way.name]
    single = way.tangent.shape[-2:] == (1, 1) and int((way.tangent != 0).sum()) == 1
    usual = float((way.tangent * value).double().square().sum(dim=0).mean().sqrt()) if single else way.span
    return max(usual, _LEAST * way.span)


def _noise(observed: Observed, ways: int) -> float:
    """Return the mean squared residual; as many samples as a texel has numbers count as off by a twentieth of what is usual.

    A fit to no more photographs than numbers has no residual, and is not exact for it.
    """
    total = power = count = 0.0
    maps = dict(observed.flat.maps.items())
    for part in torch.arange(len(observed.btf)).split(64):
        some = observed.some(part)
        residual = observed.residual(maps, some).double()
        predicted = observed.space.residual(observed.predicted(maps, some.light, some.view), torch.zeros_like(some.target), some.weight)
        total, power = total + float(residual.square().sum()), power + float(predicted.double().square().sum())
        count += 3 * float(some.weight.double().sum())
    numbers = float(ways * observed.btf.width)
    usual = _UNSEEN**2 * power / max(count, 1)
    return max((total + numbers * usual) / (max(count - numbers, 0) + numbers), 1e-12)
