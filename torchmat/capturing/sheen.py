"""Gloss of the board's paper: matte paper that is not quite matte is brighter about the mirror direction of each lamp."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from torchmat.capturing.light import Light
from torchmat.capturing.view import Pose

_EXPONENTS = (10.0, 20.0, 40.0, 80.0, 160.0, 320.0)
_LOWEST = 0.05  # cosine of the light
_POINTS = 150  # of each photograph
_STEPS, _ROUNDS, _TUKEY = 4, 6, 4.0
_SURE, _LEAST = 6.0, 0.01  # standard errors, and the share of the paper's light in the mirror direction, from which on there is gloss
_ALIKE = 9.0  # neighbouring points share their errors: about one in so many counts
_MOST = 20.0  # times the matte light


@dataclass(frozen=True)
class Sheen:
    """Gloss beside the light of matte paper: `strength` of a lobe (n . h)^`exponent` / (n . l), known to `sigma`."""

    strength: float
    exponent: float
    sigma: float

    def at(self, mirror: np.ndarray) -> np.ndarray:
        """Return by what paper is brighter than matte paper [...], at least 1, where `mirrored` is [..., 2]."""
        return 1 + self.strength * _lobe(mirror, self.exponent)


def mirrored(pose: Pose, light: Light, points: np.ndarray) -> np.ndarray:
    """Return the cosines [..., 2] that gloss depends on at points [..., 3] in mm: of the half vector and of the light."""
    towards = light.directions(points)
    half = towards + pose.views(points)
    return np.stack((half[..., 2] / np.linalg.norm(half, axis=-1), towards[..., 2]), axis=-1)


def _lobe(mirror: np.ndarray, exponent: float) -> np.ndarray:
    return np.maximum(mirror[..., 0], 0) ** exponent / np.maximum(mirror[..., 1], _LOWEST)


def find_sheen(design: np.ndarray, target: np.ndarray, where: np.ndarray, mirror: np.ndarray) -> Sheen | None:
    """Return the gloss that all photographs share, None where there is none to speak of.

    log I = design @ w + log(1 + s lobe), by robust least squares from s = 0 on; the exponent with the least residual is looked for.

    Args:
        design: [n, k], what the logarithm of matte paper is a sum of.
        target: [n], the logarithm of what paper shows over what its lamp explains.
        where: [n], the number of the photograph; some points of each are enough.
        mirror: [n, 2], the cosines there (`mirrored`).
    """
    rows = [np.flatnonzero(where == number) for number in np.unique(where)]
    some = np.concatenate([one[np.linspace(0, len(one) - 1, min(_POINTS, len(one))).astype(int)] for one in rows])
    if len(some) < 2 * design.shape[1]:
        return None
    design, target, mirror = design[some], target[some], mirror[some]
    plain = _strength(design, target, None)[2]
    costs = [_strength(design, target, _lobe(mirror, exponent))[2] for exponent in _EXPONENTS]
    best = int(np.argmin(costs))
    if not costs[best] < plain:
        return None
    low, high = np.log(_EXPONENTS[max(best - 1, 0)]), np.log(_EXPONENTS[min(best + 1, len(costs) - 1)])
    search = minimize_scalar(lambda one: _strength(design, target, _lobe(mirror, np.exp(one)))[2], bounds=(low, high), method="bounded", options={"xatol": 0.03})
    exponent = float(np.exp(search.x))
    lobe = _lobe(mirror, exponent)
    strength, sigma, _ = _strength(design, target, lobe)
    told = strength > _SURE * sigma and strength * float(np.quantile(lobe, 0.99)) > _LEAST
    return Sheen(strength, exponent, sigma) if told else None


def _strength(design: np.ndarray, target: np.ndarray, lobe: np.ndarray | None) -> tuple[float, float, float]:
    """Return strength, its standard error and the robust residual of a lobe [n]; None is no lobe."""
    strength, sigma = 0.0, np.inf
    trust, spread = np.ones(len(target)), 0.05
    for _ in range(_STEPS):
        column = np.zeros((len(target), 0)) if lobe is None else (lobe / (1 + strength * lobe))[:, None]
        left = target if lobe is None else target - np.log1p(strength * lobe)
        whole = np.column_stack((design, column))
        for _ in range(_ROUNDS):
            normal = whole.T @ (trust[:, None] * whole)
            normal += 1e-9 * np.trace(normal) / len(normal) * np.eye(len(normal))
            weights = np.linalg.solve(normal, whole.T @ (trust * left))
            off = left - whole @ weights
            spread = max(1.4826 * float(np.median(np.abs(off))), 1e-4)
            trust = np.clip(1 - (off / (_TUKEY * spread)) ** 2, 0, 1) ** 2
        if lobe is None:
            break
        strength = float(np.clip(strength + weights[-1], 0, _MOST))
        sigma = float(spread * np.sqrt(_ALIKE * np.linalg.inv(normal)[-1, -1]))
    return strength, sigma, spread
