"""Far lamps from the shading of the sample's own relief, where paper that is lit evenly tells none: estimates, with their uncertainty."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.optimize import least_squares

from torchmat.capturing.light import Light

FEWEST = 8  # photographs: each has two unknowns of its own, all share six
_ROUNDS = 8
_TUKEY = 4.0
_CHROMA = 0.15  # of a colour's length that is not white: above it gloss, which is as white as the paper, is left out
_BLOCKS, _GROUPS = 4, 5  # of the sample along a side, and of photographs, that are left out one after the other
_SMOOTH = 1.0  # cells
_STEEPEST = 0.2  # of the median of a: texels whose slope would be far beyond that of others
_LEAST, _MOST = 0.02, 0.12  # relative: lamps are never more alike, and where they differ more they tell nothing of each other
_LOBE = 30.0  # exponent of the gloss that is looked for
_GLOSSY, _FITS = 0.1, 0.6  # rms over matte, from which on gloss must fit; and the share of its squares that lamps must explain
_SURE, _AGAINST, _CLEAR = 3.0, 2.0, 20.0  # standard errors by which relief must stand out, or sink in; of another sign against it; most that are told
_WIDEST = 10.0  # degrees
_MODEL = 2.0  # degrees, that all lamps together are off beside what leaving out shows: of relief finer than the cells, gloss, and albedo that goes with slope
_OTHER = 1.0  # of the squares of shading, that gloss and shadows may have
_LOW = 0.3  # of a lamp's sine: what is nearer to the normal is as well known


@dataclass(frozen=True, eq=False)
class Shown:
    """What photographs show of the sample, over white paper under the same light: `values` [j, 3, h, w], `good` [j, h, w], on a grid of
    square cells, row 0 at the top; `level` [j] of the paper at one exposure; `slope` [j, 2] of its logarithm per mm, x and y; `view` [j, 3]."""

    values: np.ndarray
    good: np.ndarray
    level: np.ndarray
    slope: np.ndarray
    view: np.ndarray


class NotTold(Exception):
    """Why shading tells no lamps: its text is a fact."""


class _Factors(NamedTuple):
    """Values [j, n] as ground [n] + slopes [n, 2] @ lamps [j, 2]: `lamps` and slopes but for a common 2 x 2 matrix and a shift."""

    lamps: np.ndarray
    ground: np.ndarray
    slopes: np.ndarray


class _Known(NamedTuple):
    """What of the common matrix and shift the sample itself tells: `turn` [2, 2] but for its scale, and the `shift` [2] of the lamps."""

    turn: np.ndarray
    shift: np.ndarray


def lamps_of_relief(shown: Shown, reach: float) -> list[Light]:
    """Return the far lamps [j] that explain how photographs show a sample's relief; `reach` in mm is half of the window.

    Paper shows rho_w l_z, a matte sample rho (n . l), so that their ratio is a + b . t: a and b = rho (n_x, n_y) belong to the texel,
    t = (l_x, l_y) / l_z to the lamp. A robust factorisation finds them but for t -> A t + c (Hayakawa 1994). Slopes b / a of a
    relief have no curl, which tells A but for its scale (Belhumeur, Kriegman and Yuille 1999), and as a rule albedo does not go with
    slope, which tells c. The scale, how deep the relief is, follows from lamps that are equally strong: paper under them shows k l_z.
    Whether it rises or sinks is told by gloss, as each view sees it, and by what little the paper is brighter towards a lamp. Standard
    errors are those of leaving out blocks of the sample, and a fifth of the photographs, one after the other.

    Raises NotTold where the sample is flat or ribbed, its relief may as well sink as rise, lamps differ, or directions stay open by
    more than 10 degrees.
    """
    values, good = _matte(shown.values, shown.good), shown.good
    height, width = good.shape[1:]
    factors = _factors(values.reshape(len(values), -1), good.reshape(len(good), -1))
    blocks = _blocks(height, width)
    whole = _of_sample(factors, (height, width), blocks >= 0)
    parts = [_of_sample(factors, (height, width), blocks != left, whole) for left in range(_BLOCKS**2)]
    spread = _jackknife(np.array([one.shift for one in parts]))
    scale, shift, off = _scaled(factors, whole, spread, shown.level)
    sign = _sign(shown, factors, whole, scale, shift)
    lamps = _directions(sign * scale, shift, factors, whole)
    by_block = [_directions(sign * found[0], found[1], factors, one) for one in parts for found in [_scaled(factors, one, spread, shown.level)]]
    groups = np.arange(len(values)) % _GROUPS
    by_group = np.stack([_without(values, good, shown.level, spread, lamps, groups != left) for left in range(_GROUPS)])
    sine = np.hypot(*lamps[:, :2].T)
    near = reach * np.hypot(*shown.slope.T) / (3 * np.maximum(sine, _LOW))  # the angle of the window's half as the lamp sees it
    away = (by_group - lamps) ** 2
    told = np.isfinite(away).all(2).sum(0)
    group = (_GROUPS - 1) * np.nansum(away, axis=(0, 2)) / np.maximum(told, 1) / 2
    block = np.trace(_jackknife(np.array(by_block)), axis1=1, axis2=2) / 2
    sigma = np.hypot(np.degrees(np.sqrt(group + block + near**2)), _MODEL)
    if not np.median(sigma) < _WIDEST:
        raise NotTold(
            f"directions stay open by {min(float(np.median(sigma)), 90):.0f} degrees (median), as photographs and parts of the sample differ: "
            "it is too flat, too glossy, or not resolved, or has relief along one side alone"
        )
    how = "the sample's relief, an estimate"
    return [Light(lamp, float(error), residual=float(abs(one)), how=how) for lamp, error, one in zip(lamps, sigma, off, strict=True)]


def _without(values: np.ndarray, good: np.ndarray, level: np.ndarray, spread: np.ndarray, lamps: np.ndarray, kept: np.ndarray) -> np.ndarray:
    """Return the directions [j, 3] that photographs which are `kept` [j] tell alone, NaN of the others; of the two signs that which is
    nearer to `lamps`."""
    factors = _factors(values[kept].reshape(kept.sum(), -1), good[kept].reshape(kept.sum(), -1))
    known = _of_sample(factors, good.shape[1:], np.ones(good[0].size, bool))
    scale, shift, _ = _scaled(factors, known, spread, level[kept])
    both = [_directions(sign * scale, shift, factors, known) for sign in (1, -1)]
    found = np.full(lamps.shape, np.nan)
    found[kept] = max(both, key=lambda one: float((one * lamps[kept]).sum()))
    return found


def _matte(values: np.ndarray, good: np.ndarray) -> np.ndarray:
    """Return the matte part [j, h, w] of values [j, 3, h, w]: of a coloured sample what is not white, of a grey one all."""
    mean = np.array([np.median(values[:, channel][good]) for channel in range(3)])
    mean = mean / np.linalg.norm(mean)
    colour = mean - mean.mean()
    share = np.linalg.norm(colour)
    return values.mean(1) if share < _CHROMA else np.einsum("c,jchw->jhw", colour / share**2, values)


def _of_texels(values: np.ndarray, weight: np.ndarray, lamps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return ground [n] and slopes [n, 2] that explain values [j, n] under lamps [j, 2] by weighted least squares."""
    design = np.column_stack((np.ones(len(lamps)), lamps))
    normal = np.einsum("jn,jk,jl->nkl", weight, design, design, optimize=True) + 1e-6 * np.eye(3)
    found = np.linalg.solve(normal, np.einsum("jn,jk->nk", weight * values, design, optimize=True)[..., None])[..., 0]
    return found[:, 0], found[:, 1:]


def _weights(values: np.ndarray, good: np.ndarray, lamps: np.ndarray, ground: np.ndarray, slopes: np.ndarray) -> tuple[np.ndarray, float]:
    """Return Tukey's weights [j, n] of values, in which shadow and gloss count nothing, and how they spread about the fit."""
    off = values - (ground + lamps @ slopes.T)
    spread = max(1.4826 * float(np.median(np.abs(off[good]))), 1e-6)
    return good * np.clip(1 - (off / (_TUKEY * spread)) ** 2, 0, 1) ** 2, spread


def _factors(values: np.ndarray, good: np.ndarray) -> _Factors:
    """Return the factors of values [j, n] where they are `good`; raises NotTold where gloss and shadows drown them."""
    held = np.where(good, values, np.nan)
    some = good.any(0)
    middle = np.zeros(values.shape[1])
    middle[some] = np.nanmedian(held[:, some], axis=0)
    filled = np.where(good, values, middle)
    lamps = np.linalg.svd(filled - filled.mean(0), full_matrices=False)[0][:, :2] * np.sqrt(len(values))
    weight = good.astype(float)
    for _ in range(_ROUNDS):
        ground, slopes = _of_texels(values, weight, lamps)
        normal = np.einsum("jn,nk,nl->jkl", weight, slopes, slopes, optimize=True)
        normal += 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(2)
        lamps = np.linalg.solve(normal, np.einsum("jn,nk->jk", weight * (values - ground), slopes, optimize=True)[..., None])[..., 0]
        lamps = np.linalg.svd(lamps - lamps.mean(0), full_matrices=False)[0] * np.sqrt(len(values))
        ground, slopes = _of_texels(values, weight, lamps)
        weight, spread = _weights(values, good, lamps, ground, slopes)
    away = np.where(good, values - ground - lamps @ slopes.T, 0)
    other, told = float((away[np.abs(away) > _TUKEY * spread] ** 2).sum()), float((np.where(good, lamps @ slopes.T, 0) ** 2).sum())
    if not other < _OTHER * told:
        raise NotTold(f"gloss and shadows are {other / max(told, 1e-12):.1f} times as strong as the matte relief's shading")
    return _Factors(lamps, ground, slopes)


def _blocks(height: int, width: int) -> np.ndarray:
    """Return the number [h w] of the block that each cell is in."""
    row, column = (np.arange(side) * _BLOCKS // side for side in (height, width))
    return (row[:, None] * _BLOCKS + column).ravel()


def _of_sample(factors: _Factors, shape: tuple[int, int], kept: np.ndarray, like: _Known | None = None) -> _Known:
    """Return what cells that are `kept` [n] tell: the shift with which ground goes with no slope, and the turn without curl, whose
    sign is open: as that of `like`."""
    slopes, ground = factors.slopes[kept], factors.ground[kept]
    away = slopes - slopes.mean(0)
    shift = np.linalg.lstsq(away, ground - ground.mean(), rcond=None)[0]
    level = factors.ground - factors.slopes @ shift
    field = (factors.slopes / np.maximum(level, _STEEPEST * np.median(level))[:, None]).T.reshape(2, *shape)
    field = gaussian_filter(field, (0, _SMOOTH, _SMOOTH))
    up, across = -np.gradient(field, axis=1), np.gradient(field, axis=2)
    # Of m1 . field along x and m2 . field along y: d/dy of the first less d/dx of the second is 0.
    rows = np.stack((*up, *-across), axis=-1)[1:-1, 1:-1].reshape(-1, 4)[kept.reshape(shape)[1:-1, 1:-1].ravel()]
    length = np.linalg.norm(rows, axis=1)
    rows = rows / np.maximum(length, np.median(length))[:, None]
    matrix = np.linalg.eigh(rows.T @ rows)[1][:, 0].reshape(2, 2)
    turn = np.linalg.inv(matrix + 1e-9 * np.eye(2)).T
    turn *= 1 if like is None or (turn * like.turn).sum() > 0 else -1
    return _Known(turn / np.linalg.norm(turn), shift)


def _scaled(factors: _Factors, known: _Known, spread: np.ndarray, level: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Return scale and shift [2] with which lamps are equally strong, as the paper's `level` [j] shows, and by how much each differs
    [j, logarithm]; `spread` [2, 2] is the covariance of the shift as the sample tells it.

    Raises NotTold where they differ too much.
    """
    moved, logarithm = (factors.lamps + known.shift) @ known.turn.T, np.log(level)
    whiten = np.linalg.inv(np.linalg.cholesky(spread + 1e-12 * np.eye(2)))

    def off(unknown: np.ndarray) -> np.ndarray:
        tangents = np.exp(unknown[0]) * (moved + known.turn @ unknown[1:3])
        return logarithm + 0.5 * np.log1p((tangents**2).sum(1)) - unknown[3]

    spread_of_lamps = 0.05
    found = np.array([0.0, 0, 0, np.median(logarithm)])
    for _ in range(3):
        def residual(unknown: np.ndarray, sigma: float = spread_of_lamps) -> np.ndarray:
            return np.concatenate((off(unknown) / sigma, whiten @ unknown[1:3]))

        starts = [found + [step, 0, 0, 0] for step in (-1.5, 0, 1.5)]
        found = min((least_squares(residual, start, loss="soft_l1") for start in starts), key=lambda one: one.cost).x
        spread_of_lamps = max(float(np.sqrt((off(found) ** 2).sum() / max(len(level) - 4, 1))), _LEAST)
    if spread_of_lamps > _MOST:
        raise NotTold(f"the lamps differ by {100 * spread_of_lamps:.0f} %, or their exposures do, so that none tells how steep another's light is")
    return float(np.exp(found[0])), known.shift + found[1:3], off(found)


def _directions(scale: float, shift: np.ndarray, factors: _Factors, known: _Known) -> np.ndarray:
    """Return unit directions [j, 3]."""
    tangents = scale * (factors.lamps + shift) @ known.turn.T
    found = np.column_stack((tangents, np.ones(len(tangents))))
    return found / np.linalg.norm(found, axis=1, keepdims=True)


def _jackknife(values: np.ndarray) -> np.ndarray:
    """Return the covariance [..., d, d] of what was found without each of n parts [n, ..., d]."""
    away = values - values.mean(0)
    return (len(values) - 1) / len(values) * np.einsum("n...i,n...j->...ij", away, away)


def _sign(shown: Shown, factors: _Factors, known: _Known, scale: float, shift: np.ndarray) -> int:
    """Return 1, or -1 where relief that is turned inside out, with all lamps on the other side, explains gloss and paper better.

    Raises NotTold where neither does by three standard errors, or one speaks against the other by two; and where gloss, which
    shading did not know of, is there and does not fit the lamps.
    """
    lamps = _directions(scale, shift, factors, known)
    paper = (shown.slope * lamps[:, :2]).sum(1) / np.maximum(np.hypot(*lamps[:, :2].T), 1e-6)
    gloss, shine = _gloss(shown, factors, known, scale, shift)
    total, rising, sinking = gloss
    explained = (sinking.sum() - sinking - rising.sum() + rising) / np.maximum(total.sum() - total, 1e-12)
    told = [_clear(np.array([np.delete(paper, left).mean() for left in range(len(paper))])), _clear(explained)]
    stronger, weaker = sorted(told, key=abs, reverse=True)
    if not (abs(stronger) > _SURE and weaker * np.sign(stronger) > -_AGAINST):
        raise NotTold(f"gloss and paper do not tell whether the relief rises or sinks ({told[1]:+.1f} and {told[0]:+.1f} standard errors)")
    sign = 1 if stronger > 0 else -1
    share = 1 - float((rising if sign > 0 else sinking).sum()) / max(float(total.sum()), 1e-12)
    if shine > _GLOSSY and share < _FITS:
        raise NotTold(f"the lamps that matte shading tells explain {100 * share:.0f} % of the gloss: relief or colour is not resolved well enough (JPEG keeps colour coarse)")
    return sign


def _clear(without: np.ndarray) -> float:
    """Return how many standard errors a figure is from 0, of what it is without each photograph [j]."""
    error = float(np.sqrt(_jackknife(without[:, None])[0, 0]))
    return float(np.clip(without.mean() / max(error, 1e-12), -_CLEAR, _CLEAR))


def _gloss(shown: Shown, factors: _Factors, known: _Known, scale: float, shift: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the squares of each photograph's gloss, and what of them relief that rises and one that sinks leave [3, j]; and how strong
    gloss is, rms over matte."""
    count = len(shown.values)
    matte = factors.ground + factors.lamps @ factors.slopes.T
    lit = shown.good.reshape(count, -1) & (matte > _STEEPEST * np.median(matte))
    values = shown.values.mean(1).reshape(count, -1)
    share = np.where(lit, values / np.where(lit, matte, 1), np.nan)
    some = lit.any(0)
    share = np.where(some, np.nanmedian(np.where(some, share, 0), axis=0), 0)
    gloss = np.where(lit, values - share * matte, 0)
    level = factors.ground - factors.slopes @ shift
    slope = factors.slopes @ np.linalg.inv(known.turn) / (scale * np.maximum(level, _STEEPEST * np.median(level))[:, None])
    left = [_unexplained(gloss, lit, sign * slope, _directions(sign * scale, shift, factors, known), shown.view) for sign in (1, -1)]
    total = (gloss**2).sum(1)
    return np.stack((total, *left)), float(np.sqrt(total.sum() / max(float((np.where(lit, share * matte, 0) ** 2).sum()), 1e-12)))


def _unexplained(gloss: np.ndarray, lit: np.ndarray, slope: np.ndarray, lamps: np.ndarray, views: np.ndarray) -> np.ndarray:
    """Return what of the squares of each photograph's gloss [j, n] a lobe about relief of a slope [n, 2] leaves [j]."""
    normal = np.column_stack((slope, np.ones(len(slope))))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    half = lamps + views
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    lobe = np.where(lit, np.maximum(half @ normal.T, 0) ** _LOBE / lamps[:, 2:], 0)
    strength = max(float((gloss * lobe).sum() / max(float((lobe**2).sum()), 1e-12)), 0.0)
    return ((gloss - strength * lobe) ** 2).sum(1)
