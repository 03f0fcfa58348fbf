"""How patterns lie to each other: known shifts are found, light changes nothing, and what has nothing in common is not moved."""

from __future__ import annotations

import numpy as np
import pytest

from torchmat.capturing.rectify import Grid
from torchmat.capturing.register import _without_relief
from torchmat.capturing.align import IDENTITY, align, correlation, features, moved_by, remaining, warped

pytest.importorskip("cv2")
SIZE = 120
VALID = np.ones((SIZE, SIZE), bool)


def picture(column, row, seed=0):
    """Return a pattern [3, h, w] of waves at places: it can be looked at anywhere, between texels too."""
    random = np.random.default_rng(seed)
    total = np.zeros_like(column)
    for _ in range(40):
        angle, length = random.uniform(0, np.pi), random.uniform(6, 14)
        total += np.sin(2 * np.pi * (np.cos(angle) * column + np.sin(angle) * row) / length + random.uniform(0, 6))
    return np.repeat(np.exp(0.1 * total)[None], 3, 0)


def shown(shift, seed=0):
    """Return the picture that shows the pattern where an affine map [2, 3] puts it."""
    inverse = np.linalg.inv(np.vstack((shift, [0, 0, 1])))
    column, row = np.meshgrid(np.arange(SIZE, dtype=float), np.arange(SIZE, dtype=float))
    moved = np.stack((column, row, np.ones_like(row)), axis=-1) @ inverse[:2].T
    return features(picture(moved[..., 0], moved[..., 1], seed), VALID)


PLAIN = shown(IDENTITY)


@pytest.mark.parametrize("shift", [
    [[1, 0, 0.4], [0, 1, -0.3]], [[1, 0, 7.6], [0, 1, -5.2]], [[1.01, 0.004, -0.8], [-0.006, 0.99, 0.5]], [[0.9998, -0.0175, 3.0], [0.0175, 0.9998, -2.0]],
])
def test_affine_maps_are_found_to_a_hundredth_of_a_texel(shift):
    shift = np.array(shift, float)
    found = align(PLAIN, shown(shift))
    # A translation that nearly explains a small affine map is taken instead of it: 0.15 was measured.
    assert moved_by(IDENTITY + found.shift - shift, (SIZE, SIZE)) < (0.03 if (shift[:, :2] == np.eye(2)).all() else 0.15)
    assert found.after > 0.98 and found.after > found.before


def test_what_lies_well_is_left_nearly_where_it_is():
    noisy = PLAIN + 0.3 * np.random.default_rng(0).standard_normal(PLAIN.shape).astype(np.float32)
    assert align(PLAIN, noisy).moves((SIZE, SIZE)) < 0.05


def test_patterns_without_anything_in_common_stay_without():
    found = align(PLAIN, shown(IDENTITY, seed=5))
    assert found.before < 0.2 and found.after < 0.3


def test_light_that_changes_slowly_is_no_pattern():
    column, row = np.meshgrid(np.arange(SIZE, dtype=float), np.arange(SIZE, dtype=float))
    lit = picture(column, row) * (0.2 + column / SIZE) * (1.5 - row / SIZE)
    assert correlation(PLAIN, features(lit, VALID)) > 0.98
    assert np.abs(features(np.ones((3, SIZE, SIZE)), VALID)).max() < 0.01


def test_what_is_not_valid_has_no_pattern_and_counts_nowhere():
    valid = VALID.copy()
    valid[:, :40] = False
    column, row = np.meshgrid(np.arange(SIZE, dtype=float), np.arange(SIZE, dtype=float))
    spoilt = picture(column, row)
    spoilt[:, ~valid] = np.random.default_rng(0).uniform(0, 5, (3, (~valid).sum()))
    found = features(spoilt, valid)
    assert (found[:, :41] == 0).all() and align(PLAIN, found).moves((SIZE, SIZE)) < 0.1
    assert np.isfinite(features(spoilt, np.zeros_like(valid))).all()


def test_the_shift_that_remains_is_measured():
    rest = remaining(PLAIN, shown(np.array([[1, 0, 0.25], [0, 1, -0.1]])))
    assert len(rest) == 9 and np.abs(rest - (0.25, -0.1)).max() < 0.05
    assert len(remaining(PLAIN, shown(IDENTITY, seed=5))) == 0


def test_a_map_looks_into_a_picture():
    shift = np.array([[1.0, 0, 3], [0, 1, -2]])
    assert warped(PLAIN, shift)[2:, :-3] == pytest.approx(PLAIN[:-2, 3:], abs=1e-5) and moved_by(shift, (SIZE, SIZE)) == pytest.approx(np.hypot(3, 2))


def test_relief_that_lights_move_is_not_followed_and_a_moved_sample_is():
    grid = Grid((-50.0, -50.0, 50.0, 50.0), (100, 100))
    shift = [np.array([[1.0, 0, by], [0, 1, 0]]) for by in (0.6, 0.7, 0.8, 3.0)]  # texels of a millimetre
    notes = []
    kept = _without_relief([*shift, None, None], grid, notes)
    assert [one is not None for one in kept] == [False, False, False, True, False, False] and "3 photographs" in notes[0]
    few = [shift[0], shift[3], None, None, None, None]
    assert _without_relief(few, grid, notes) == few and len(notes) == 1
