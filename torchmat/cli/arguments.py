"""How images are read: the arguments that several commands share."""

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
