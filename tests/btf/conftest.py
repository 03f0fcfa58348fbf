"""Every test of this room must leave the temporary folder and the cache as tidy as it found them."""

from __future__ import annotations

import tempfile

import pytest


@pytest.fixture(autouse=True)
def tidy(own_cache, tmp_path, monkeypatch):
    """Fail a test that leaves scratch files, or a half-built store, behind."""
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(scratch))
    yield
    assert list(scratch.iterdir()) == []
    half_built = [path for path in tmp_path.rglob(".*.building-*")]
    assert half_built == []
