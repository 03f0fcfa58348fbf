"""Height and normals as textures for other programs: 16-bit or float, both conventions of the green channel."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchmat import atomic
from torchmat.errors import check_finite, check_option
from torchmat.geometry import Relief
from torchmat.geometry.normals import flip_green
from torchmat.images import write_image
from torchmat.written import changed_files, write_record

DEPTHS = ("16", "float")
_RECORD = "relief.json"
_FILES = (
    _RECORD, "height.png", "height.exr", "normal_gl.png", "normal_gl.exr", "normal_dx.png", "normal_dx.exr",
    "albedo.exr", "confidence.png", "relief.png", "ball.png", "object_mask.png",
)


def _codes(planes: Tensor, low: float, high: float) -> np.ndarray:
    """Return 16-bit codes [H, W, C] of planes whose values span low..high."""
    share = (planes.double() - low) / (high - low) if high > low else torch.zeros_like(planes, dtype=torch.float64)
    return (share.clamp(0, 1) * 65535).round().permute(1, 2, 0).numpy().astype(np.uint16)


def _floats(planes: Tensor) -> np.ndarray:
    return planes.permute(1, 2, 0).numpy().astype(np.float32)


def check_target(target: str | Path, force: bool = False) -> bool:
    """Raise DataError unless `target` may be replaced: absent, empty, or an earlier relief as torchmat wrote it.

    With `force` an earlier relief may be replaced even so; True is returned when a backup must be kept.
    """
    record = Path(target) / _RECORD
    changed = changed_files(record) if os.path.isfile(record) else []
    return atomic.refuse_foreign(Path(target), lambda name: name in _FILES, "an earlier relief", changed, force)


def save_relief(
    relief: Relief, folder: str | Path, depth: str = "16", provenance: dict[str, Any] | None = None,
    companions: Callable[[Path], None] | None = None, force: bool = False,
) -> Path:
    """Write a relief as textures that appear whole or not at all; return the folder.

    `depth` "16" writes PNG codes, "float" EXR. `normal_gl` has green up the texture, `normal_dx` down; normals map
    -1..1 to the codes. `relief.json` states the height's range in texture widths. `companions` may write more. An
    earlier relief is replaced, unless something in it was changed; with `force` then too, and a backup is kept.
    Raises RangeError for values that are not finite, DataError when the folder cannot be written.
    """
    check_option("save_relief", "depth", depth, DEPTHS)
    for name, planes in relief._asdict().items():
        if planes is not None:
            check_finite("save_relief", name, planes)
    target = Path(folder)
    backup = check_target(target, force)
    low, high = float(relief.height.min()), float(relief.height.max())
    normals = {"normal_gl": relief.normal, "normal_dx": flip_green(relief.normal)}
    with atomic.building(target, backup=backup) as building:
        if depth == "16":
            write_image(building / "height.png", _codes(relief.height, low, high))
            for name, normal in normals.items():
                write_image(building / f"{name}.png", _codes(normal, -1.0, 1.0))
        else:
            write_image(building / "height.exr", _floats(relief.height))
            for name, normal in normals.items():
                write_image(building / f"{name}.exr", _floats(normal))
        if relief.albedo is not None:
            write_image(building / "albedo.exr", _floats(relief.albedo))
        if relief.confidence is not None:
            write_image(building / "confidence.png", _codes(relief.confidence, 0.0, 1.0))
        described = {"height_low": low, "height_high": high, "unit": "texture widths", "provenance": provenance or {}}
        if companions is not None:
            companions(building)
        write_record(building / _RECORD, described)
    return target
