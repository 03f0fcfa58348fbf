"""Files and folders of others that hold a whole material, by what they are called and begin with."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from torchmat.material_io.folder import MANIFEST
from torchmat.material_io.rti.ptm_file import MAGIC as PTM_MAGIC
from torchmat.material_io.rti.ptm_file import SUFFIX as PTM_SUFFIX
from torchmat.material_io.rti.ptm_file import read_ptm
from torchmat.material_io.rti.relight_folder import is_relight, read_relight
from torchmat.material_io.rti.rti_file import MAGIC as RTI_MAGIC
from torchmat.material_io.rti.rti_file import SUFFIX as RTI_SUFFIX
from torchmat.material_io.rti.rti_file import read_rti
from torchmat.material_io.volume import SUFFIX as VOLUME_SUFFIX
from torchmat.material_io.volume import read_volume
from torchmat.models import Material

Read = Callable[[str | Path], Material]
_BY_SUFFIX: dict[str, Read] = {VOLUME_SUFFIX: read_volume, PTM_SUFFIX: read_ptm, RTI_SUFFIX: read_rti}
_BY_START: dict[bytes, Read] = {PTM_MAGIC: read_ptm, RTI_MAGIC: read_rti}


def reader_of(path: str | Path) -> Read | None:
    """Return what reads a material from `path`, None for material folders and for what is no material.

    What a file begins with counts before its name, which decides where it is damaged or absent.
    """
    if os.path.isdir(path):
        own = os.path.isfile(Path(path) / MANIFEST)
        return read_relight if not own and is_relight(path) else None
    if Path(path).name == "info.json" and is_relight(path):
        return read_relight
    start = _start(path)
    found = next((read for magic, read in _BY_START.items() if start.startswith(magic)), None)
    return found or _BY_SUFFIX.get(Path(path).suffix.lower())


def _start(path: str | Path) -> bytes:
    try:
        if not os.path.isfile(path):
            return b""
        with open(path, "rb") as stream:
            return stream.read(max(map(len, _BY_START)))
    except (OSError, ValueError):  # ValueError: a NUL in the name
        return b""
