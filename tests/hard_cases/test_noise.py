"""As photographs get worse, errors grow smoothly; the short form of `noise`."""

from __future__ import annotations

import pytest
from tests.hard_cases import noise


@pytest.fixture(scope="module")
def rows():
    return noise.run(models={"lambert": {}, "phong_srf": {"residual": "half_light"}}, size=12)


def test_errors_grow_smoothly_with_every_harm(rows):
    assert {row["harm"] for row in rows} == set(noise.HARMS)
    assert noise.jumps(rows) == []


def test_every_harm_harms_in_the_end(rows):
    for harm in set(noise.HARMS) - {"directions"}:  # errors of directions average out, over so many and so smooth a lobe
        line = [row["relative_error"] for row in rows if (row["harm"], row["model"]) == (harm, "phong_srf")]
        assert line[-1] > 1.02 * line[0], harm


@pytest.mark.parametrize("errors, said", [
    ((0.01, 0.02, 0.03), "from 0 to 1"), ((0.01, 0.012, 0.02), ""), ((0.01, 0.012, 0.2), "from 1 to 2"),
    ((0.01, 0.009, 0.01), "from 0 to 1"), ((0.08, 0.09, 0.12), "ends at 0.12"),
])
def test_a_curve_that_jumps_is_found(errors, said):
    rows = [{"harm": "a", "model": "b", "level": level, "relative_error": error} for level, error in enumerate(errors)]
    found = noise.jumps(rows)
    assert said in found[0] if said else not found


def test_the_curves_can_be_drawn(rows, tmp_path):
    noise.plot(rows, tmp_path / "noise.png")
    assert (tmp_path / "noise.png").stat().st_size > 0
