"""Hard cases of fits: every model by every solver on data that gives it trouble. Finite, flagged, and no worse than it must be.

What a fit leaves unexplained of its own samples is bounded for each model: a tenth above the worst of its solvers.
"""

from __future__ import annotations

import functools
import math
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tests.models.examples import PLAIN
from tests.brdf.directions import HARD_PAIRS, graze
from tests.hard_cases.cases_shading import FULL, digits_right
from tests.hard_cases.components import Room, stepping
from tests.hard_cases.hard_directions import half_pairs
from tests.support import all_pairs, assert_close, hemisphere, plausible_images

import torchmat as tm
from torchmat import Btf
from torchmat.btf.btf import CLIPPED, summarise
from torchmat.btf.decode import Decoder
from torchmat.fitting import predict
from torchmat.fitting.recipe import RECIPES
from torchmat.solvers import DESCENTS, LBFGS
from torchmat.solvers import stop_reasons as reasons

LIGHTS = hemisphere()
LIGHT, VIEW = all_pairs(LIGHTS, hemisphere(((0, 1), (30, 2), (60, 3))))
# Closed forms over texels by themselves: the number of unknowns of each. In phong_srf the texels share the lobe.
UNKNOWNS = {"texture": 1, "lambert": 3, "ptm": 6, "lptm": 6, "hsh": 9, "phong_srf": 3}
# The reasons that solvers give, by the constants that name them.
NAMED = {value for name, value in vars(reasons).items() if name.isupper()}
Road = tuple[str, str]
# Share of the squares that is left by ordinary samples with a few hard ones among them, and by samples at the horizon
# alone, where harmonics by steps and a network of so few diverge. A step 12 deep leaves all models about as much.
LEFT = {
    "texture": 0.083, "lambert": 0.04, "lptm": 0.06, "ptm": 0.06, "hsh": 0.073, "phong_srf": 0.044, "pca": 0.0025,
    "local_pca": 0.036, "sphere_images": 0.077, "shading_map": 0.066, "distribution": 0.112, "neural": 3.1,
}
LEFT_GRAZING = {
    "texture": 0.94, "lambert": 0.075, "lptm": 0.01, "ptm": 0.01, "hsh": 3.1, "phong_srf": 0.165, "pca": 0.0025,
    "local_pca": 0.06, "sphere_images": 0.61, "shading_map": 0.88, "distribution": 0.98, "neural": 1.3,
}
LEFT_OVER_A_STEP = 0.275
BLACK = 1.001  # what black leaves: no model that is registered tomorrow may do worse


def is_default(given: Road) -> bool:
    """Return whether the solver is the model's first."""
    return given[1] == RECIPES[given[0]].all_solvers[0]


def closed(given: Road) -> bool:
    """Return whether each texel's answer is exact: the first solver of a model of UNKNOWNS."""
    return given[0] in UNKNOWNS and is_default(given)


def small_options(model: str, samples: int, texels: int, thorough: bool = False) -> dict[str, Any]:
    """Return options that a model can be fitted with to so little data, in little time."""
    if model == "pca":
        return {"components": min(4, samples, 3 * texels)}
    if model == "rbf":
        return {"components": min(6, 3 * samples, texels)}
    if model == "local_pca":
        return {"clusters": min(2, texels), "components": min(2, texels, 3 * samples)}
    if model == "distribution":  # few steps: that nothing breaks shows at once
        effort = 0.1 if thorough else 0.01
        return {"geometry": "flat", "lobes": 1, "fresnel": True, "rotation": True, "specular_size": 8, "effort": effort}
    if model == "neural":
        return {"geometry": "flat", "latent": 2, "hidden": 4, "effort": 0.02 if thorough else 0.002}
    if model == "microfacet":
        return {"geometry": "flat", "effort": 0.1 if thorough else 0.01, **PLAIN}
    return {}


def fitted(btf: Btf, given: Road, room: Room, **options: Any) -> tm.FitResult:
    """Fit; assert that maps, predictions and their gradients are finite and the reason has a name; return the result."""
    model, solver = given
    small = small_options(model, len(btf), btf.height * btf.width, room.thorough)
    asked = {"holdout": 0, "measure": False, "progress": False, "storage": "float", **small, **options}
    result = tm.fit(btf, model, **{"solver": stepping(model, solver, room), **asked})
    material = result.material
    for name, value in material.maps.items():
        assert bool(torch.isfinite(value).all()), f"the map {name} is not finite"
    assert result.stop_reason in NAMED, f"stopped by {result.stop_reason!r}"
    light, view = (rows[:4, :, None, None].to(material.dtype) for rows in (btf.light, btf.view))
    shaded = material.shade(light, view)
    assert bool(torch.isfinite(shaded).all()), "what was fitted does not shade to finite values"
    shaded.sum().backward()
    assert all(value.grad is None or bool(torch.isfinite(value.grad).all()) for value in material.parameters())
    return result


def btf_of(images, light=LIGHT, view=VIEW, weight=None) -> Btf:
    """Return images [n, 3, H, W] as a Btf of float32."""
    return Btf.from_tensors(np.asarray(images, np.float32), light, view, weight)


@functools.lru_cache(maxsize=None)
def plain(given: Road, thorough: bool) -> tuple[dict[str, torch.Tensor], torch.Tensor]:
    """Return the maps of a fit to ordinary samples, which several cases compare theirs with, and what they predict."""
    btf = btf_of(plausible_images(LIGHT, VIEW))
    result = fitted(btf, given, Room(Path(), thorough))
    return {name: value.detach() for name, value in result.material.maps.items()}, predicted(result, btf)


def predicted(result: tm.FitResult, btf: Btf) -> torch.Tensor:
    """Return what was fitted under all directions of `btf` [n, 3, H, W]."""
    with torch.no_grad():
        return predict(result.material, btf, torch.arange(len(btf)))


def left_over(material: tm.Material, btf: Btf) -> float:
    """Return the squared error of a material on the valid samples of `btf`, as a share of their squares."""
    rows = torch.arange(len(btf))
    with torch.no_grad():
        found = predict(material, btf, rows)
    target, valid = btf.images(rows, found.dtype), btf.valid(rows)
    return float(((found - target).square() * valid).double().sum() / (target.square() * valid).double().sum())


def explained(btf: Btf, given: Road, room: Room, most: float, **options: Any) -> tm.FitResult:
    """Fit; assert besides what `fitted` does that no more than `most` of the samples is left unexplained."""
    result = fitted(btf, given, room, **options)
    left = left_over(result.material, btf)
    assert left < most, f"{left:.3g} of the samples is not explained, more than {most:g}"
    return result


def _among_ordinary(pairs: list) -> Btf:
    """Return a Btf with samples at these directions beside ordinary ones."""
    light = np.concatenate((LIGHT, [one for one, _ in pairs]))
    view = np.concatenate((VIEW, [other for _, other in pairs]))
    return btf_of(plausible_images(light, view), light, view)


def hard_pairs(given: Road, room: Room) -> None:
    """Case 1: samples at equal, mirrored and opposite directions and at the horizon among the others are explained."""
    pairs = [pair for pair in HARD_PAIRS.values() if min(pair[0][2], pair[1][2]) > 1e-12]
    explained(_among_ordinary(pairs), given, room, LEFT.get(given[0], BLACK))


def all_grazing(given: Road, room: Room) -> None:
    """Case 2: nothing but samples whose light and view sink together, explained as far as each model can."""
    pairs = [(graze(a, 10.0**-k), graze(a + 0.5, 10.0**-k)) for k in range(1, 8) for a in (0.0, 1.3, 3.0, 4.5)]
    light, view = (np.array(rows) for rows in zip(*pairs, strict=True))
    explained(btf_of(plausible_images(light, view), light, view), given, room, LEFT_GRAZING.get(given[0], BLACK))


def half_vector_places(given: Road, room: Room) -> None:
    """Case 4: samples whose half vectors lie at the centre, at edges and at the rim of parabolic maps are explained."""
    explained(_among_ordinary(half_pairs()), given, room, LEFT.get(given[0], BLACK))


def one_turn_more(given: Road, room: Room) -> float:
    """Case 5: azimuths a full turn further on are the same data; returns the digits that the predictions share."""
    images, turned = plausible_images(LIGHT, VIEW), []
    for rows in (LIGHT, VIEW):
        azimuth = np.arctan2(rows[:, 1], rows[:, 0]) + 2 * np.pi
        flat = np.hypot(rows[:, 0], rows[:, 1])
        turned.append(np.stack((flat * np.cos(azimuth), flat * np.sin(azimuth), rows[:, 2]), axis=1))
    found = predicted(fitted(btf_of(images, *turned), given, room), btf_of(images))
    figure = digits_right(found, plain(given, room.thorough)[1])
    # Clusters and steps of float32 multiply a rounding error; the worst that was measured has 3 digits left.
    assert figure > (4 if closed(given) else 2)
    return figure


def ulp_from_unit(given: Road, room: Room) -> None:
    """Case 6: directions one ulp too long or too short among the samples, which are explained."""
    eps = np.finfo(np.float32).eps
    longer = [(tuple(s * x for x in light), tuple(s * x for x in view)) for s in (1 + eps, 1 - eps)
              for light, view in (HARD_PAIRS["light_and_view_are_the_normal"], HARD_PAIRS["light_is_view"], HARD_PAIRS["mirror_pair"])]
    explained(_among_ordinary(longer), given, room, LEFT.get(given[0], BLACK))


def black_and_white(given: Road, room: Room) -> None:
    """Case 7: data that drives maps to their ends: black everywhere, and white under every direction."""
    for level in (0.0, 1.0):
        images = np.full((len(LIGHT), 3, 2, 2), level)
        try:
            result = fitted(btf_of(images), given, room)
        except tm.FitError as error:
            assert level == 0 and "black" in str(error)  # there is nothing to scale by, and it says so
            continue
        if level == 0 and closed(given):
            assert float(predicted(result, btf_of(images)).abs().max()) < 1e-5


def dark_beside_highlight(given: Road, room: Room) -> float:
    """Case 8: one texel of 1e4 among dark ones of 1e-8; returns the digits that the dark keep of what they are alone.

    Closed forms must keep theirs. Solvers that step minimise one sum over all texels, and models with tables that all
    texels share divide those among them: in both the dark ones are nothing beside 1e24. Their figures are told, below 0
    where they are lost.
    """
    images = plausible_images(LIGHT, VIEW, 10, 10) * 1e-8
    bright = images.copy()
    bright[30:34, :, 3, 4] = 1e4
    on = torch.ones(10, 10, dtype=torch.bool)
    on[3, 4] = False
    options = {"components": 12} if given[0] == "pca" else {}
    plain, hdr = (predicted(fitted(btf_of(data), given, room, **options), btf_of(data))[..., on] for data in (images, bright))
    error = float((hdr - plain).double().square().sum() / plain.double().square().sum()) ** 0.5
    if closed(given) or given == ("phong_srf", "varpro"):
        # One texel of 100 leaves the mean of the lobe of phong_srf.
        assert error < (0.01 if given[0] == "phong_srf" else 1e-3)
    return min(FULL, -math.log10(max(error, 1e-12)))


def too_little_data(given: Road, room: Room) -> None:
    """Case 9: texels that are black, without samples, lit once, clipped; directions that do not determine the model."""
    _bad_texels(given, room)
    _clipped(given, room)
    few = ("one light", "one sample")
    every = ("one light", "one view", "coplanar lights", "two identical", "one sample", "two samples")
    for which in every if room.thorough or is_default(given) else few:
        _few_directions(given, room, which)


def _bad_texels(given: Road, room: Room) -> None:
    """Fit one Btf with a black texel, one without a sample, and one lit in one sample only."""
    images, weight = plausible_images(LIGHT, VIEW), np.ones((len(LIGHT), 5, 4))
    images[:, :, 2, 1] = 0
    weight[:, 1, 1] = weight[:, 3, 3] = 0
    weight[7, 3, 3] = 1
    btf, model = btf_of(images, weight=weight), given[0]
    result = fitted(btf, given, room)
    if not closed(given):
        return
    found, unknowns = predicted(result, btf), UNKNOWNS[model]
    if model != "phong_srf":
        assert float(found[:, :, 2, 1].abs().max()) < 1e-6, "the black texel is not black"
    coverage = result.coverage[0]
    assert float(coverage[1, 1]) == 0, "a texel without samples is not flagged"
    assert_close(coverage[3, 3], torch.tensor(1 / unknowns))
    assert_close(coverage.sum() - coverage[3, 3], torch.tensor(18.0))
    if model in ("texture", "ptm", "hsh"):
        assert_close(found[7, :, 3, 3], torch.from_numpy(images[7, :, 3, 3]).float(), 1e-4)


def _clipped(given: Road, room: Room) -> None:
    images = plausible_images(LIGHT, VIEW).astype(np.float32)
    flags = np.zeros((len(LIGHT), 5, 4), np.uint8)
    flags[10:, 1, 1] = CLIPPED
    images[10:, :, 1, 1] = 1
    light, view = torch.from_numpy(LIGHT).float(), torch.from_numpy(VIEW).float()
    btf = Btf(summarise(images, flags), light, view, Decoder(images.dtype, "linear", 1.0))
    result = fitted(btf, given, room)
    if given[0] == "texture" and closed(given):
        weight = np.where(np.arange(len(LIGHT)) < 10, 1, 0.05)
        expected = (weight * LIGHT[:, 2]) @ images[:, :, 1, 1] / (weight @ LIGHT[:, 2] ** 2)
        assert_close(result.material.maps["albedo"][:, 1, 1].detach(), torch.from_numpy(expected), 1e-5)


def _few_directions(given: Road, room: Room, which: str) -> None:
    line = np.stack((np.sin(np.linspace(-1, 1, 9)), np.zeros(9), np.cos(np.linspace(-1, 1, 9))), axis=1)
    light, view = {
        "one light": all_pairs(LIGHTS[4:5], LIGHTS), "one view": all_pairs(LIGHTS, LIGHTS[4:5]),
        "coplanar lights": all_pairs(line, LIGHTS[:1]), "two identical": (LIGHT[[0, 5, 5, 9]], VIEW[[0, 5, 5, 9]]),
        "one sample": (LIGHT[7:8], VIEW[7:8]), "two samples": (LIGHT[7:9], VIEW[7:9]),
    }[which]
    result = fitted(btf_of(plausible_images(light, view), light, view), given, room)
    model, lights = given[0], len(np.unique(light.round(6), axis=0))
    if not closed(given) or model in ("texture", "phong_srf"):
        return
    if lights < UNKNOWNS[model]:
        assert_close(result.coverage, torch.full((1, 5, 4), lights / UNKNOWNS[model]))
    if model == "lambert" and which == "coplanar lights":
        assert_close(result.coverage, torch.full((1, 5, 4), 2 / 3))


def sizes(given: Road, room: Room) -> None:
    """Case 10: maps of all shapes, one sample (reproduced by what can), and with time 25,000 for default solvers."""
    for size in ((1, 1), (1, 7), (3, 5), (1, 4096)) if room.thorough or is_default(given) else ((1, 1), (3, 5)):
        light, view = (LIGHT[::6], VIEW[::6]) if size[1] == 4096 else (LIGHT, VIEW)
        assert fitted(btf_of(plausible_images(light, view, *size), light, view), given, room).material.size == size
    images = plausible_images(LIGHT[7:8], VIEW[7:8])
    one = btf_of(images, LIGHT[7:8], VIEW[7:8])
    result = fitted(one, given, room, **({"ridge": 0.0} if given[0] == "phong_srf" else {}))
    if closed(given) or given[0] == "pca":
        assert_close(predicted(result, one), torch.from_numpy(images).float(), 1e-4)
    if room.thorough and is_default(given):
        random = np.random.default_rng(0)
        light, view = (random.normal(size=(25_000, 3)) for _ in range(2))
        for rows in (light, view):
            rows[:, 2] = np.abs(rows[:, 2]) + 0.2
            rows /= np.linalg.norm(rows, axis=1, keepdims=True)
        fitted(btf_of(plausible_images(light, view, 2, 2), light, view), given, room)


def masked_values(given: Road, room: Room) -> None:
    """Case 11: what a masked sample holds instead of a value never counts: the same bits whatever it is."""
    images, weight = plausible_images(LIGHT, VIEW), np.ones((len(LIGHT), 5, 4))
    weight[3, 2, 1] = weight[20:25, 4, :] = 0
    found = []
    for filler in (0.0, 1e6):
        spoilt = np.where(weight[:, None] == 0, filler, images)
        found.append(fitted(btf_of(spoilt, weight=weight), given, room).material.maps)
    for name, value in found[0].items():
        assert torch.equal(value, found[1][name]), f"the map {name} depends on masked values"


def over_a_step(given: Road, room: Room) -> None:
    """Case 12: a relief with a step, seen at 75 degrees, where rays leave the tile; what is not hidden is explained."""
    light, view = all_pairs(hemisphere(((20, 3), (60, 4))), hemisphere(((0, 1), (75, 3))))
    height = torch.zeros(1, 12, 12)
    height[..., 4:7] = 0.3
    explained(btf_of(plausible_images(light, view, 12, 12), light, view), given, room, LEFT_OVER_A_STEP, geometry=height)


def precision(given: Road, room: Room) -> float:
    """Case 13: brightness 1e-6 and 1e4 stays finite; returns the digits that float32 keeps of float64, by what is predicted."""
    images = plausible_images(LIGHT, VIEW)
    for scale in (1e-6, 1e4):
        fitted(btf_of(images * scale), given, room)
    btf = btf_of(images)
    figure = digits_right(plain(given, room.thorough)[1], predicted(fitted(btf, given, room, dtype=torch.float64), btf))
    assert figure > (4 if closed(given) else 1)
    return figure


class _Poisoned:
    """The linear residual, whose third gradient, and every later one, belongs to a value that is not a number."""

    def __init__(self) -> None:
        self.calls = 0

    def __call__(self, predicted, target, weight):
        self.calls += predicted.requires_grad
        return weight.sqrt() * (predicted - target) * (1.0 if self.calls < 3 else math.nan)


def named_reasons(given: Road, room: Room) -> None:
    """Case 14: a budget of no time, steps a thousand times too large, and an objective that turns to NaN end by name.

    What comes back is the start or better; of steps that are too large what is no worse than black.
    """
    model, solver = given
    btf = btf_of(plausible_images(LIGHT, VIEW))
    start = fitted(btf, given, room, seconds=1e-6)
    iterates = solver in DESCENTS and (model in ("distribution", "neural", "microfacet") or not is_default(given))
    assert start.stop_reason == (reasons.BUDGET if iterates else reasons.CONVERGED)
    left = left_over(start.material, btf)
    assert left < {"distribution": 0.22, "neural": 13.0}.get(model, LEFT.get(model, BLACK))
    if solver not in DESCENTS or model == "distribution" or is_default(given):
        return  # no steps whose length could be chosen
    far = {} if solver == LBFGS.name else {"rate": 30.0}  # a thousand times the usual
    explained(btf, given, room, BLACK, solver=stepping(model, solver, room, **far))
    explained(btf, given, room, 1.001 * left, objective=_Poisoned())


def same_bits(given: Road, room: Room) -> None:
    """Case 15: one seed, the same bits; with time, with one thread and with two (else in tests/fitting/test_determinism.py)."""
    if not room.thorough:
        again = fitted(btf_of(plausible_images(LIGHT, VIEW)), given, room).material.maps
        for name, value in plain(given, False)[0].items():
            assert torch.equal(value, again[name]), f"the map {name} has other bits the second time"
        return
    btf, found, before = btf_of(plausible_images(LIGHT, VIEW, 9, 8)), [], torch.get_num_threads()
    try:
        for threads in (1, 2):
            torch.set_num_threads(threads)
            found.append(fitted(btf, given, room, seed=4).material.maps)
    finally:
        torch.set_num_threads(before)
    for name, value in found[0].items():
        assert torch.equal(value, found[1][name]), f"the map {name} has other bits with two threads"


def stated_after_export(given: Road, room: Room) -> float:
    """Case 17: the report states the error after export; returns how much 8 bits change the held-out error, as a share."""
    btf = btf_of(plausible_images(LIGHT, VIEW))
    report = fitted(btf, given, room, holdout=0.2, measure=True, storage="png8").report
    before, after = (report[key]["mse"] for key in ("held_out", "held_out_after_export"))
    assert math.isfinite(before) and math.isfinite(after) and before > 0
    return abs(after / before - 1)
