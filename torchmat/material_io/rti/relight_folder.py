"""Folders of relight and OpenLIME, written and read: ``info.json`` beside the planes of its coefficients (`rti.info`)."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np

from torchmat.errors import DataError, RangeError, TorchmatError, check_option, message
from torchmat.images import read_image, write_image
from torchmat.material_io.exporter import Exporter, Losses
from torchmat.material_io.rti.coefficients import coefficients_of
from torchmat.material_io.rti.deep_zoom import SUFFIX, read_deep_zoom, write_deep_zoom
from torchmat.material_io.rti.info import INFO, checked_info, coefficients_from, info_of
from torchmat.material_io.rti.losses import losses_of
from torchmat.material_io.rti.sampled import as_rti, is_rti
from torchmat.material_io.rti.zoom_page import write_zoom_page
from torchmat.models import Material
from torchmat.text_file import read_json

IMAGES, LAYOUTS = ("jpg", "png"), ("auto", "image", "deepzoom")
_LARGE = 4096  # texels along a side: above, "auto" cuts planes into tiles
MODELS = ("auto", "ptm", "lptm", "hsh")
_SUFFIXES = {"jpg": (".jpg", ".jpeg"), "png": (".png",)}
_PLANE_SUFFIXES = (*(suffix for suffixes in _SUFFIXES.values() for suffix in suffixes), SUFFIX)


def is_relight(path: str | Path) -> bool:
    """Return whether a folder holds an ``info.json`` with a plane beside it, or a path names that file."""
    folder = Path(path).parent if Path(path).name == INFO else Path(path)
    if not os.path.isfile(folder / INFO):
        return False
    return any(os.path.isfile(folder / f"plane_0{suffix}") for suffix in _PLANE_SUFFIXES) or (
        Path(path).name == INFO
    )


def read_relight(path: str | Path) -> Material:
    """Return the material of a folder of relight's: a `ptm`, `lptm` or `hsh` in codes of a screen.

    Raises DataError, which names the file, for bases that no model here has (rbf, bilinear, spherical harmonics), for planes that
    are missing, of another size or in tiles, and for an ``info.json`` that is damaged.
    """
    folder = Path(path).parent if Path(path).name == INFO else Path(path)
    where = str(folder / INFO)
    model, height, width, ends = checked_info(where, read_json(folder / INFO, "info.json", "describe a relightable image"))
    pixels = [_read_plane(folder, number, (height, width)) for number in range(len(ends[0]) // 3)]
    planes = np.concatenate([plane.transpose(2, 0, 1) for plane in pixels])
    try:
        return coefficients_from(model, planes, ends).material()
    except TorchmatError as error:
        raise DataError(f"{where}: {error}") from error


def _read_plane(folder: Path, number: int, size: tuple[int, int]) -> np.ndarray:
    tiles = folder / f"plane_{number}{SUFFIX}"
    files = [folder / f"plane_{number}{suffix}" for suffixes in _SUFFIXES.values() for suffix in suffixes]
    path = next((file for file in files if os.path.isfile(file)), None)
    if path is None and os.path.isfile(tiles):
        path = tiles
    if path is None:
        step = "Restore it; planes that are cut into tiles are read as Deep Zoom images, plane_0.dzi and so on."
        raise DataError(message(str(files[0]), "the plane", "exist", "it is not there", step))
    pixels = read_deep_zoom(path) if path == tiles else read_image(path)
    if pixels.shape != (*size, 3) or pixels.dtype != np.uint8:
        fact = f"it is {pixels.shape} of {pixels.dtype.name}"
        step = "Restore it, or build all planes again."
        raise DataError(message(str(path), "the plane", f"be {(*size, 3)} of uint8, as {INFO} says", fact, step))
    return pixels


def write_planes(
    material: Material, folder: Path, image: str, quality: int, model: str, layout: str = "image"
) -> tuple[Material, list[Path]]:
    """Write ``info.json`` and its planes; return the material that they hold, and the files of the planes."""
    where = "export to relight"
    if image not in IMAGES:
        raise RangeError(message(where, "image", f"be one of {', '.join(IMAGES)}", f"it is {image!r}", "png loses nothing."))
    if model not in MODELS:
        raise RangeError(message(where, "model", f"be one of {', '.join(MODELS)}", f"it is {model!r}"))
    if not isinstance(quality, int) or not 1 <= quality <= 100:
        raise RangeError(message(where, "quality", "be a whole number of 1 to 100", f"it is {quality!r}", "98 is usual."))
    check_option(where, "layout", layout, LAYOUTS)
    written = _in_form(material, model)
    tiles = layout == "deepzoom" or (layout == "auto" and max(material.size) > _LARGE)
    info, planes = info_of(coefficients_of(written), image, quality)
    files = [folder / f"plane_{number}{SUFFIX if tiles else f'.{image}'}" for number in range(len(planes))]
    for file, pixels in zip(files, planes, strict=True):
        best = quality if image == "jpg" else None
        if tiles:
            write_deep_zoom(file, pixels, image, best)
        else:
            write_image(file, pixels, quality=best)
    (folder / INFO).write_text(json.dumps(info, indent=1) + "\n", encoding="utf-8")
    return written, files


def _in_form(material: Material, model: str) -> Material:
    """Return a material as one that the planes hold: itself where it is one, else fitted."""
    own = is_rti(material) and material.options.get("terms", 9) <= 9
    if own and model in ("auto", material.name):
        return material
    return as_rti(material, "hsh" if model == "auto" else model)


def write_relight(
    material: Material, path: Path, *, image: str = "jpg", quality: int = 98, model: str = "auto", layout: str = "auto",
    page: bool = True,
) -> Losses:
    """Write a folder of relight's, which OpenLIME shows.

    A `ptm`, `lptm` or `hsh` in codes of a screen is written as it is; any other material is fitted first, as it is seen along the
    normal. `image`: "jpg" at `quality`, which is what viewers load, or "png", which holds the codes exactly. `model`: "ptm", "lptm",
    "hsh", or "auto": the material's own, and of others hsh. `layout`: "image" is a file a plane, "deepzoom" tiles in levels, of which
    a viewer loads what it shows (`rti.deep_zoom`), "auto" tiles above 4096 texels on a side. `page`: whether tiles get a page that pans and
    zooms them and moves the light, and that opens from disk (`rti.zoom_page`); it takes a third more than the tiles again.
    """
    if not isinstance(page, bool):
        raise RangeError(message("export to relight", "page", "be true or false", f"it is {page!r}"))
    written, files = write_planes(material, path, image, quality, model, layout)
    if page and files[0].suffix == SUFFIX:
        write_zoom_page(path, image, files)
    return losses_of(material, written, read_relight(path), "8 bits" if image == "png" else f"8 bits, JPEG of quality {quality}")


RELIGHT = Exporter(
    "relight", "planes of coefficients and info.json, as relight and OpenLIME show them: one view, 8 bits; other materials are fitted",
    write_relight,
)
