"""Products whose bits do not depend on the number of threads.

Libraries split a long sum among threads, and LAPACK's factorisations change their blocks with the number of threads;
both round otherwise. Sums over few rows are split along the result instead, which changes nothing.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch
from torch import Tensor

_ROWS = 128  # sums over no more rows than this were never split, for float32 and float64 (MKL 2024.2)
_NARROW = 60_000  # fewer columns may be shared out by rows; one thread is then nearly as fast, the images being read once


@contextmanager
def one_thread() -> Iterator[None]:
    """Compute with one thread, then with as many as before."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


def product(first: Tensor, second: Tensor) -> Tensor:
    """Return first @ second where the sum runs over a dimension that may be long."""
    with one_thread():
        return first @ second


def add_product(total: Tensor, left: Tensor, right: Tensor) -> None:
    """Add left^T @ right to `total` [r, n] in place, for left [k, r] and right [k, n]."""
    if total.shape[1] < _NARROW:
        with one_thread():
            total.addmm_(left.T, right)
        return
    for rows, part in zip(left.split(_ROWS), right.split(_ROWS), strict=True):
        total.addmm_(rows.T, part)
