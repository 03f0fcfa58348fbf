"""The captured BTF as a folder that `load_btf` reads: half-float pictures, ``manifest.csv``, ``capture.json`` and a page that shows each step."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from torchmat import atomic
from torchmat.capturing.rectify import Grid, Rectified
from torchmat.images import write_image
from torchmat.written import changed_files, write_record

RECORD, PAGE, MANIFEST = "capture.json", "capture.html", "manifest.csv"


def check_target(target: str | Path, force: bool = False) -> bool:
    """Raise DataError unless `target` may be replaced: absent, empty, or an earlier capture as torchmat wrote it.

    With `force` an earlier capture may be replaced even so; True is returned when a backup must be kept.
    """
    record = Path(target) / RECORD
    changed = changed_files(record) if os.path.isfile(record) else []
    return atomic.refuse_foreign(Path(target), _is_ours, "an earlier capture", changed, force)


def _is_ours(name: str) -> bool:
    return name in (RECORD, PAGE, MANIFEST) or name.endswith(".exr")


def manifest_text(names: Sequence[str], grid: Grid, views: np.ndarray, lights: np.ndarray, near_lights: bool) -> str:
    """Return the table: `views` [n, 3] are the cameras' positions and `lights` [n, 3] positions where they are near, else directions, in mm.

    Positions are counted from the middle of the sample's plane; what lamps fall off to is taken out of the values already.
    """
    left, bottom, right, top = grid.box
    middle = np.array([(left + right) / 2, (bottom + top) / 2, grid.height])
    columns = ("light_x", "light_y", "light_z") if near_lights else ("light_polar_deg", "light_azimuth_deg")
    lines = [",".join(("file", *columns, "view_x", "view_y", "view_z", "sample_width", "falloff"))]
    for name, view, light in zip(names, views, lights, strict=True):
        cells = light - middle if near_lights else _angles(light)
        numbers = (*cells, *(view - middle), right - left, 0)
        lines.append(",".join((_quoted(name), *(f"{number:.9g}" for number in numbers))))
    return "\n".join(lines) + "\n"


def _angles(direction: np.ndarray) -> tuple[float, float]:
    x, y, z = direction
    return float(np.degrees(np.arctan2(np.hypot(x, y), z))), float(np.degrees(np.arctan2(y, x)) % 360)


def _quoted(name: str) -> str:
    doubled = name.replace('"', '""')
    return f'"{doubled}"' if any(letter in name for letter in ',;\t"') else name


def write_capture(
    target: str | Path, names: Sequence[str], pictures: Iterator[Rectified], manifest: str, record: Callable[[], Mapping[str, Any]],
    page: Callable[[], str], force: bool = False,
) -> Path:
    """Write a capture that appears whole or not at all; return the folder.

    Args:
        target: the folder.
        names: of the pictures, as the manifest has them.
        pictures: one after the other; alpha is 0 where they are not valid.
        manifest: the table.
        record, page: what ``capture.json`` and the page hold, asked for when all pictures are written.
        force: whether an earlier capture that was changed is replaced; it is kept then, as a backup.

    Raises DataError when the folder holds something else, or cannot be written.
    """
    backup = check_target(target, force)
    with atomic.building(target, backup=backup) as building:
        for name, one in zip(names, pictures, strict=True):
            write_image(building / name, _half(one))
        (building / MANIFEST).write_text(manifest, encoding="utf-8")
        (building / PAGE).write_text(page(), encoding="utf-8")
        write_record(building / RECORD, record())
    return Path(target)


def _half(one: Rectified) -> np.ndarray:
    planes = torch.cat((one.values, one.valid[None].float()))  # all pictures have an alpha: they must be alike
    return np.ascontiguousarray(planes.permute(1, 2, 0).numpy().astype(np.float16))
