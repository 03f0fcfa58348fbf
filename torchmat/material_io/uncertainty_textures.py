"""Standard errors beside the maps of a material folder: `uncertainty/NAME.exr`, half floats in the unit of the map."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchmat.errors import DataError, RangeError, check_finite, message
from torchmat.images import read_image, write_image
from torchmat.models import Material
from torchmat.models.uncertainty import Uncertainty

KEY = "uncertainty"  # of the manifest, and the subfolder
_FREEDOM = "degrees_of_freedom"
_MOST = float(np.finfo(np.float16).max)


def write_uncertainty(folder: Path, material: Material, found: Uncertainty) -> dict[str, Any]:
    """Write standard errors into the folder of a material; return what its manifest says of them.

    Raises RangeError for those of maps that the material does not have, or that a half cannot hold.
    """
    (folder / KEY).mkdir(exist_ok=True)
    specs, entries = {spec.name: spec for spec in material.specs()}, []
    for name, error in found.error.items():
        if name not in specs or error.shape != material.maps[name].shape:
            fact = f"the material has {', '.join(specs)}, and {name} here is {tuple(error.shape)}"
            raise RangeError(message("save_material", "uncertainty", "be that of the material's maps", fact))
        check_finite("save_material", f"the uncertainty of {name}", error)
        parts = error.split(specs[name].layer_channels)
        entries += [_write(folder, name, texture, part) for texture, part in zip(specs[name].textures, parts, strict=True)]
    entries.append(_write(folder, _FREEDOM, _FREEDOM, found.freedom))
    return {**found.as_table(), "textures": entries}


def _write(folder: Path, name: str, texture: str, planes: Tensor) -> dict[str, Any]:
    if float(planes.max()) > _MOST:
        fact = f"it is up to {float(planes.max()):.6g}"
        raise RangeError(message("save_material", f"the uncertainty of {name}", f"be at most {_MOST:.6g}", fact, "Divide the map by a constant."))
    file = f"{KEY}/{texture}.exr"
    write_image(folder / file, planes.permute(1, 2, 0).numpy().astype(np.float16))
    return {"map": name, "file": file, "channels": len(planes), "height": planes.shape[1], "width": planes.shape[2]}


def load_uncertainty(folder: str | Path) -> Uncertainty | None:
    """Return the standard errors that stand in a material folder, None where there are none.

    Raises DataError, naming the file, where a texture is missing or is not what the manifest says.
    """
    from torchmat.material_io.read_folder import read_manifest

    folder = Path(folder)
    table = read_manifest(folder).get(KEY)
    if table is None:
        return None
    try:
        parts: dict[str, list[Tensor]] = {}
        for entry in table["textures"]:
            parts.setdefault(entry["map"], []).append(_read(folder, entry))
        joined = {name: torch.cat(planes) for name, planes in parts.items()}
        return Uncertainty.of_table(joined, joined.pop(_FREEDOM), table)
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        fact = f"{type(error).__name__}: {error}"
        raise DataError(message(str(folder / "manifest.json"), KEY, "describe standard errors", fact, "Restore the file.")) from error


def _read(folder: Path, entry: dict[str, Any]) -> Tensor:
    path = folder / entry["file"]
    if entry["file"] != f"{KEY}/{Path(entry['file']).name}" or not os.path.isfile(path):
        raise DataError(message(str(path), "the texture", f"stand in {KEY}", "it does not", "Restore it or fit again."))
    pixels = read_image(path)
    if pixels.shape != (entry["height"], entry["width"], entry["channels"]):
        fact = f"it is {pixels.shape}"
        raise DataError(message(str(path), "the texture", "have the size and channels of the manifest", fact, "Restore it or fit again."))
    planes = torch.from_numpy(pixels.astype(np.float32)).permute(2, 0, 1).contiguous()
    check_finite(str(path), "the texture", planes, "Restore it or fit again.")
    return planes


def without(table: dict[str, Any], changed: set[str]) -> tuple[dict[str, Any], list[str]]:
    """Return what a manifest says of standard errors without those of maps that are others now, and the files that go."""
    gone = [entry["file"] for entry in table["textures"] if entry["map"] in changed]
    kept = [entry for entry in table["textures"] if entry["map"] not in changed]
    maps = {name: one for name, one in table["maps"].items() if name not in changed}
    if not maps:
        return {}, [entry["file"] for entry in table["textures"]]
    return {**table, "maps": maps, "textures": kept}, gone
