"""Configs and scenes that ship with the package: in an installed one inside it, in a checkout beside it."""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent


def shipped_folder() -> Path:
    """Return the folder `configs`."""
    inside = _PACKAGE / "configs"
    return inside if inside.is_dir() else _PACKAGE.parent / "configs"


def shipped_names(kind: str = "") -> list[str]:
    """Return the names of the files that ship: of configs, or with `kind` "scenes" of scenes."""
    return sorted(path.name for path in (shipped_folder() / kind).glob("*.toml"))


def find_file(name: str | Path, kind: str = "", folder: Path = Path()) -> Path:
    """Return the path of a file: in `folder`, or where it has none of that name, the shipped one that is called so."""
    path = folder / name
    return shipped_folder() / kind / name if str(name) in shipped_names(kind) and not path.exists() else path
