"""Photographs of a generated object under one view, as the files of an RTI capture: JPEG with noise and an .lp table."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from generated import directions

_BAND = 250  # rows that are made at a time
_NOISE = 1.5  # codes: the standard deviation of what a sensor adds


def rti_set(folder: Path, count: int, height: int, width: int, quality: int = 95, suffix: str = ".jpg") -> Path:
    """Write `count` photographs of height x width and ``lights.lp`` into `folder`, two at a time; return it.

    A relief of waves and grain, painted in patches, under a lobe of roughness 0.2: 8-bit codes in sRGB with noise.
    """
    folder.mkdir(parents=True, exist_ok=True)
    light = directions(count).astype(np.float32)
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(lambda n: _photograph(folder / f"photo_{n:03d}{suffix}", light[n], n, height, width, quality), range(count)))
    lines = [f"photo_{n:03d}{suffix} {x:.6f} {y:.6f} {z:.6f}" for n, (x, y, z) in enumerate(light)]
    (folder / "lights.lp").write_text("\n".join([str(count), *lines]) + "\n", encoding="utf-8")
    return folder


def _photograph(path: Path, light: np.ndarray, number: int, height: int, width: int, quality: int) -> None:
    noise = np.random.default_rng(number)
    codes = np.empty((height, width, 3), np.uint8)
    for top in range(0, height, _BAND):
        rows = slice(top, min(top + _BAND, height))
        values = _shaded(np.arange(rows.start, rows.stop, dtype=np.float32), np.arange(width, dtype=np.float32), light)
        shown = 255 * np.minimum(values, 1) ** np.float32(1 / 2.2)
        shown += _NOISE * noise.standard_normal(shown.shape, np.float32)
        codes[rows] = shown.clip(0, 255).round()
    write_codes(path, codes, quality)


def write_codes(path: Path, codes: np.ndarray, quality: int = 95) -> None:
    """Write 8-bit codes [h, w, 3] with OpenImageIO, without waiting for the disk as `torchmat.images.write_image` does."""
    import OpenImageIO as oiio

    height, width, channels = codes.shape
    spec = oiio.ImageSpec(width, height, channels, "uint8")
    spec.attribute("CompressionQuality", quality)
    out = oiio.ImageOutput.create(str(path))
    if not (out.open(str(path), spec) and out.write_image(codes) and out.close()):
        raise OSError(out.geterror())


def _shaded(y: np.ndarray, x: np.ndarray, light: np.ndarray) -> np.ndarray:
    """Return linear values [h, w, 3] of rows `y` and columns `x`: an albedo in patches, a lobe, and a relief's slopes."""
    y, x = y[:, None], x[None, :]
    normal = np.stack(np.broadcast_arrays(0.25 * np.sin(x / 37) + 0.1 * np.sin((x + y) / 5), 0.25 * np.cos(y / 53), np.float32(1)))
    normal /= np.linalg.norm(normal, axis=0)
    n_dot_l = np.maximum(0, np.tensordot(light, normal, 1))
    half = light + np.array([0, 0, 1], np.float32)
    lobe = np.maximum(0, np.tensordot(half / np.linalg.norm(half), normal, 1)) ** 50
    patch = np.stack([0.35 + 0.3 * np.sin(x / (211 + 30 * c)) * np.cos(y / (173 - 20 * c)) for c in range(3)], axis=-1)
    return (patch * n_dot_l[..., None] + 0.4 * (lobe * (light[2] > 0))[..., None]).astype(np.float32)
