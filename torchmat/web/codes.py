"""Codes as a page takes them: the names of their types, and their bytes; known without torch."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

TYPES = {"uint8": "u8", "uint16": "u16", "float16": "f16", "float32": "f32"}


def stacked_bytes(layers: Sequence[np.ndarray]) -> bytes:
    """Return layers [H, W, C] below each other as bytes, little endian."""
    pixels = np.stack(layers)
    return pixels.astype(pixels.dtype.newbyteorder("<"), copy=False).tobytes()
