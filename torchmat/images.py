"""Pixel files, through OpenImageIO; nothing else in the package opens an image."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from torchmat.errors import DataError, ShapeError, message

if TYPE_CHECKING:
    from OpenImageIO import ImageOutput, ImageSpec

IMAGE_SUFFIXES = frozenset({".jpg", ".jpeg", ".png", ".exr", ".tif", ".tiff", ".hdr", ".bmp", ".tga", ".ppm"})
_WRITABLE = {"uint8": "uint8", "uint16": "uint16", "float16": "half", "float32": "float"}


def _unreadable(path: str | Path, reason: str) -> DataError:
    reason = " ".join(reason.split()) or "the format is not recognised"
    step = "Check that the file is complete and that its suffix tells its format."
    return DataError(message(str(path), "the image", "be readable", reason.rstrip(".?"), step))


def _file_name(path: str | Path) -> str:
    """Return a path as OpenImageIO takes it: UTF-8, and whole (it would stop at a NUL and open another file)."""
    name = str(path)
    if "\0" in name or any("\ud800" <= letter <= "\udfff" for letter in name):
        raise DataError(message(ascii(name), "the file name", "be valid UTF-8", "it is not", "Rename the file."))
    return name


def _as_stored() -> ImageSpec:
    import OpenImageIO as oiio

    wish = oiio.ImageSpec()
    wish.attribute("oiio:UnassociatedAlpha", 1)  # or colours of PNG and TIFF would come multiplied by their alpha
    return wish


def read_image(path: str | Path) -> np.ndarray:
    """Return the pixels of an image file as [H, W, C] in the type they are stored in.

    uint8, uint16, float16 and float32 come through unchanged, anything else as float32. Raises DataError, which
    names the file, when it cannot be read to its end.
    """
    import OpenImageIO as oiio

    source = oiio.ImageInput.open(_file_name(path), _as_stored())
    if source is None:
        raise _unreadable(path, oiio.geterror())
    try:
        pixels = source.read_image(oiio.UNKNOWN)
        if source.has_error or pixels is None:
            raise _unreadable(path, source.geterror())
    finally:
        source.close()
    if pixels.ndim == 2:
        pixels = pixels[:, :, None]
    return pixels if pixels.dtype.name in _WRITABLE else pixels.astype(np.float32)


def write_image(path: str | Path, pixels: np.ndarray, channel_names: tuple[str, ...] | None = None) -> None:
    """Write [H, W, C] or [H, W] pixels; the suffix names the format, the array's type the bit depth.

    Written to disk before the function returns; raises DataError, which names the file, when that fails or when the
    format has no such bit depth or number of channels.
    """
    import OpenImageIO as oiio

    if pixels.ndim == 2:
        pixels = pixels[:, :, None]
    if pixels.ndim != 3 or pixels.dtype.name not in _WRITABLE:
        fact = f"it is {pixels.shape} of {pixels.dtype}"
        raise ShapeError(message(str(path), "pixels", f"be [H, W, C] of {', '.join(_WRITABLE)}", fact))
    height, width, channels = pixels.shape
    spec = oiio.ImageSpec(width, height, channels, _WRITABLE[pixels.dtype.name])
    if channel_names:
        spec.channelnames = channel_names
    if Path(path).suffix.lower() == ".exr":
        spec.attribute("compression", "zip")
    else:
        # Fast deflate: textures are written far more often than they are shipped over slow lines.
        spec.attribute("png:compressionLevel", 3)
        spec.attribute("oiio:UnassociatedAlpha", 1)
    target = oiio.ImageOutput.create(_file_name(path))
    if target is None:
        step = "Use .exr for float, .png for 8 or 16 bits."
        fact = oiio.geterror().rstrip(".")
        raise DataError(message(str(path), "the suffix", "name a writable image format", fact, step))
    opened = target.open(str(path), spec)
    if opened:
        _refuse_conversion(path, spec, target)
    written = opened and target.write_image(np.ascontiguousarray(pixels))
    closed = target.close()
    if not (written and closed):
        reason = " ".join((target.geterror() or oiio.geterror()).split()) or "writing failed"
        step = "Check that the folder exists, can be written to, and that the disk is not full."
        raise DataError(message(str(path), "the image", "be writable", reason.rstrip("."), step))


def _refuse_conversion(path: str | Path, wanted: ImageSpec, target: ImageOutput) -> None:
    """Raise DataError, and leave no file, when the format would store other types or channels than it was given."""
    stored = target.spec().format
    channels_kept = wanted.nchannels in (1, 3) or target.supports("alpha")  # JPEG drops the others without a word
    if stored == wanted.format and channels_kept:
        return
    target.close()
    Path(path).unlink(missing_ok=True)
    requirement = f"name a format for {wanted.nchannels} channels of {wanted.format}"
    fact = f"it has {stored}" if channels_kept else "it has no alpha"
    step = "Use .exr for float, .png for 8 or 16 bits."
    raise DataError(message(str(path), "the suffix", requirement, fact, step))
