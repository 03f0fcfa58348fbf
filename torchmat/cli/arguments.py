"""Arguments that several commands share: how images are read, names in a list, settings, and folders to write."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

SAMPLE = "sample"


@dataclass
class DataArguments:
    """How the images are read."""

    cache: Path | None = None
    """Folder for decoded images (default: the user's cache folder, or $TORCHMAT_CACHE)."""
    no_cache: bool = False
    """Decode anew and leave nothing behind."""
    kind: str | None = None
    """manifest, rti, ubo2003, utia, or another reader's name; found from the content when left out."""
    encoding: str | None = None
    """auto, srgb or linear."""
    exposure: float | None = None
    """The factor the photographs were exposed with; values are divided by it."""
    crop: tuple[int, int, int, int] | None = None
    """Top, left, height and width in texels."""
    downscale: int | None = None
    """Whole factor to shrink the images by, in linear light."""
    invalid: str | None = None
    """error, or mask: NaN and Inf get no weight."""
    duplicates: str | None = None
    """error, or keep: repeated directions are allowed."""
    normalise: bool | None = None
    """Bring directions that are not unit vectors to length 1."""
    clipped_weight: float | None = None
    """What a clipped sample counts in the fit, 0 to 1."""

    def keywords(self) -> dict[str, Any]:
        """Return what was given on the command line as keywords of `load_btf`."""
        names = ("kind", "encoding", "exposure", "crop", "downscale", "invalid", "duplicates", "normalise", "clipped_weight")
        given = {name: getattr(self, name) for name in names if getattr(self, name) is not None}
        return {**given, "cache": False if self.no_cache else (self.cache or True)}

    def load(self, path: str, settings: dict | None = None):
        """Load the BTF; arguments given on the command line override the config's [data]."""
        from torchmat import load_btf, sample_path

        where = sample_path() if path == SAMPLE and not Path(path).exists() else path
        return load_btf(where, **{**(settings or {}), **self.keywords()})


def names_of(texts: list[str]) -> list[str]:
    """Return the names in a list that has commas, spaces, or both between them."""
    return [name.strip() for text in texts for name in text.split(",") if name.strip()]


def options_of(texts: list[str]) -> dict[str, Any]:
    """Return the options that texts such as ``depth=16`` give; raises RangeError for other texts."""
    from torchmat.errors import RangeError, message
    from torchmat.fitting.config import parse_value

    found: dict[str, Any] = {}
    for text in texts:
        name, separator, value = text.partition("=")
        if not separator or not name.strip():
            fact, step = "it has no name or no '='", "For example --set depth=16."
            raise RangeError(message("--set", repr(text), "be OPTION=VALUE", fact, step))
        found[name.strip()] = parse_value(value)
    return found


def provenance_of(material: str) -> dict[str, Any]:
    """Return what a material folder says of where it comes from; nothing of another path."""
    from torchmat.material_io.folder import MANIFEST
    from torchmat.material_io.read_folder import read_manifest

    found = read_manifest(material).get("provenance") if (Path(material) / MANIFEST).is_file() else None
    return dict(found) if isinstance(found, dict) else {}


def check_apart(command: str, out: Path, *materials: str) -> None:
    """Raise RangeError when the target of a command is one of the materials that it works on."""
    from torchmat.errors import RangeError, message

    for material in materials:
        if out.resolve() == Path(material).resolve():
            step = "Name another folder: what was painted there would be lost."
            raise RangeError(message(command, "--out", "be another than the material", f"both are {material}", step))


def check_out(command: str, out: Path, *materials: str, force: bool = False) -> None:
    """Raise unless `out` may become a material folder, and is none of the `materials` that the command works on."""
    from torchmat.material_io import check_target

    check_apart(command, out, *materials)
    check_target(out, force)


def still_free(out: Path, force: bool) -> Path:
    """Return `out`, or a free name beside it when something was painted there while the result was made."""
    from torchmat import atomic
    from torchmat.errors import DataError, notice
    from torchmat.material_io import check_target

    try:
        check_target(out, force)
        return out
    except DataError as error:
        other = atomic.free_name(out, "new")
        notice(str(error), f"The result is in {other} instead")
        return other
