"""One photograph as linear light: its colours by its profile, its raw data without a curve, and what of it is clipped."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchmat.btf.decode import Decoder, resolve_encoding
from torchmat.btf.pixels import split_channels
from torchmat.capturing.raw import RAW_SUFFIXES, read_raw
from torchmat.channels import rgb_of_xyz
from torchmat.errors import DataError, message
from torchmat.icc import read_profile
from torchmat.images import Exif, read_exif, read_picture, read_tags, says_other_colours

_NEARLY_FULL = 2  # codes of 255 below the largest at which a pixel counts as clipped: compression makes them differ


class Developed(NamedTuple):
    """A photograph as it is shown: `linear` [3, H, W] float32 (Rec. 709, 1 is the largest value of the file), the pixels that
    are `clipped` [H, W] bool, the smallest `step` of its codes near 0, and `notes` on what was taken for what."""

    linear: Tensor
    clipped: Tensor
    step: float
    notes: tuple[str, ...]


def is_raw(path: str | Path) -> bool:
    """Tell whether a file is a camera's raw data, by its suffix."""
    return Path(path).suffix.lower() in RAW_SUFFIXES


def said_of(path: str | Path) -> Exif:
    """Return what a photograph, raw or not, says of how it was taken; raises DataError, which names the file."""
    return read_raw(path, pixels=False).exif if is_raw(path) else read_exif(path)


def exposure_of(exif: Exif) -> float | None:
    """Return seconds x ISO / 100 / f-number squared, to which the values of one radiance are proportional.

    None where no time is said. An aperture or a sensitivity that is not said is taken for one that is always the same.
    """
    if exif.exposure is None:
        return None
    return exif.exposure * (exif.iso or 100.0) / 100 / (exif.aperture or 1.0) ** 2


def develop(path: str | Path, encoding: str = "auto") -> Developed:
    """Return a photograph as linear light, turned upright, its colours converted to Rec. 709 by its ICC profile.

    Raw files are developed without a curve, without automatic brightness and with one white balance for all (`read_raw`).

    Args:
        path: an image file, or a camera's raw file (needs the extra `capture`).
        encoding: "srgb", "linear" or "xyz" where the file does not tell; "auto" follows its profile, else takes whole numbers for
            sRGB, and says so, and floating point for linear.

    Raises DataError, which names the file, when it cannot be read, or has a profile that cannot be converted.
    """
    if is_raw(path):
        found = read_raw(path)
        note = "raw data, developed in linear light under daylight balance; the white patch sets the balance"
        return Developed(torch.from_numpy(found.linear), torch.from_numpy(found.clipped), 1 / 65535, (note,))
    pixels, xyz = read_picture(path, by_profile=encoding == "auto")
    codes, _ = split_channels(pixels, str(path))
    notes = () if encoding != "auto" or xyz else _colour_notes(path, codes.dtype)
    if xyz or encoding == "xyz":
        codes, encoding = rgb_of_xyz(str(path), codes.astype(np.float32) if xyz else codes), "linear"
    codes = np.ascontiguousarray(codes)
    encoding = resolve_encoding(encoding, codes.dtype)
    linear = Decoder(codes.dtype, encoding, 1.0).into(codes, torch.empty(codes.shape))
    if not np.issubdtype(codes.dtype, np.integer):
        return Developed(_finite(path, linear), torch.zeros(codes.shape[1:], dtype=torch.bool), 0.0, notes)
    full = int(np.iinfo(codes.dtype).max)
    clipped = codes.max(axis=0) >= full - (_NEARLY_FULL * full // 255 if encoding == "srgb" else 0)
    return Developed(linear, torch.from_numpy(clipped), 1 / full / (12.92 if encoding == "srgb" else 1), notes)


def _finite(path: str | Path, linear: Tensor) -> Tensor:
    bad = int((~linear.isfinite()).sum())
    if bad:
        fact, step = f"{bad} values are NaN or Inf", "Repair the photograph."
        raise DataError(message(str(path), "the photograph", "be finite", fact, step))
    return linear


def _colour_notes(path: str | Path, dtype: np.dtype) -> tuple[str, ...]:
    profile = read_tags(path).profile
    if profile:
        known = read_profile(str(path), profile)
        return () if known.is_srgb else (f"colour profile {known.name!r}: converted to Rec. 709",)
    if not np.issubdtype(dtype, np.integer):
        return ("no colour profile: taken as linear Rec. 709",)
    if says_other_colours(path):
        step = "embed its profile, or photograph in sRGB"
        return (f"no colour profile, and its EXIF says that it is not sRGB (often Adobe RGB): taken as sRGB; {step}",)
    return ("no colour profile: taken as sRGB",)
