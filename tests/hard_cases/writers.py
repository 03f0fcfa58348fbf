"""Everything that writes files: what it is given, how it writes, and what must come back."""

from __future__ import annotations

import functools
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tests.hard_cases.components import NotHere
from tests.models.distributions import ALL_PARTS, distribution
from tests.models.examples import make
from tests.support import all_pairs, hemisphere, plausible_images
from torch import Tensor

import torchmat as tm
from torchmat.geometry import Relief
from torchmat.geometry.height_file import load_height
from torchmat.geometry.normals import normals_from_height
from torchmat.images import read_image
from torchmat.material_io import load_material, save_material
from torchmat.material_io.packing import pack, packed, unpack
from torchmat.material_io.relief_folder import DEPTHS, save_relief
from torchmat.models.storage import STORAGES
from torchmat.rendering.files import write_picture
from torchmat.report import write_fit

Maps = dict[str, Tensor]


@dataclass(frozen=True)
class Writer:
    """One way to write files.

    `make` gives what to write, of (rows, columns) and a seed; `write` writes it under a target, whose name ends in
    `suffix`; `read` returns the maps that a target holds, `wanted` those that writing must bring back, exactly.
    `replaced` returns what is to be written with some of its values replaced, by name; None where nothing can be.
    """

    name: str
    make: Callable[[tuple[int, int], int], Any]
    write: Callable[[Any, Path], object]
    read: Callable[[Path], Maps]
    wanted: Callable[[Any], Maps]
    suffix: str = ""
    replaced: Callable[..., Any] | None = None
    poison: str = ""  # which value to make NaN of
    kind: str = "material"


def _maps(material: tm.Material) -> Maps:
    return {name: value.detach().float() for name, value in material.maps.items()}


def _material(storage: str, size: tuple[int, int], seed: int) -> tm.Material:
    return distribution(*size, lobes=2, parts=ALL_PARTS, relief=True, seed=seed, storage=storage)


def _volume(size: tuple[int, int], seed: int) -> tm.Material:
    # Values that are codes, so that they come back exactly.
    material = make("shading_map", {"slices": 3, "brdf": "phong"}, *size, torch.float32, seed)
    slices = material.maps["slices"].detach()
    return material.with_maps(slices=(slices / slices.max() * 255).round() / 255)


def _relief(size: tuple[int, int], seed: int) -> Relief:
    height = 0.1 * torch.rand(1, *size, generator=torch.Generator().manual_seed(seed))
    return Relief(height, normals_from_height(height))


def _quantised(relief: Relief, depth: str) -> Maps:
    low, high = float(relief.height.min()), float(relief.height.max())
    if depth == "float" or high == low:
        return {"height": relief.height}
    codes = ((relief.height.double() - low) / (high - low) * 65535).round()
    return {"height": low + codes.float() * ((high - low) / 65535)}


def _picture(size: tuple[int, int], seed: int) -> Tensor:
    return torch.rand(3, *size, generator=torch.Generator().manual_seed(seed))


def _shown(picture: Tensor) -> Maps:
    from torchmat import colour

    return {"picture": (colour.display(picture) * 255).round()}


def _read_picture(path: Path) -> Maps:
    return {"picture": torch.from_numpy(read_image(path).astype(np.float32)).permute(2, 0, 1)}


@functools.lru_cache(maxsize=8)
def _fit(size: tuple[int, int], seed: int) -> tuple[tm.Btf, tm.FitResult]:
    light, view = all_pairs(hemisphere(), hemisphere(((0, 1), (40, 4))))
    btf = tm.Btf.from_tensors(plausible_images(light, view, *size, seed=seed).astype(np.float32), light, view)
    return btf, tm.fit(btf, "ptm", seed=seed, progress=False)


def writers() -> list[Writer]:
    """Return all of them."""
    found = [
        Writer(
            f"folder, {storage}", functools.partial(_material, storage), save_material, lambda path: _maps(load_material(path)),
            lambda material: _maps(material.as_exported()), replaced=tm.Material.with_maps, poison="diffuse",
        )
        for storage in STORAGES
    ]
    found += [
        Writer(
            f"packed, {depth} bits", functools.partial(_material, "half"), functools.partial(_pack, depth),
            lambda path: _maps(unpack(path)), functools.partial(_packed, depth), replaced=tm.Material.with_maps, poison="diffuse",
        )
        for depth in (8, 16)
    ]
    found += [
        Writer(
            f"relief, {depth}", _relief, functools.partial(_save_relief, depth), lambda path: {"height": load_height(path)},
            functools.partial(_quantised, depth=depth), replaced=Relief._replace, poison="height", kind="relief",
        )
        for depth in DEPTHS
    ]
    volume = Writer(
        ".3pm", _volume, save_material, lambda path: {"slices": load_material(path).maps["slices"].detach()},
        lambda material: {"slices": material.maps["slices"].detach()}, ".3pm", tm.Material.with_maps, "slices", "volume",
    )
    picture = Writer(
        "picture", _picture, write_picture, _read_picture, _shown, ".png", lambda old, picture: picture, "picture", "picture",
    )
    report = Writer(
        "report", _fit, lambda fitted, path: write_fit(*fitted, path, pictures=False), lambda path: _maps(load_material(path)),
        lambda fitted: _maps(fitted[1].material.as_exported()), kind="report",
    )
    return [*found, volume, picture, report]


def _pack(depth: int, material: tm.Material, path: Path) -> Path:
    return pack(material, path, depth)


def _packed(depth: int, material: tm.Material) -> Maps:
    return _maps(packed(material, depth))


def _save_relief(depth: str, relief: Relief, path: Path) -> Path:
    return save_relief(relief, path, depth)


def snapshot(path: Path) -> dict[str, bytes]:
    """Return the files of a folder, or the one file, by their names."""
    if path.is_file():
        return {path.name: path.read_bytes()}
    return {one.relative_to(path).as_posix(): one.read_bytes() for one in sorted(path.rglob("*")) if one.is_file()}


@contextmanager
def small_disk(folder: Path, kilobytes: int = 512) -> Iterator[Path]:
    """Mount a small disk in memory; raises NotHere where this process may not."""
    folder.mkdir(parents=True)
    size = f"size={kilobytes}k"
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", size, "tmpfs", str(folder)], capture_output=True, text=True
    ) if sys.platform == "linux" else None
    if mounted is None or mounted.returncode:
        raise NotHere("mounting a small disk is not permitted here")
    try:
        yield folder
    finally:
        subprocess.run(["umount", str(folder)], check=True)


def leave_free(disk: Path, kilobytes: float) -> None:
    """Fill a disk so that only so much is free."""
    state = os.statvfs(disk)
    spare = state.f_bavail * state.f_frsize - int(kilobytes * 1024)
    if spare > 0:
        (disk / "filler").write_bytes(bytes(spare))


def read_only(disk: Path) -> None:
    """Let nobody write to a small disk any more, root neither."""
    subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
