"""The compiled road for its own tests: all others take plain torch."""

from __future__ import annotations

import pytest
import torch

from torchmat import fast


@pytest.fixture
def compiled():
    """Take the compiled part for one test; skip, with why, where there is none."""
    fast.use(True)
    if not fast.road().startswith("compiled"):
        fast.use(None)
        pytest.skip(fast.road())
    yield
    fast.use(None)


def on_both_roads(make):
    """Return what `make` gives on the plain road, and on the compiled one."""
    fast.use(False)
    plain = make()
    fast.use(True)
    return plain, make()


def with_threads(count: int, make):
    """Return what `make` gives with so many threads."""
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        return make()
    finally:
        torch.set_num_threads(before)


def same_values(plain: torch.Tensor, found: torch.Tensor, tolerance: float) -> None:
    """Hold the values of two roads together: NaN and infinite in the same places, else relative to the largest one."""
    assert plain.shape == found.shape and plain.dtype == found.dtype
    assert torch.equal(plain.isnan(), found.isnan()) and torch.equal(plain.isinf(), found.isinf())
    plain, found = (torch.where(torch.isfinite(one), one, 0) for one in (plain, found))
    if plain.numel():
        assert float((plain - found).abs().max()) <= tolerance * float(plain.abs().max())
