"""Hard case 16: killed at any moment of loading, fitting and exporting; the short form of `kills`."""

from __future__ import annotations

import pytest

from tests.hard_cases import kills

from torchmat import DataError


def test_16_killed_at_random_moments_all_that_stands_is_whole(tmp_path):
    rows = kills.run(1, 0, tmp_path)
    assert [row["component"] for row in rows] == [kind.component for kind in kills.WORKS]
    assert all(row["passed"] and row["count"] == 1 for row in rows)


def test_a_half_written_material_would_be_found(tmp_path):
    class Careless(kills.Export):
        def one(self, which):
            super().one(which)
            (self.target / "manifest.json").unlink()

    with pytest.raises(DataError, match="manifest|a material folder"):
        kills.torment(Careless(tmp_path / "careless", tmp_path), 1, 0)
