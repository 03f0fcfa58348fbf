"""load_brdf: a measured BRDF from its file, the kind found from the content."""

from __future__ import annotations

import os
from pathlib import Path

import torch

from torchmat.brdf.base import Brdf
from torchmat.brdf.merl_file import HEAD_BYTES, merl_sizes, read_merl
from torchmat.brdf.rgl import read_rgl
from torchmat.brdf.tensor_file import MAGIC
from torchmat.errors import DataError, message

SUFFIXES = {".binary": "merl", ".bsdf": "rgl"}


def brdf_kind(path: str | Path) -> str | None:
    """Return "merl" or "rgl" for a file that begins like one, None for any other or for none."""
    path = Path(path)
    try:
        if not path.is_file():
            return None
        with open(path, "rb") as stream:
            head = stream.read(max(HEAD_BYTES, len(MAGIC)))
        if head.startswith(MAGIC):
            return "rgl"
        return "merl" if merl_sizes(head, path.stat().st_size) else None
    except (OSError, ValueError):  # ValueError: a NUL in the name
        return None


def load_brdf(path: str | Path, dtype: torch.dtype = torch.float32) -> Brdf:
    """Return the measured BRDF in a file, its kind told by content, not by name.

    Args:
        path: MERL's `.binary` or RGL's `.bsdf`.
        dtype: precision of its numbers, torch.float32 or torch.float64.

    Raises DataError, which names the file and says what to do, for anything else.
    """
    # A file that is damaged in its head is still reported as the kind that its name says, in that reader's words.
    kind = brdf_kind(path) or SUFFIXES.get(Path(path).suffix.lower())
    if os.path.isfile(path) and kind:
        return (read_merl if kind == "merl" else read_rgl)(path, dtype)
    fact = "it begins like neither" if os.path.isfile(path) else "there is no such file"
    step = "Give a MERL .binary or an RGL .bsdf file; formulas are made with AnalyticBrdf."
    raise DataError(message(str(path), "the file", "be a measured BRDF of MERL or RGL", fact, step))
