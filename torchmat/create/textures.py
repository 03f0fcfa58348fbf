"""The files of a PBR texture set, found by the endings that ambientCG gives their names, and what they hold."""

from __future__ import annotations

import os
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from torchmat import safe
from torchmat.btf.photographs import read_linear
from torchmat.errors import DataError, ShapeError, check_finite, message
from torchmat.geometry.normals import flip_green

KINDS = ("color", "displacement", "normalgl", "normaldx", "roughness", "ambientocclusion", "metalness")
SUFFIXES = (".jpg", ".jpeg", ".png", ".exr", ".tif", ".tiff")


class TextureSet(NamedTuple):
    """The folder, the `files` of each kind in it, and the names of the files that are `ignored`."""

    folder: Path
    files: dict[str, Path]
    ignored: tuple[str, ...]

    def read(self, kind: str, encoding: str = "linear") -> Tensor | None:
        """Return the texture [3, H, W] of a kind, None when there is none; raises an error that names the file."""
        path = self.files.get(kind)
        if path is None:
            return None
        found = read_linear(path, encoding)
        check_finite(str(path), "the texture", found, "Correct those texels.")
        return found


def find_textures(folder: str | Path) -> TextureSet:
    """Return what a folder holds: ``*_Color``, ``*_Displacement``, ``*_NormalGL``, ... in whatever case.

    Raises DataError for no folder, no `*_Color`, or two files of one kind. Of both normal maps the OpenGL one is used.
    """
    folder = Path(folder)
    if not os.path.isdir(folder):
        step = "Give the folder that holds *_Color.jpg and its companions, unpacked."
        raise DataError(message(str(folder), "the textures", "be a folder", "it is none", step))
    files: dict[str, Path] = {}
    ignored = []
    for path in sorted(path for path in folder.iterdir() if path.is_file()):
        kind = path.stem.rpartition("_")[2].casefold()
        if kind not in KINDS or path.suffix.lower() not in SUFFIXES:
            ignored.append(path.name)
        elif kind in files:
            fact = f"there are {files[kind].name} and {path.name}"
            raise DataError(message(str(folder), f"the {kind} texture", "be the only one", fact, "Move one elsewhere."))
        else:
            files[kind] = path
    if "normalgl" in files and "normaldx" in files:
        ignored.append(files.pop("normaldx").name)
    if "color" not in files:
        step = f"Add a picture whose name ends in _Color, such as {folder.resolve().name}_Color.jpg."
        fact = f"it holds {', '.join(sorted(files)) or 'no texture at all'}"
        raise DataError(message(str(folder), "the folder", "hold a colour texture", fact, step))
    return TextureSet(folder, files, tuple(sorted(ignored)))


def read_textures(found: TextureSet) -> dict[str, Tensor]:
    """Return the textures by kind, all of one size: `color` linear, `normal` unit, the others [1, H, W] as stored.

    Raises ShapeError, which names the file, when one has another size than the colour.
    """
    textures: dict[str, Tensor] = {}
    for kind in found.files:
        texture = found.read(kind, "auto" if kind == "color" else "linear")
        if texture is None:
            continue
        if kind in ("normalgl", "normaldx"):
            normal = _normal(texture, found.files[kind])
            textures["normal"] = normal if kind == "normalgl" else flip_green(normal)
        else:
            textures[kind] = texture if kind == "color" else texture[:1]
    size = textures["color"].shape[1:]
    for kind, path in found.files.items():
        texture = textures["normal" if kind.startswith("normal") else kind]
        if texture.shape[1:] != size:
            fact = f"it is {tuple(texture.shape[1:])}, {found.files['color'].name} is {tuple(size)}"
            raise ShapeError(message(str(path), "the texture", "have the size of the colour", fact, "Scale it."))
    return textures


def _normal(codes: Tensor, path: Path) -> Tensor:
    """Return unit normals of codes [3, H, W] that span -1..1."""
    normal = codes * 2 - 1
    if float(normal[2].median()) <= 0:
        step = "Is it another kind of texture? Rename it, or move it elsewhere."
        fact = f"half of them have z below {float(normal[2].median()):.3g}"
        raise DataError(message(str(path), "normals", "point away from the surface", fact, step))
    unit = safe.normalise(normal)
    up = torch.tensor([0.0, 0.0, 1.0])[:, None, None]
    return torch.where((unit == 0).all(dim=0), up, unit)
