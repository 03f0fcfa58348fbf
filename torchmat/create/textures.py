"""The files of a PBR texture set, found by the names that vendors give them (`texture_names`), and what they hold."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from torchmat import safe
from torchmat.btf.photographs import read_with_alpha
from torchmat.create.mtlx import MtlxFiles, document_of, files_of_mtlx
from torchmat.create.texture_names import KINDS, PACKED, kind_of, without_name
from torchmat.errors import DataError, RangeError, ShapeError, check_finite, message
from torchmat.geometry.normals import flip_green
from torchmat.images import IMAGE_SUFFIXES
from torchmat.progress import in_command, progress

_UNREAD = frozenset({".webp", ".psd", ".dds", ".ktx", ".ktx2", ".jxl", ".avif", ".tx", ".heic", ".gif", ".jp2"})
_COLOURED = 0.02  # of a code: a grey file saved as JPEG stays below it
_LEVEL = 0.08  # reflectance at normal incidence of a specular level of 1 (Burley 2012)
_NAMES = (
    "_Color, _Opacity, _Displacement, _NormalGL, _NormalDX, _Roughness, _Gloss, _Metalness, _Specular or _AmbientOcclusion"
)


class Texture(NamedTuple):
    """A file, and which of its channels is meant: None for all, 3 for alpha."""

    path: Path
    channel: int | None = None


@dataclass(frozen=True)
class TextureSet:
    """The folder, what each kind of map is read from, files that are `left_out` with the reason, and those `ignored`."""

    folder: Path
    files: dict[str, Texture]
    left_out: dict[str, str]
    ignored: tuple[str, ...]

    def read(self, kind: str) -> Tensor | None:
        """Return a map [3, H, W] of codes in [0, 1], a color in linear light; None where there is none of the kind.

        One channel of a file comes three times over. Raises DataError or RangeError, which names the file.
        """
        found = self.files.get(kind)
        if found is None:
            return None
        return self.planes(found, "auto" if kind == "color" else "linear")

    def notes(self) -> list[str]:
        """Return a line for each file that no map is read from, with the reason."""
        left_out = [f"left out   {name} ({why})" for name, why in sorted(self.left_out.items())]
        return left_out + [f"ignored    {name}" for name in self.ignored]

    def planes(self, texture: Texture, encoding: str) -> Tensor:
        """Return what a texture holds as [3, H, W], read in an encoding."""
        path, channel = texture
        picture, alpha, channels = read_with_alpha(path, encoding)
        if channel is not None and channel >= channels:
            fact = f"it has {channels}"
            step = "Save it with the channels that its name promises, or rename it."
            raise DataError(message(str(path), "the packed texture", f"have {channel + 1} channels", fact, step))
        if channel is not None:
            one = alpha if channel == 3 and alpha is not None else picture[channel : channel + 1]
            picture = one.expand(3, -1, -1)
        check_finite(str(path), "the texture", picture, "Correct those texels.")
        return picture

    def rows(self) -> list[tuple[str, str]]:
        """Return (kind, file and channel) of each map, in the order of KINDS."""
        letters = "red green blue alpha".split()
        found = []
        for kind in KINDS:
            if kind in self.files:
                path, channel = self.files[kind]
                found.append((kind, path.name + ("" if channel is None else f", {letters[channel]}")))
        return found


def is_texture_set(folder: str | Path) -> bool:
    """Return whether names in a folder tell a colour and another map, and no table there tells of photographs' lights."""
    if not os.path.isdir(folder):
        return False
    paths = [path for path in Path(folder).iterdir() if path.is_file()]
    if any(path.name == "manifest.csv" or path.suffix.lower() == ".lp" for path in paths):
        return False
    kinds = {kind_of(path.stem) for path in paths if path.suffix.lower() in IMAGE_SUFFIXES}
    if document_of(Path(folder)) is not None and any(path.suffix.lower() in IMAGE_SUFFIXES for path in paths):
        return True
    return "color" in kinds and len(kinds & {*KINDS, *PACKED, "bump"}) > 1


def find_textures(folder: str | Path) -> TextureSet:
    """Return what a folder holds, by the names of ambientCG, Poly Haven, FreePBR, Quixel, Substance, Poliigon and others.

    A file of one kind goes before a channel of a packed one (ARM, ORM, ...), OpenGL before DirectX normals, both before
    those whose name does not tell, roughness before gloss, displacement before bump, and metalness before specular.
    A picture called as the set itself is a preview, as is what says so. The one MaterialX document of a folder goes before
    names (`files_of_mtlx`). Raises DataError for no folder, no colour, two files of one kind, and for pictures whose names
    say nothing and that no document names.
    """
    folder = Path(folder)
    if not os.path.isdir(folder):
        step = "Give the folder that holds *_Color.jpg and its companions, unpacked."
        raise DataError(message(str(folder), "the textures", "be a folder", "it is none", step))
    pictures: list[Path] = []
    ignored: list[Path] = []
    for path in sorted(path for path in folder.iterdir() if path.is_file() and not path.name.startswith(".")):
        is_picture = path.suffix.lower() in IMAGE_SUFFIXES or (path.suffix.lower() in _UNREAD and kind_of(path.stem))
        (pictures if is_picture else ignored).append(path)
    told = {path: kind_of(path.stem) for path in pictures}
    for path, stem in zip(pictures, without_name([path.stem for path in pictures]), strict=True):
        if told[path] in PACKED:  # of two words the first may be the set's: Metal_Roughness
            told[path] = kind_of(stem) or told[path]
    _tell_previews(told)
    document = document_of(folder)
    given = MtlxFiles(folder, {}, frozenset()) if document is None else files_of_mtlx(document)
    _tell_named(told, given)
    _refuse_unknown(folder, told)
    kinds = {path: kind for path, kind in told.items() if kind is not None}
    left_out = {p.name: f"{k.removeprefix('no place: ')}: torchmat has no place for it" for p, k in kinds.items()
                if k.startswith("no place")}
    left_out |= {p.name: f"{k}: {given.document.name} names another" for p, k in kinds.items()
                 if k in given.kinds and given.kinds[k].path != p}
    ignored += [path for path, kind in kinds.items() if kind == "preview"]
    files = _files(folder, {path: kind for path, kind in kinds.items() if kind != "preview" and path.name not in left_out})
    files |= {kind: Texture(*named) for kind, named in given.kinds.items()}
    _choose(files, left_out)
    if "color" not in files:
        inner = [path.name for path in sorted(folder.iterdir()) if path.is_dir()] if not pictures else []
        step = f"Add a picture whose name ends in _Color, such as {folder.resolve().name}_Color.jpg."
        step = f"Give a folder inside it: {', '.join(inner[:3])}." if inner else step
        fact = f"it holds {', '.join(sorted(files)) or 'no texture at all'}"
        raise DataError(message(str(folder), "the folder", "hold a colour texture", fact, step))
    return TextureSet(folder, files, left_out, tuple(sorted(path.name for path in ignored)))


def _tell_previews(kinds: dict[Path, str | None]) -> None:
    """Mark a picture whose name two others, of different kinds, begin with: vendors add one of the whole material."""
    for path in kinds:
        begun = {kind for other, kind in kinds.items()
                 if other != path and other.stem.startswith(path.stem) and not other.stem[len(path.stem)].isalnum()}
        if len(begun - {None}) > 1:
            kinds[path] = "preview"


def _tell_named(kinds: dict[Path, str | None], given: MtlxFiles) -> None:
    """Say of pictures that a document names what it says; those whose input has no place here have none."""
    for path in given.every & set(kinds):
        used = [(kind, named.channel) for kind, named in given.kinds.items() if named.path == path]
        if used and used[0][1] is None:
            kinds[path] = used[0][0]
        elif used:  # by channels, whatever its name
            del kinds[path]
        elif path not in given.open:
            kinds[path] = "no place: what the document makes of it"


def _refuse_unknown(folder: Path, kinds: dict[Path, str | None]) -> None:
    unknown = [path.name for path, kind in kinds.items() if kind is None]
    if unknown:
        more = f" and {len(unknown) - 5} more" if len(unknown) > 5 else ""
        step = f"Rename those that are maps to end in {_NAMES}; move the others elsewhere."
        fact = f"{', '.join(unknown[:5])}{more} do not" if len(unknown) > 1 else f"{unknown[0]} does not"
        raise DataError(message(str(folder), "the names of pictures", "tell what they are", fact, step))
    unread = [path.name for path in kinds if path.suffix.lower() in _UNREAD and kinds[path] in (*KINDS, *PACKED, "bump")]
    if unread:
        step = "Save as PNG, JPEG, TIFF or EXR."
        raise DataError(message(str(folder), "the textures", "be of a format that is read", f"{unread[0]} is not", step))


def _files(folder: Path, kinds: dict[Path, str]) -> dict[str, Texture]:
    """Return the texture of each kind: files of their own first, then channels of packed ones."""
    files: dict[str, Texture] = {}
    packed: dict[str, Texture] = {}
    for path, kind in kinds.items():
        own = kind not in PACKED
        channels = {kind: None} if own else {name: place for place, name in enumerate(PACKED[kind]) if name}
        for name, channel in channels.items():
            known = (files if own else packed).get(name)
            if known is not None:
                fact = f"there are {known.path.name} and {path.name}"
                raise DataError(message(str(folder), f"the {name} texture", "be the only one", fact, "Move one elsewhere."))
            (files if own else packed)[name] = Texture(path, channel)
    return {**packed, **files}


def _choose(files: dict[str, Texture], left_out: dict[str, str]) -> None:
    """Keep one of those kinds that say the same thing, and bring bump to the name of displacement."""
    order = (
        ("normalgl", "normaldx"), ("normalgl", "normal"), ("normaldx", "normal"), ("displacement", "bump"),
        ("roughness", "gloss"), ("metalness", "specular"), ("metalness", "specularlevel"), ("specular", "specularlevel"),
    )
    for kept, other in order:
        if kept in files and other in files:
            dropped = files.pop(other)
            if dropped.channel is None:
                left_out[dropped.path.name] = f"{other}: {kept} says it"
    if "bump" in files:
        files["displacement"] = files.pop("bump")


def read_textures(found: TextureSet) -> dict[str, Tensor]:
    """Return the textures by kind, all of one size, gloss turned into roughness.

    `color` [3, H, W] linear; `normalgl`, `normaldx` or `normal` unit, the first two both as `normalgl`; `f0` [3, H, W],
    linear, the reflectance at normal incidence; the others [1, H, W] as stored. `opacity` is a file or the color's alpha.
    A specular file is f0, sRGB where it has whole numbers, if it is coloured or stands beside gloss; else, as a specular
    level, it is 0.08 f0. Raises ShapeError, which names the file, when one has another size than the colour.
    """
    textures: dict[str, Tensor] = {}
    for kind in progress(sorted(found.files, key=lambda kind: kind != "color"), "reading textures", show=in_command()):
        name, texture = _read_one(found, kind)
        size = tuple(textures.get("color", texture).shape[1:])
        if tuple(texture.shape[1:]) != size:
            fact = f"it is {tuple(texture.shape[1:])}, {found.files['color'].path.name} is {size}"
            step = "Scale it."
            raise ShapeError(message(str(found.files[kind].path), "the texture", "have the size of the colour", fact, step))
        textures[name] = texture
    path = found.files["color"].path
    alpha = None if "opacity" in textures else read_with_alpha(path, "linear")[1]
    if alpha is not None and float(alpha.min()) < 1:
        textures["opacity"] = _share(path, "alpha", alpha)
    return textures


def _read_one(found: TextureSet, kind: str) -> tuple[str, Tensor]:
    """Return what a kind of map is called once it is read, and its values."""
    path, texture = found.files[kind].path, found.read(kind)
    assert texture is not None  # its kind is one that was found
    if kind in ("normalgl", "normaldx", "normal"):
        normal = _normal(texture, path)
        return ("normalgl", flip_green(normal)) if kind == "normaldx" else (kind, normal)
    if kind in ("specular", "specularlevel"):
        return "f0", _at_normal(found, kind, _share(path, kind, texture))
    if kind == "gloss":
        return "roughness", 1 - _share(path, kind, texture[:1])
    if kind in ("color", "displacement"):
        return kind, texture if kind == "color" else texture[:1]
    return kind, _share(path, kind, texture[:1])


def _at_normal(found: TextureSet, kind: str, codes: Tensor) -> Tensor:
    """Return the reflectance at normal incidence [3, H, W] that a specular file means."""
    coloured = float((codes.amax(dim=0) - codes.amin(dim=0)).max()) > _COLOURED
    beside_gloss = "gloss" in found.files or any(why.startswith("gloss") for why in found.left_out.values())
    if kind == "specular" and (coloured or beside_gloss):
        return found.planes(found.files[kind], "auto")
    return _LEVEL * codes[:1].expand(3, -1, -1)


def _share(path: Path, kind: str, texture: Tensor) -> Tensor:
    """Return a texture of shares; raises RangeError, which names the file, outside [0, 1]."""
    if float(texture.min()) < 0 or float(texture.max()) > 1:
        fact = f"it runs from {float(texture.min()):.6g} to {float(texture.max()):.6g}"
        raise RangeError(message(str(path), f"the {kind} texture", "lie in [0, 1]", fact, "Correct it."))
    return texture


def _normal(codes: Tensor, path: Path) -> Tensor:
    """Return unit normals of codes [3, H, W] that span -1..1, or of the numbers themselves where some are negative."""
    normal = codes if float(codes.min()) < 0 else codes * 2 - 1
    if float(normal[2].median()) <= 0:
        step = "Is it another kind of texture? Rename it, or move it elsewhere."
        fact = f"half of them have z below {float(normal[2].median()):.3g}"
        raise DataError(message(str(path), "normals", "point away from the surface", fact, step))
    unit = safe.normalise(normal)
    up = torch.tensor([0.0, 0.0, 1.0])[:, None, None]
    return torch.where((unit == 0).all(dim=0), up, unit)
