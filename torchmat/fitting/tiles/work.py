"""The folder in which a fit by tiles keeps what it has done, so that it goes on there after it was killed."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchmat.atomic import building_file, refuse_foreign
from torchmat.errors import DataError, RangeError, message
from torchmat.fitting.geometry import Geometry, Given
from torchmat.fitting.objective import describe_objective, described
from torchmat.fitting.recipe import recipe_of
from torchmat.fitting.relief.window import Window
from torchmat.fitting.tiles.plan import TilePart, TilePlan
from torchmat.fitting.training import Training
from torchmat.geometry import Relief
from torchmat.machine import versions
from torchmat.models import MATERIALS

_FORMAT = 3
_KEY, _PLAN = "fit.json", "plan.npz"
_NAMES = re.compile(r"fit\.json|plan\.npz|tile-\d{6}\.npz|\.(fit\.json|plan\.npz|tile-\d{6}\.npz)\.building-.*")
_HEADER = "header"


@dataclass(frozen=True)
class Work:
    """The folder of one fit: its plan, and a file for each finished tile.

    A file that is damaged, or of another fit, counts as absent: what it held is fitted again.
    """

    path: Path
    key: str

    def load_plan(self) -> TilePlan | None:
        """Return the plan that was kept, None if there is none."""
        found = _read(self.path / _PLAN, self.key)
        return None if found is None else _plan_of(*found)

    def save_plan(self, plan: TilePlan) -> None:
        """Keep the plan."""
        _write(self.path / _PLAN, self.key, *_pieces_of(plan))

    def load_tile(self, number: int, window: Window) -> TilePart | None:
        """Return what was found of a tile, None if it is still to be fitted."""
        found = _read(self._tile(number), self.key)
        if found is None or found[0]["window"] != list(window):
            return None
        header, maps = found
        return TilePart(window, maps, maps.pop("coverage", None), header["reason"])

    def save_tile(self, number: int, part: TilePart) -> None:
        """Keep what was found of a tile."""
        maps = part.maps if part.coverage is None else {**part.maps, "coverage": part.coverage}
        _write(self._tile(number), self.key, {"window": list(part.window), "reason": part.reason}, maps)

    def _tile(self, number: int) -> Path:
        return self.path / f"tile-{number:06d}.npz"


def open_work(
    path: str | Path, training: Training, model: str, options: dict[str, Any], geometry: Geometry, tile_size: int,
    memory_mb: float,
) -> Work:
    """Open the folder of a fit, or make it; raises DataError for a folder of another fit, or of anything else."""
    if callable(options.get("objective")):
        step = "Leave work out, or give an objective by its name."
        fact = f"it is {describe_objective(options['objective'])}, which may be another the next time"
        raise RangeError(message("fit", "objective", "have a name where work is kept", fact, step))
    path = Path(path)
    key = fit_key(training, model, options, geometry, tile_size, memory_mb)
    refuse_foreign(path, lambda name: _NAMES.fullmatch(name.split("/")[0]) is not None, "the work of a fit")
    known = None
    with suppress(OSError, ValueError, AttributeError):  # what cannot be read says nothing, and is written anew
        known = json.loads((path / _KEY).read_text()).get("key")
    if known is not None and known != key:
        fact = "it was begun with another config, other data or other versions"
        step = "Give the same ones to go on, another folder, or remove it to begin anew."
        raise DataError(message(str(path), "the work folder", "be of this fit", fact, step))
    if known is None:
        with building_file(path / _KEY) as file:
            file.write_text(json.dumps({"key": key, "model": model}) + "\n")
    return Work(path, key)


def clear_work(path: str | Path) -> None:
    """Remove the folder of a fit that is done; anything else there stays."""
    path = Path(path)
    if (path / _KEY).is_file():
        for file in list(path.iterdir()):
            if _NAMES.fullmatch(file.name):
                shutil.rmtree(file) if file.is_dir() else file.unlink(missing_ok=True)
        with suppress(OSError):  # not empty: somebody has put something else there since
            path.rmdir()


def fit_key(
    training: Training, model: str, options: dict[str, Any], geometry: Geometry, tile_size: int, memory_mb: float
) -> str:
    """Return a text that differs for fits whose tiles may differ: config, data and versions."""
    digest = hashlib.sha256()
    found = versions()
    told = [
        _FORMAT, {name: found[name] for name in ("torchmat", "torch")}, model, sorted(described(options).items()), tile_size,
        memory_mb,
        training.seed, training.tiles, str(training.dtype), geometry.word,
        training.btf.identity(),
    ]
    digest.update(json.dumps(told).encode())
    digest.update(training.used.numpy().tobytes())
    for values in (training.importance, geometry.height if isinstance(geometry, Given) else None):
        if values is not None:
            digest.update(values.detach().double().contiguous().numpy().tobytes())
    return digest.hexdigest()


def _write(path: Path, key: str, header: dict[str, Any], tensors: dict[str, Tensor]) -> None:
    text = json.dumps({"key": key, **header}).encode()
    arrays: dict[str, Any] = {name: value.detach().contiguous().numpy() for name, value in tensors.items()}
    with building_file(path) as file, open(file, "wb") as stream:
        np.savez(stream, **arrays | {_HEADER: np.frombuffer(text, np.uint8)})


def _read(path: Path, key: str) -> tuple[dict[str, Any], dict[str, Tensor]] | None:
    """Return header and tensors of a file of this fit, None if there is none or it is damaged."""
    try:
        with open(path, "rb") as stream, np.load(stream, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        header = dict(json.loads(arrays.pop(_HEADER).tobytes()))
    except Exception:  # whatever the damage, the tile can be fitted again
        return None
    tensors = {name: torch.from_numpy(value) for name, value in arrays.items()}
    return (header, tensors) if header.get("key") == key else None


def _pieces_of(plan: TilePlan) -> tuple[dict[str, Any], dict[str, Tensor]]:
    template = plan.template
    tensors = {f"template.{name}": value for name, value in template.maps.items()}
    shared, numbers = plan.shared.pieces()
    tensors |= {f"shared.{name}": value for name, value in shared.items()}
    if plan.height is not None:
        tensors["height"] = plan.height
    for name, value in (plan.relief._asdict() if plan.relief else {}).items():
        if value is not None:
            tensors[f"relief.{name}"] = value
    header = {
        "model": plan.model, "options": described(plan.options), "side": plan.side, "size": list(plan.size), "reason": plan.reason,
        "figures": plan.figures, "numbers": numbers, "shared_from": plan.shared_from,
        "template": {"options": template.options, "storage": template.storage, "tiles": template.tiles, "relief": template.relief},
    }
    return header, tensors


def _plan_of(header: dict[str, Any], tensors: dict[str, Tensor]) -> TilePlan:
    def group(prefix: str) -> dict[str, Tensor]:
        return {name.removeprefix(prefix): value for name, value in tensors.items() if name.startswith(prefix)}

    kind = MATERIALS[header["model"]]
    settings = header["template"]
    template = kind(group("template."), storage=settings["storage"], tiles=settings["tiles"], relief=settings["relief"], **settings["options"])
    relief = group("relief.")
    shared = recipe_of(header["model"]).shared.from_pieces(group("shared."), header["numbers"])
    return TilePlan(
        header["model"], header["options"], template, shared, header["side"], tuple(header["size"]), header["reason"],
        header["figures"], tensors.get("height"), Relief(**relief) if relief else None, header["shared_from"],
    )
