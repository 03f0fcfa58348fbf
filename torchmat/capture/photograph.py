"""One photograph as linear light, with what its file says of the camera, of the exposure and of its colours."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch

from torchmat.btf.decode import Decoder, resolve_encoding
from torchmat.btf.pixels import split_channels
from torchmat.capture.raw import RAW_SUFFIXES, read_raw
from torchmat.channels import rgb_of_xyz
from torchmat.errors import DataError, message
from torchmat.icc import read_profile
from torchmat.images import read_head, read_picture, read_tags

_NEARLY_FULL = 2  # codes of 255 below the largest at which a pixel counts as clipped: compression makes them differ
_UNCALIBRATED = 65535  # EXIF's colour space of what is not sRGB


@dataclass(frozen=True)
class Facts:
    """What the file of a photograph says: `size` (width, height) upright, the `camera`, `focal` length and that of a 35 mm
    camera (`focal_35`) in millimetres, exposure `seconds`, `f_number` and `iso`. None is what it does not say."""

    size: tuple[int, int]
    camera: str | None = None
    focal: float | None = None
    focal_35: float | None = None
    seconds: float | None = None
    f_number: float | None = None
    iso: float | None = None

    @property
    def exposure(self) -> float | None:
        """Seconds x ISO / 100 / f-number squared, proportional to the values of one radiance; None without seconds.

        An aperture or an ISO that is not said is taken for one that is always the same.
        """
        if self.seconds is None:
            return None
        return self.seconds * (self.iso or 100.0) / 100 / (self.f_number or 1.0) ** 2


@dataclass(frozen=True, eq=False)
class Photograph:
    """A photograph: `linear` [H, W, 3] float32 (Rec. 709, 1 is the largest value of the file), the pixels that are `clipped`
    [H, W] bool, the `facts` of its file, and `notes` on what was taken for what. `quantum` is the smallest step near 0."""

    name: str
    linear: np.ndarray
    clipped: np.ndarray
    facts: Facts
    quantum: float = 0.0
    notes: tuple[str, ...] = field(default=())


def is_raw(path: str | Path) -> bool:
    """Tell whether a file is a camera's raw data, by its suffix."""
    return Path(path).suffix.lower() in RAW_SUFFIXES


def read_facts(path: str | Path) -> Facts:
    """Return what a photograph's file says, without its pixels; raises DataError, which names the file."""
    if is_raw(path):
        return _raw_facts(path, pixels=False)[0]
    size, said = read_head(path)
    return _facts(size, said)


def _facts(size: tuple[int, int], said: dict[str, Any]) -> Facts:
    maker, model = (str(said.get(name) or "").strip("\0 ") for name in ("Make", "Model"))
    camera = model if model.casefold().startswith(maker.casefold()) else f"{maker} {model}"
    iso = _positive(said.get("Exif:PhotographicSensitivity")) or _positive(said.get("Exif:ISOSpeedRatings"))
    return Facts(
        size, camera.strip() or None, _positive(said.get("Exif:FocalLength")), _positive(said.get("Exif:FocalLengthIn35mmFilm")),
        _positive(said.get("ExposureTime")), _positive(said.get("FNumber")), iso,
    )


def _positive(value: Any) -> float | None:
    """Return a number above 0, None for what is none: EXIF writes 0 and 0/0 for what is not known."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        return None
    return number if 0 < number < math.inf else None


def read_photograph(path: str | Path, encoding: str = "auto") -> Photograph:
    """Return a photograph as linear light, turned upright, its colours converted to Rec. 709 by its ICC profile.

    Raw files are developed without a curve, without automatic brightness and with one white balance for all (`read_raw`).

    Args:
        path: an image file, or a camera's raw file (needs the extra `capture`).
        encoding: "srgb" or "linear" where the file does not tell; "auto" follows its profile, else takes whole numbers for
            sRGB, and says so, and floating point for linear.

    Raises DataError, which names the file, when it cannot be read, or has a profile that cannot be converted.
    """
    if is_raw(path):
        facts, developed, clipped = _raw_facts(path, pixels=True)
        assert developed is not None and clipped is not None
        note = "raw data, developed in linear light under daylight balance; the white patch sets the balance"
        return Photograph(Path(path).name, developed, clipped, facts, 1 / 65535, (note,))
    pixels, xyz = read_picture(path, by_profile=encoding == "auto")
    codes, _ = split_channels(pixels, str(path))
    size, said = read_head(path)
    notes = () if encoding != "auto" or xyz else _colour_notes(path, codes.dtype, said)
    if xyz:
        codes, encoding = rgb_of_xyz(str(path), codes.astype(np.float32)), "linear"
    codes = np.ascontiguousarray(codes.transpose(1, 2, 0))
    encoding = resolve_encoding(encoding, codes.dtype)
    linear = Decoder(codes.dtype, encoding, 1.0).into(codes, torch.empty(codes.shape)).numpy()
    if not np.issubdtype(codes.dtype, np.integer):
        return Photograph(Path(path).name, *_finite(path, linear), _facts(size, said), 0.0, notes)
    full = int(np.iinfo(codes.dtype).max)
    clipped = codes.max(axis=2) >= full - (_NEARLY_FULL * full // 255 if encoding == "srgb" else 0)
    step = 1 / full / (12.92 if encoding == "srgb" else 1)
    return Photograph(Path(path).name, linear, clipped, _facts(size, said), step, notes)


def _finite(path: str | Path, linear: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    bad = int((~np.isfinite(linear)).sum())
    if bad:
        fact, step = f"{bad} values are NaN or Inf", "Repair the photograph."
        raise DataError(message(str(path), "the photograph", "be finite", fact, step))
    return linear, np.zeros(linear.shape[:2], bool)


def _colour_notes(path: str | Path, dtype: np.dtype, said: dict[str, Any]) -> tuple[str, ...]:
    profile = read_tags(path).profile
    if profile:
        known = read_profile(str(path), profile)
        return () if known.is_srgb else (f"colour profile {known.name!r}: converted to Rec. 709",)
    if not np.issubdtype(dtype, np.integer):
        return ("no colour profile: taken as linear Rec. 709",)
    if said.get("Exif:ColorSpace") == _UNCALIBRATED:
        step = "embed its profile, or photograph in sRGB"
        return (f"no colour profile, and its EXIF says that it is not sRGB (often Adobe RGB): taken as sRGB; {step}",)
    return ("no colour profile: taken as sRGB",)


def _raw_facts(path: str | Path, pixels: bool) -> tuple[Facts, np.ndarray | None, np.ndarray | None]:
    found = read_raw(path, pixels)
    facts = Facts(found.size, None, *(_positive(one) for one in (found.focal, None, found.seconds, found.f_number, found.iso)))
    return facts, found.linear, found.clipped
