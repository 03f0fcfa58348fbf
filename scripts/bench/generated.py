"""Generated BTFs of any size, as raw codes that are mapped into memory."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import torch

from torchmat.btf.btf import Btf, summarise
from torchmat.btf.decode import Decoder


@contextmanager
def large_btf(size: int, lights: int, views: int) -> Iterator[Path]:
    """Yield a folder with the raw codes of a generated 8-bit BTF: bumpy Lambert and a lobe, sRGB-encoded."""
    with tempfile.TemporaryDirectory(dir=_memory(3 * size * size * lights * views)) as folder:
        path = Path(folder) / "pixels.raw"
        light, view = directions(lights), directions(views)
        light, view = np.tile(light, (views, 1)), np.repeat(view, lights, axis=0)
        np.savez(Path(folder) / "directions.npz", light=light, view=view)
        random = np.random.default_rng(0)
        normal = np.stack((*random.uniform(-0.2, 0.2, (2, size, size)), np.ones((size, size)))).astype(np.float32)
        normal /= np.linalg.norm(normal, axis=0)
        albedo = random.uniform(0.2, 0.7, (3, size, size)).astype(np.float32)
        pixels = np.memmap(path, np.uint8, "w+", shape=(len(light), 3, size, size))
        for first in range(0, len(light), 32):
            rows = slice(first, first + 32)
            half = light[rows] + view[rows]
            half /= np.linalg.norm(half, axis=1, keepdims=True)
            n_dot_l = np.maximum(0, np.tensordot(light[rows].astype(np.float32), normal, 1))
            n_dot_h = np.maximum(0, np.tensordot(half.astype(np.float32), normal, 1))
            values = albedo * n_dot_l[:, None] + 0.2 * n_dot_h[:, None] ** 16
            pixels[rows] = (np.minimum(values, 0.99) ** (1 / 2.2) * 255).round()
        pixels.flush()
        del pixels
        yield Path(folder)


def _memory(size: int) -> str | None:
    """Return a folder that is held in memory and has room for `size` bytes: what the disk does is not measured here."""
    place = Path("/dev/shm")
    return str(place) if place.is_dir() and shutil.disk_usage(place).free > 4 * size else None


def directions(count: int) -> np.ndarray:
    """Return unit vectors [count, 3] that spread evenly from the pole to 15 degrees above the horizon."""
    golden = np.pi * (3 - 5**0.5)
    z = 1 - (np.arange(count) + 0.5) / count * 0.75
    radius, azimuth = np.sqrt(1 - z * z), golden * np.arange(count)
    return np.stack((radius * np.cos(azimuth), radius * np.sin(azimuth), z), axis=1)


def open_large(folder: str, size: int) -> Btf:
    """Open what `_large_btf` wrote, mapped into memory."""
    with np.load(Path(folder) / "directions.npz") as table:
        light, view = torch.from_numpy(table["light"]).float(), torch.from_numpy(table["view"]).float()
    pixels = np.memmap(Path(folder) / "pixels.raw", np.uint8, "c", shape=(len(light), 3, size, size))
    few = summarise(np.asarray(pixels[:1]), np.zeros((1, size, size), np.uint8))
    counts = np.zeros(len(light), dtype=np.int64)
    store = type(few)(pixels, None, counts, counts, counts.astype(np.uint8), counts.astype(np.uint8) + 255)
    return Btf(store, light, view, Decoder(np.dtype(np.uint8), "srgb", 1.0))
