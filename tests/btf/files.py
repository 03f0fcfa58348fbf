"""Small measured BTFs as files, in every form that the readers take, and the sRGB curve written once more."""

from __future__ import annotations

import shutil
import zipfile
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

HEADER = "file,light_polar_deg,light_azimuth_deg,view_polar_deg,view_azimuth_deg"
# (light polar, light azimuth, view polar, view azimuth) in degrees of four images.
ANGLES = ((0, 0, 0, 0), (30, 90, 0, 0), (60, 180, 20, 45), (75, 270, 60, 315))
_TYPES = {"uint8": "uint8", "uint16": "uint16", "float16": "half", "float32": "float"}

WAYS = {"folder": lambda folder: folder, "zip": lambda folder: zipped(folder)}
either_way = pytest.mark.parametrize("pack", WAYS.values(), ids=WAYS)


def srgb_decoded(codes: np.ndarray) -> np.ndarray:
    """Return linear values of sRGB codes in [0, 1], float64, as IEC 61966-2-1 says."""
    codes = np.asarray(codes, dtype=np.float64)
    return np.where(codes <= 0.04045, codes / 12.92, ((np.maximum(codes, 0) + 0.055) / 1.055) ** 2.4)


def random_codes(seed: int, shape: tuple[int, ...] = (3, 4, 3), dtype: str = "uint8") -> np.ndarray:
    """Return pixels [H, W, C] with no clipped code among them; floating-point ones go up to 2."""
    random = np.random.default_rng(seed)
    if dtype.startswith("uint"):
        return random.integers(0, np.iinfo(dtype).max, shape).astype(dtype)
    return random.uniform(0, 2, shape).astype(dtype)


def put_image(path: Path, pixels: np.ndarray, **attributes: object) -> Path:
    """Write pixels [H, W, C] without the package's help; return the path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    height, width, channels = pixels.shape
    spec = oiio.ImageSpec(width, height, channels, _TYPES[pixels.dtype.name])
    spec.attribute("oiio:UnassociatedAlpha", 1)
    if channels == 2 and path.suffix == ".exr":
        spec.channelnames = ("Y", "A")
    for name, value in attributes.items():
        spec.attribute(name, value)
    target = oiio.ImageOutput.create(str(path))
    assert target.open(str(path), spec), target.geterror()
    assert target.write_image(np.ascontiguousarray(pixels)), target.geterror()
    assert target.close()
    return path


def get_image(path: Path) -> np.ndarray:
    """Read pixels [H, W, C] without the package's help."""
    source = oiio.ImageInput.open(str(path))
    pixels = source.read_image(oiio.UNKNOWN)
    source.close()
    return pixels.reshape(*pixels.shape[:2], -1)


def put_manifest(folder: Path, names: list[str] | None = None, header: str = HEADER, end: str = "\n") -> Path:
    """Write manifest.csv of the first images in ANGLES; `names` default to 0.png, 1.png ..."""
    names = [f"{number}.png" for number in range(len(ANGLES))] if names is None else names
    lines = [header] + [f"{name},{','.join(map(str, row))}" for name, row in zip(names, ANGLES, strict=False)]
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "manifest.csv").write_bytes((end.join(lines) + end).encode())
    return folder


def put_btf(folder: Path, dtype: str = "uint8", shape: tuple[int, ...] = (3, 4, 3), suffix: str = "png") -> Path:
    """Write a manifest and its four images (seeds 0 to 3); return the folder."""
    names = [f"{number}.{suffix}" for number in range(len(ANGLES))]
    for seed, name in enumerate(names):
        put_image(folder / name, random_codes(seed, shape, dtype))
    return put_manifest(folder, names)


def directions_of(polar_deg: float, azimuth_deg: float) -> list[float]:
    """Return x, y, z of angles in degrees."""
    polar, azimuth = np.deg2rad(polar_deg), np.deg2rad(azimuth_deg)
    return [np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)]


def zipped(folder: Path) -> Path:
    """Pack a folder, under its own name, beside it; return the archive."""
    return Path(shutil.make_archive(str(folder), "zip", folder.parent, folder.name))


def zip_of(path: Path, members: dict[str, bytes]) -> Path:
    """Write an archive with members of any name, sensible or not; return its path."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members.items():
            archive.writestr(zipfile.ZipInfo(name), data, zipfile.ZIP_DEFLATED)
    return path


def members_of(folder: Path) -> dict[str, bytes]:
    """Return the files of a folder by their relative names."""
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
