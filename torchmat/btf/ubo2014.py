"""Bonn's UBO2014 ``.btf`` (DFMF): decoded sample by sample for the texels that are asked for, never whole.

A file of 400 x 400 texels under 151 lights and views is 200 MB of factors, which stay mapped, and 44 GB of images. A crop
decodes no other texels.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch

from torchmat import frames
from torchmat.btf.dfmf import SIGNATURE, Dfmf, decoded, named_other, read_dfmf
from torchmat.btf.listing import Listing
from torchmat.btf.reader import Pixels, Reader
from torchmat.btf.source import File
from torchmat.errors import DataError, message

_LONGEST = 16  # bytes that tell one file from another
_ROUNDED = 1e-6
_BLOCK = 4_000_000  # values that are decoded at a time


def _sniff(source: File) -> bool:
    start = source.start(_LONGEST)
    return start.startswith(SIGNATURE) or named_other(start) is not None


def _read(source: File) -> Dfmf:
    other = named_other(source.start(_LONGEST))
    if other is not None:
        step = "Export it as DFMF, or its images with a manifest.csv."
        raise DataError(message(str(source.path), "the BTF of Bonn", "be a DFMF (UBO2014)", f"it is {other}", step))
    if not source.start(_LONGEST).startswith(SIGNATURE):
        fact = f"it begins with {source.start(10)!r}"
        raise DataError(message(str(source.path), "the file", f"begin with {SIGNATURE.decode()}", fact, "Leave `kind` out."))
    return read_dfmf(source.content)


def _listing(source: File) -> Listing:
    found = _read(source)
    light, view = (frames.from_polar(*torch.from_numpy(angles).T) for angles in (found.light, found.view))
    light[:, 2] = torch.where(light[:, 2].abs() < _ROUNDED, 0.0, light[:, 2])  # an angle of 90 degrees, in single precision
    angles = np.degrees(np.concatenate([found.view, found.light], axis=1)).tolist()
    names = tuple("view {:.2f} {:.2f} light {:.2f} {:.2f}".format(*one) for one in angles)
    return Listing("ubo2014", names, light, view, notes=tuple(_notes(found)))


def _notes(found: Dfmf) -> Iterator[str]:
    ranks = ", ".join(str(channel.samples.shape[1]) for channel in found.channels)
    yield f"a factorisation of {ranks} components; what they leave out of the photographs is not in the file"
    yield "values hold the cosine of the light" if found.cosine else "values are multiplied by the cosine of the light"
    if any(abs(scale - 1) > 1e-6 for scale in found.rgb_scale):
        scales = ", ".join(f"{scale:g}" for scale in found.rgb_scale)
        yield f"its scale of RGB, {scales}, is taken as applied; --exposure divides by a factor"
    if found.rotations > 1:
        yield f"warning: its {found.rotations} rotations of local frames are not followed"


def _pixels(source: File, listing: Listing) -> Pixels:
    found = _read(source)
    # A light on the horizon or below lights nothing.
    cosine = np.ones(len(found.light), np.float32) if found.cosine else np.cos(found.light[:, 0]).clip(0).astype(np.float32)

    def read(samples: range, rows: slice, columns: slice) -> Iterator[np.ndarray]:
        size = (rows.stop - rows.start, columns.stop - columns.start)
        texels = [_window(found, channel.texels, rows, columns) for channel in found.channels]
        step = max(1, _BLOCK // (size[0] * size[1]))
        for first in range(samples.start, samples.stop, step):
            part = slice(first, min(first + step, samples.stop))
            yield from _images(found, part, texels, cosine[part]).reshape(-1, *size, 3)

    return Pixels((found.height, found.width, 3), np.dtype(np.float32), read)


def _images(found: Dfmf, part: slice, texels: list[np.ndarray], cosine: np.ndarray) -> np.ndarray:
    """Return images [n, h * w, 3] of some samples at chosen texels, float32."""
    with np.errstate(all="ignore"):  # what is not finite is found, and said, as in every image
        samples = [np.asarray(channel.samples[part], np.float32) for channel in found.channels]
        products = [one @ window.T for one, window in zip(samples, texels, strict=True)]
        return np.stack(decoded(found.model, products), axis=-1) * cosine[:, None, None]


def _window(found: Dfmf, texels: np.ndarray, rows: slice, columns: slice) -> np.ndarray:
    """Return the factors [h * w, K] of a window, float32."""
    grid = texels.reshape(found.height, found.width, -1)
    with np.errstate(all="ignore"):
        return np.ascontiguousarray(grid[rows, columns], np.float32).reshape(-1, grid.shape[2])


UBO2014 = Reader(
    "ubo2014", "Bonn's UBO2014 `.btf` (DFMF), decoded for the texels that are asked for", _sniff, _listing, _pixels,
    one_file=True,
)
