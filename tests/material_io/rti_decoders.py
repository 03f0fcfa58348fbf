"""Decoders of RTI files, written from the formats' descriptions: codes of a screen [H, W, 3] under a light, from the bytes alone."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
from PIL import Image


def polynomial(x, y):
    """HP's order."""
    return np.array([x * x, y * y, x * y, x, y, 1])


def relight_polynomial(x, y):
    return np.array([1, x, y, x * x, x * y, y * y])


def harmonics(x, y):
    """RTIBuilder's, relight's and OpenLIME's 16 terms."""
    c, phi, pi = math.sqrt(1 - x * x - y * y), math.atan2(y, x), math.pi
    root = math.sqrt(c - c * c)
    return np.array([
        1 / math.sqrt(2 * pi),
        math.sqrt(6 / pi) * math.cos(phi) * root,
        math.sqrt(3 / (2 * pi)) * (2 * c - 1),
        math.sqrt(6 / pi) * root * math.sin(phi),
        math.sqrt(30 / pi) * math.cos(2 * phi) * (c * c - c),
        math.sqrt(30 / pi) * math.cos(phi) * (2 * c - 1) * root,
        math.sqrt(5 / (2 * pi)) * (1 - 6 * c + 6 * c * c),
        math.sqrt(30 / pi) * (2 * c - 1) * root * math.sin(phi),
        math.sqrt(30 / pi) * (c * c - c) * math.sin(2 * phi),
        2 * math.sqrt(35 / pi) * math.cos(3 * phi) * (c - c * c) ** 1.5,
        math.sqrt(210 / pi) * math.cos(2 * phi) * (2 * c - 1) * (c * c - c),
        2 * math.sqrt(21 / pi) * math.cos(phi) * root * (1 - 5 * c + 5 * c * c),
        math.sqrt(7 / (2 * pi)) * (-1 + 12 * c - 30 * c * c + 20 * c**3),
        2 * math.sqrt(21 / pi) * root * (1 - 5 * c + 5 * c * c) * math.sin(phi),
        math.sqrt(210 / pi) * (2 * c - 1) * (c * c - c) * math.sin(2 * phi),
        2 * math.sqrt(35 / pi) * (c - c * c) ** 1.5 * math.sin(3 * phi),
    ])


def lit_ptm(path: Path, x: float, y: float) -> np.ndarray:
    lines, place = [], 0
    data = path.read_bytes()
    for _ in range(6):
        end = data.index(b"\n", place)
        lines.append(data[place:end].decode())
        place = end + 1
    assert lines[0] == "PTM_1.2"
    width, height = int(lines[2]), int(lines[3])
    scale, bias = (np.array(line.split(), float) for line in lines[4:6])
    assert len(scale) == len(bias) == 6 and all(word.lstrip("-").isdigit() for word in lines[5].split())
    body = np.frombuffer(data[place:], np.uint8).astype(float)
    if lines[1] == "PTM_FORMAT_RGB":
        planes = body.reshape(3, height, width, 6)
        found = ((planes - bias) * scale) @ polynomial(x, y)
        return found.transpose(1, 2, 0)[::-1] / 255
    assert lines[1] == "PTM_FORMAT_LRGB"
    luminance = ((body[: 6 * width * height].reshape(height, width, 6) - bias) * scale) @ polynomial(x, y)
    return (luminance[..., None] * body[6 * width * height :].reshape(height, width, 3) / 255)[::-1] / 255


def lit_rti(path: Path, x: float, y: float) -> np.ndarray:
    data, place, lines = path.read_bytes(), 0, []
    for _ in range(4):
        end = data.index(b"\n", place)
        lines.append(data[place:end].decode())
        place = end + 1
    assert lines[:2] == ["#HSH1.2", "3"]
    width, height, _ = map(int, lines[2].split())
    terms = int(lines[3].split()[0])
    scale, offset = np.frombuffer(data[place : place + 8 * terms], "<f4").astype(float).reshape(2, terms)
    codes = np.frombuffer(data[place + 8 * terms :], np.uint8).astype(float).reshape(height, width, 3, terms)
    return (codes / 255 * scale + offset) @ harmonics(x, y)[:terms]


def lit_relight(folder: Path, x: float, y: float) -> np.ndarray:
    info = json.loads((folder / "info.json").read_text())
    count = info["nplanes"] // 3
    planes = [np.asarray(Image.open(folder / f"plane_{k}.{info['format']}")).astype(float) / 255 for k in range(count)]
    scale, bias = (np.array(info["materials"][0][name]).reshape(count, 3) for name in ("scale", "bias"))
    values = [(plane - bias[k]) * scale[k] for k, plane in enumerate(planes)]
    weight = relight_polynomial(x, y) if info["type"] == "ptm" else harmonics(x, y)
    if info["colorspace"] == "rgb":
        return sum(weight[k] * value for k, value in enumerate(values))
    luminance = sum(value @ weight[3 * k : 3 * k + 3] for k, value in enumerate(values[1:]))
    return luminance[..., None] * values[0]
