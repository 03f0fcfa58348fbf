"""A camera's raw file made by hand: a DNG with the pattern RGGB, whose camera sees linear Rec. 709 itself."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

BLACK, WHITE = 64, 4064
# CIE XYZ (D65) to linear Rec. 709: the matrix of a camera that has these primaries.
_MATRIX = (3.2406, -1.5372, -0.4986, -0.9689, 1.8758, 0.0415, 0.0557, -0.2040, 1.0570)


def write_dng(path: Path, linear: np.ndarray, orientation: int = 1) -> Path:
    """Write linear colours [H, W, 3] as the photosites of one sensor, 1 at its white level; H and W are even."""
    height, width, _ = linear.shape
    sites = np.where(np.arange(height)[:, None] % 2 == 0, *(
        np.where(np.arange(width) % 2 == 0, linear[..., a], linear[..., b]) for a, b in ((0, 1), (1, 2))
    ))
    codes = np.round(np.clip(sites, 0, 1) * (WHITE - BLACK) + BLACK).astype("<u2")
    entries: list[tuple[int, int, list]] = [
        (254, 4, [0]), (256, 4, [width]), (257, 4, [height]), (258, 3, [16]), (259, 3, [1]), (262, 3, [32803]),
        (271, 2, [b"Simulated\0"]), (272, 2, [b"Rec 709\0"]), (273, 4, [0]), (274, 3, [orientation]), (277, 3, [1]), (278, 4, [height]),
        (279, 4, [codes.nbytes]), (284, 3, [1]), (33421, 3, [2, 2]), (33422, 1, [0, 1, 1, 2]), (33434, 5, [(1, 50)]), (33437, 5, [(28, 10)]),
        (37386, 5, [(35, 1)]), (50706, 1, [1, 4, 0, 0]),
        (50708, 2, [b"Simulated Rec 709\0"]), (50714, 3, [BLACK]), (50717, 4, [WHITE]),
        (50721, 10, [(round(value * 10000), 10000) for value in _MATRIX]), (50728, 5, [(1, 1)] * 3), (50778, 3, [21]),
    ]
    head = 8 + 2 + 12 * len(entries) + 4
    extra, directory = b"", b""
    for tag, kind, values in entries:
        code = {1: "B", 3: "H", 4: "I", 5: "II", 10: "ii"}.get(kind)
        data = values[0] if kind == 2 else b"".join(struct.pack("<" + code, *(v if isinstance(v, tuple) else (v,))) for v in values)
        count = len(data) if kind == 2 else len(values)
        if tag == 273:
            data = b"????"
        if len(data) > 4:
            directory += struct.pack("<HHII", tag, kind, count, head + len(extra))
            extra += data + b"\0" * (len(data) % 2)
        else:
            directory += struct.pack("<HHI", tag, kind, count) + data.ljust(4, b"\0")
    directory = directory.replace(b"????", struct.pack("<I", head + len(extra)))
    path.write_bytes(b"II*\0" + struct.pack("<IH", 8, len(entries)) + directory + b"\0" * 4 + extra + codes.tobytes())
    return path
