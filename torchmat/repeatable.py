"""Products whose bits do not depend on the number of threads.

Libraries split a long sum among threads, and LAPACK's factorisations change their blocks with the number of threads;
both round otherwise. Sums over few rows are split along the result instead, which changes nothing.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch
import torch.nn.functional as functional
from torch import Tensor

_ROWS = 128  # sums over no more rows than this were never split, for float32 and float64 (MKL 2024.2)
_RUN, _FEWEST_RUNS = 2048, 4
_NARROW = 4096  # below so many rows and columns of the result one thread is as fast as two
# Results of 5 or 6 rows, and of 2 or 3 in double precision, round by the number of threads on some processors; those of
# one row, of 4, 8, 12 ... never did (MKL 2024.2, 1 to 33 rows).
_FULL = 4


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
    """Return first [m, k] @ second [k, n] where k may be long: in runs of fixed length that threads share out."""
    runs = first.shape[1] // _RUN
    if runs < _FEWEST_RUNS:
        with one_thread():
            return first @ second
    end = runs * _RUN
    batch = first[:, :end].unflatten(1, (runs, _RUN)).transpose(0, 1)
    total = torch.bmm(batch, second[:end].unflatten(0, (runs, _RUN))).sum(dim=0)
    if end < first.shape[1]:
        with one_thread():
            total += first[:, end:] @ second[end:]
    return total


def orthonormal(matrix: Tensor) -> Tensor:
    """Return an orthonormal basis of the columns of a tall matrix."""
    with one_thread():
        return torch.linalg.qr(matrix).Q


def _full_rows(matrix: Tensor) -> Tensor:
    """Return `matrix` [m, k] with rows of zeros up to a multiple of four; one row stays as it is."""
    return matrix if len(matrix) == 1 else functional.pad(matrix, (0, 0, 0, -len(matrix) % _FULL))


def wide_product(first: Tensor, second: Tensor) -> Tensor:
    """Return first [m, k] @ second [k, n] where n may be large and k is not."""
    if max(len(first), second.shape[1]) < _NARROW:
        with one_thread():
            return first @ second
    return (_full_rows(first) @ second)[: len(first)]


def add_product(total: Tensor, left: Tensor, right: Tensor) -> None:
    """Add left^T @ right to `total` [m, n] in place, for left [k, m] and right [k, n]."""
    if max(total.shape) < _NARROW:
        with one_thread():
            total.addmm_(left.T, right)
        return
    for rows, part in zip(left.split(_ROWS), right.split(_ROWS), strict=True):
        if len(total) > 1 and len(total) % _FULL:
            total += (_full_rows(rows.T) @ part)[: len(total)]
        else:
            total.addmm_(rows.T, part)


def spread(numbers: Tensor, rows: int, columns: int) -> Tensor:
    """Return numbers [C] as planes [C, rows, columns], whose gradients are summed row by row.

    Summed to one number at once they would be shared out among threads, and round by how many there are.
    """
    return numbers[:, None, None].expand(-1, rows, 1).expand(-1, -1, columns)
