"""load_brdf: a measured BRDF from its file, the kind found from the content."""

from __future__ import annotations

import os
from pathlib import Path

import torch

from torchmat.brdf.archive import kind_by_name, unpacked
from torchmat.brdf.base import Brdf
from torchmat.brdf.merl_file import HEAD_BYTES, merl_sizes, read_merl
from torchmat.brdf.rgl import read_rgl
from torchmat.brdf.tensor_file import MAGIC, TensorFile
from torchmat.errors import DataError, message

def brdf_kind(path: str | Path) -> str | None:
    """Return "merl" or "rgl" for a file that begins like one, or an archive of one; None for any other or for none."""
    path = Path(path)
    try:
        if not path.is_file():
            return None
        with open(path, "rb") as stream:
            head = stream.read(max(HEAD_BYTES, len(MAGIC)))
        if head.startswith(MAGIC):
            return "rgl"
        if head[:2] in (b"\x1f\x8b", b"PK"):
            return kind_by_name(path)
        return "merl" if merl_sizes(head, path.stat().st_size) else None
    except (OSError, ValueError):  # ValueError: a NUL in the name
        return None


def is_brdf_file(path: str | Path) -> bool:
    """Return whether `path` is a file of a measured BRDF, or is called like one, and then is reported if it is damaged."""
    return os.path.isfile(path) and (brdf_kind(path) or kind_by_name(path)) is not None


def is_isotropic_file(path: str | Path) -> bool:
    """Return whether the BRDF in a file is isotropic, from its head alone; raises DataError as `load_brdf` does."""
    if (brdf_kind(path) or kind_by_name(path)) != "rgl":
        return True
    with unpacked(path) as file:
        return len(TensorFile(file).array("phi_i")) <= 2


def load_brdf(path: str | Path, dtype: torch.dtype = torch.float32) -> Brdf:
    """Return the measured BRDF in a file, its kind told by content, not by name.

    Args:
        path: MERL's `.binary` or RGL's `.bsdf`, by itself, as `.gz`, or alone in a zip.
        dtype: precision of its numbers, torch.float32 or torch.float64.

    Raises DataError, which names the file and says what to do, for anything else.
    """
    # A file that is damaged in its head is still reported as the kind that its name says, in that reader's words.
    kind = brdf_kind(path) or kind_by_name(path)
    if os.path.isfile(path) and kind:
        with unpacked(path) as file:
            return (read_merl if kind == "merl" else read_rgl)(file, dtype)
    fact = "it begins like neither" if os.path.isfile(path) else "there is no such file"
    step = "Give a MERL .binary or an RGL .bsdf file; formulas are made with AnalyticBrdf."
    raise DataError(message(str(path), "the file", "be a measured BRDF of MERL or RGL", fact, step))
