"""Small files of measured BRDFs, written by plain NumPy as their formats are described."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

TYPES = {"uint8": 1, "int8": 2, "uint16": 3, "int16": 4, "uint32": 5, "int32": 6, "float16": 9, "float32": 10}


def tensor_bytes(fields: dict[str, np.ndarray]) -> bytes:
    """Return a tensor file: magic, version, fields (name, dimensions, type, offset, shape), then the arrays."""
    heads = {name: 2 + len(name) + 2 + 1 + 8 + 8 * array.ndim for name, array in fields.items()}
    offset = 12 + 2 + 4 + sum(heads.values())
    head, body = b"tensor_file\0" + bytes((1, 0)) + struct.pack("<I", len(fields)), b""
    for name, array in fields.items():
        head += struct.pack("<H", len(name)) + name.encode()
        head += struct.pack(f"<HBQ{array.ndim}Q", array.ndim, TYPES[array.dtype.name], offset + len(body), *array.shape)
        body += array.tobytes()
    return head + body


def rgl_fields(azimuths: int = 1, turn: float = 2 * np.pi, seed: int = 0, size: int = 6, jacobian: int = 1) -> dict:
    """Return the fields of a made-up measured BRDF: random positive grids that close over a turn, as real ones do."""
    random = np.random.default_rng(seed)
    phi = np.linspace(-np.pi, -np.pi + turn, azimuths) if azimuths > 2 else np.arange(azimuths, dtype=float)
    polars = 4
    fields = {
        "description": np.frombuffer(b"Made up", np.uint8),
        "phi_i": phi, "theta_i": np.array([0.0, 0.4, 0.9, np.pi / 2]),
        "sigma": random.uniform(0.4, 1.0, (2 if azimuths <= 2 else 5, 7)),
        "ndf": random.uniform(0.2, 2.0, (2 if azimuths <= 2 else 5, 8)),
        "vndf": random.uniform(0.2, 1.0, (azimuths, polars, size, size + 1)),
        "luminance": random.uniform(0.1, 1.0, (azimuths, polars, 4, 4)),
        "rgb": random.uniform(0.1, 1.0, (azimuths, polars, 3, 4, 4)),
        "jacobian": np.array([jacobian], np.uint8),
    }
    for name in ("sigma", "ndf", "vndf", "rgb"):
        fields[name][..., -1, :] = fields[name][..., 0, :]
    if azimuths <= 2:
        fields["sigma"][:] = fields["sigma"][:1]
    elif turn > 6:
        for name in ("vndf", "rgb"):
            fields[name][-1] = fields[name][0]
    return {name: array if array.dtype == np.uint8 else array.astype(np.float32) for name, array in fields.items()}


def write_tensor_file(path: Path, fields: dict[str, np.ndarray]) -> Path:
    """Write a tensor file and return its path."""
    path.write_bytes(tensor_bytes(fields))
    return path


def merl_bytes(table: np.ndarray) -> bytes:
    """Return a MERL file of a table [3, half, difference, azimuth] of stored numbers (before the scales)."""
    return struct.pack("<3i", *table.shape[1:]) + np.ascontiguousarray(table, "<f8").tobytes()
