"""Files of UBO2014 written from the format's description, and what they hold by a decoder of plain loops."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np

EPSILON = 1e-5
HALF, SINGLE, DOUBLE = 2, 4, 8
_KINDS = {HALF: "<f2", SINGLE: "<f4", DOUBLE: "<f8"}


def grid(lights: int, views: int) -> tuple[np.ndarray, np.ndarray]:
    """Return polar angle and azimuth in radians of lights [V, L, 2] and of views [V, 2], none of them alike."""
    random = np.random.default_rng(5)
    light = np.stack([random.uniform(0, 1.3, lights), 2 * np.pi * np.arange(lights) / lights], axis=1)
    view = np.stack([random.uniform(0, 1.2, views), 2 * np.pi * (np.arange(views) + 0.3) / views], axis=1)
    return np.broadcast_to(light, (views, lights, 2)), view


def some_images(lights: int = 5, views: int = 3, height: int = 4, width: int = 6) -> np.ndarray:
    """Return images [V * L, H, W, 3], no row, column, light, view or channel of which is like another."""
    return np.random.default_rng(1).uniform(0.05, 0.9, (views * lights, height, width, 3))


def decorrelated(images: np.ndarray, model: int) -> np.ndarray:
    """Return the channels [3, n, H, W] that a file stores."""
    red, green, blue = np.moveaxis(images, 3, 0)
    if model == 0:
        return np.stack([red, green, blue])
    if model == 12:
        return np.log(np.stack([red, green, blue]) + EPSILON)
    luminance = 0.299 * red + 0.587 * green + 0.114 * blue
    scale = luminance + EPSILON
    return np.stack([np.log(scale), (blue - luminance) / 2.03211 / scale, (red - luminance) / 1.13983 / scale])


@dataclass(frozen=True)
class Settings:
    """What may differ from file to file."""

    model: int = 0
    version: int = 4
    scalar: int = DOUBLE
    cosine: bool = True
    by_images: bool = False  # rows are texels instead of samples
    components: int | None = None
    channels: int = 3
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    rotations: int = 1
    signature: bytes = b"!DFMF08FCR"


def factors(matrix: np.ndarray, components: int | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return S, U and S V of a matrix [rows, columns]."""
    u, s, v = np.linalg.svd(matrix, full_matrices=False)
    kept = slice(0, components)
    return s[kept], u[:, kept], v[kept].T * s[kept]


def header(how: Settings) -> bytes:
    texts = b"".join(text.ljust(80, b"\0") for text in (b"Dome II", b"a sensor", b"LEDs"))
    body = struct.pack("<I", how.version) + texts + struct.pack("<4f", 12.5, *how.scale)
    body += struct.pack("<I", how.cosine) if how.version > 1 else b""
    body += struct.pack("<I", 6) + b"<xml/>" if how.version > 2 else b""
    if how.version > 3:
        body += struct.pack("<I", how.channels) + b"".join(struct.pack("<I", 1) + name.encode() for name in "RGBX"[: how.channels])
    return how.signature + struct.pack("<I", len(body) + 4) + body


def dfmf_bytes(images: np.ndarray, light: np.ndarray, view: np.ndarray, how: Settings = Settings()) -> bytes:
    """Return the bytes of a file of images [V * L, H, W, 3] under lights [V, L, 2] and views [V, 2], lights running fastest."""
    count, height, width = images.shape[:3]
    found = [header(how), struct.pack("<I", len(view))]
    for angles, lights in zip(view, light, strict=True):
        found += [struct.pack("<2fI", *angles, len(lights)), np.ascontiguousarray(lights, "<f4").tobytes()]
    found += [struct.pack("<3I", width, height, how.rotations), np.tile(np.eye(3, dtype="<f4"), (how.rotations, 1)).tobytes()]
    found.append(struct.pack("<Ii12f", how.components or 1, how.model, *(0.0,) * 3, *np.eye(3).ravel()))
    for channel in decorrelated(images, how.model)[: how.channels]:
        matrix = channel.reshape(count, height * width)
        parts = factors(matrix.T if how.by_images else matrix, how.components)
        rows, columns = len(parts[1]), len(parts[2])
        found.append(struct.pack("<B3I", how.scalar, len(parts[0]), rows, columns))
        found += [np.ascontiguousarray(part, _KINDS[how.scalar]).tobytes() for part in parts]
    return b"".join(found)


def put_dfmf(path: Path, images: np.ndarray, light: np.ndarray, view: np.ndarray, how: Settings = Settings()) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(dfmf_bytes(images, light, view, how))
    return path


def put_small(path: Path, **settings) -> Path:
    """Write a file of 4 x 6 texels under 5 lights and 3 views."""
    return put_dfmf(path, some_images(), *grid(5, 3), Settings(**settings))


def put_large(path: Path, height: int, width: int, lights: int, views: int, components: int) -> Path:
    """Write a file whose images would not fit into memory: half-precision factors of noise, written piece by piece."""
    light, view = grid(lights, views)
    random, how = np.random.default_rng(0), Settings(scalar=HALF, cosine=False)
    with open(path, "wb") as stream:
        stream.write(header(how) + struct.pack("<I", views))
        for angles, row in zip(view, light, strict=True):
            stream.write(struct.pack("<2fI", *angles, lights) + np.ascontiguousarray(row, "<f4").tobytes())
        stream.write(struct.pack("<3I", width, height, 0) + struct.pack("<Ii12f", components, 0, *(0.0,) * 12))
        for _ in range(3):
            stream.write(struct.pack("<B3I", HALF, components, lights * views, height * width))
            stream.write(np.ones(components, "<f2").tobytes())
            for count in (lights * views, height * width):
                stream.write(random.random((count, components), np.float32).astype("<f2").tobytes())
    return path


def plain(data: bytes) -> np.ndarray:
    """Return the images [V * L, H, W, 3] that bytes hold, before any cosine, number by number as the description says."""
    place = 10 + struct.unpack_from("<I", data, 10)[0]
    (views,) = struct.unpack_from("<I", data, place)
    place += 4
    samples = 0
    for _ in range(views):
        (lights,) = struct.unpack_from("<I", data, place + 8)
        place, samples = place + 12 + 8 * lights, samples + lights
    width, height, rotations = struct.unpack_from("<3I", data, place)
    place += 12 + 36 * rotations
    model = struct.unpack_from("<Ii", data, place)[1]
    place += 8 + 12 + 36
    stored = np.zeros((3, samples, height, width))
    for channel in range(3):
        size, kept, rows, columns = struct.unpack_from("<B3I", data, place)
        place += 13 + size * kept
        u = np.frombuffer(data, _KINDS[size], rows * kept, place).reshape(rows, kept).astype(float)
        place += size * rows * kept
        sv = np.frombuffer(data, _KINDS[size], columns * kept, place).reshape(columns, kept).astype(float)
        place += size * columns * kept
        for sample in range(samples):
            for y in range(height):
                for x in range(width):
                    row, column = (sample, x + width * y) if rows == samples else (x + width * y, sample)
                    stored[channel, sample, y, x] = sum(u[row, k] * sv[column, k] for k in range(kept))
    assert place == len(data)
    images = np.zeros((samples, height, width, 3))
    for sample, y, x in np.ndindex(samples, height, width):
        a, b, c = stored[:, sample, y, x]
        if model == 11:
            luminance = np.exp(a) - EPSILON
            u, v = b * (luminance + EPSILON), c * (luminance + EPSILON)
            a, b, c = luminance + 1.13983 * v, luminance - 0.39465 * u - 0.5806 * v, luminance + 2.03211 * u
        elif model == 12:
            a, b, c = np.exp([a, b, c]) - EPSILON
        images[sample, y, x] = a, b, c
    return images
