"""The MERL database's `.binary` files: three int32 sizes, then the red, green and blue tables in float64."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import BinaryIO

import numpy as np
import torch
from torch import Tensor

from torchmat import atomic
from torchmat.brdf.base import Brdf
from torchmat.brdf.merl import MerlBrdf, fill_missing, tabulate
from torchmat.errors import DataError, message

# What the stored numbers are multiplied by, red, green and blue, to be 1/sr (BRDFRead.cpp).
SCALES = (1.0 / 1500.0, 1.15 / 1500.0, 1.66 / 1500.0)
HEAD_BYTES = 12
_STEP = "Download the file again, or copy it as binary."


def merl_sizes(head: bytes, size: int) -> tuple[int, int, int] | None:
    """Return the table's sizes when the first bytes `head` of a file of `size` bytes are a MERL head that fits it."""
    if len(head) < HEAD_BYTES:
        return None
    half, difference, azimuth = (int(count) for count in np.frombuffer(head[:HEAD_BYTES], "<i4"))
    entries = half * difference * azimuth
    whole = min(half, difference, azimuth) > 0 and size == HEAD_BYTES + 3 * 8 * entries
    return (half, difference, azimuth) if whole else None


def read_merl(path: str | Path, dtype: torch.dtype = torch.float32, interpolation: str = "linear") -> MerlBrdf:
    """Read a `.binary` file of the MERL database, or one of another resolution.

    Negative entries are missing ones; they are filled by `fill_missing` and counted in `missing_count`. An entry is
    missing when any of its channels is. Raises DataError, which names the file, when its size is not the one that its
    head promises, or when it holds NaN or Inf.
    """
    try:
        with open(path, "rb") as stream:
            size = os.fstat(stream.fileno()).st_size
            head = stream.read(HEAD_BYTES)
            sizes = merl_sizes(head, size)
            if sizes is None:
                raise _wrong_size(path, head, size)
            table = _read_table(path, stream, sizes, dtype)
    except OSError as error:
        step = "Check the path and that the file may be read."
        raise DataError(message(str(path), "the file", "be readable", str(error), step)) from error
    missing = (table < 0).any(dim=0)
    if not bool(missing.any()):
        return MerlBrdf(table, interpolation=interpolation)
    return MerlBrdf(fill_missing(table, missing), interpolation=interpolation, missing=missing)


def _wrong_size(path: str | Path, head: bytes, size: int) -> DataError:
    if len(head) < HEAD_BYTES:
        fact = f"the file has {size} bytes"
        return DataError(message(str(path), "the head", f"have {HEAD_BYTES} bytes", fact, _STEP))
    sizes = tuple(int(count) for count in np.frombuffer(head, "<i4"))
    if min(sizes) < 1:
        return DataError(message(str(path), "the sizes in the head", "be positive", f"they are {sizes}", _STEP))
    fact = f"{' x '.join(map(str, sizes))} entries take {HEAD_BYTES + 24 * math.prod(sizes)} bytes and it has {size}"
    return DataError(message(str(path), "the file", "have the size that its head promises", fact, _STEP))


def _read_table(path: str | Path, stream: BinaryIO, sizes: tuple[int, int, int], dtype: torch.dtype) -> Tensor:
    table = torch.empty(3, *sizes, dtype=dtype)
    for plane, scale in zip(table, SCALES, strict=True):  # plane by plane, so that only one is held in float64
        entries = np.fromfile(stream, "<f8", math.prod(sizes))
        if entries.size != plane.numel():
            fact = f"{entries.size} of {plane.numel()} entries came"
            raise DataError(message(str(path), "the file", "be readable to its end", fact, _STEP))
        wrong = int((~np.isfinite(entries)).sum())
        if wrong:
            fact = f"{wrong} of {entries.size} entries of a channel are NaN or Inf"
            raise DataError(message(str(path), "the table", "be finite", fact, _STEP))
        entries *= scale
        if np.abs(entries).max() > torch.finfo(dtype).max:
            fact = f"its largest magnitude is {np.abs(entries).max():.6g}"
            raise DataError(message(str(path), "the table", f"fit {dtype}", fact, _STEP))
        plane.copy_(torch.from_numpy(entries).reshape(sizes))
    return table


def write_merl(path: str | Path, brdf: Brdf) -> Path:
    """Write a BRDF in the MERL database's format and return the path; the file appears whole or not at all.

    A MerlBrdf is written as it is, in its resolution and with its missing entries as -1; any other is tabulated first,
    at 90 x 90 x 180 (`tabulate`). Only files of that size are read by other programs. Raises DataError, which names
    the file, when it cannot be written, RangeError for an anisotropic BRDF.
    """
    found = brdf if isinstance(brdf, MerlBrdf) else tabulate(brdf)
    table = found.table.detach()
    table = table.expand(3, *table.shape[1:])
    path = Path(path)
    with atomic.building_file(path) as built, open(built, "wb") as stream:
        stream.write(np.array(found.resolution, "<i4").tobytes())
        for plane, scale in zip(table, SCALES, strict=True):
            entries = plane.numpy().astype("<f8") / scale
            if found.missing is not None:
                entries[found.missing.numpy()] = -1
            stream.write(entries.tobytes())
    return path
