"""The sample that ships with the package, so that everything can be tried without data."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

import numpy as np

from torchmat.errors import DataError, message

FOLDER = "data"


def sample_path() -> Path:
    """Return the path of the embedded BTF: 25 views x 25 lights, 64 x 64 texels, path-traced, linear.

    Made by ``scripts/make_sample.py`` with Mitsuba 3.
    """
    path = Path(str(files("torchmat") / FOLDER / "sample.zip"))
    if not path.is_file():
        step = "Install the package again, or run scripts/make_sample.py."
        raise DataError(message(str(path), "the embedded sample", "exist", "it is not there", step))
    return path


def sample_truth() -> dict[str, np.ndarray]:
    """Return what the embedded sample was rendered from.

    `height` [H, W] in texture widths with mean 0, unit `normal` [3, H, W], diffuse `albedo` [3, H, W], and
    `gloss_mask` [H, W]; row 0 at the top.
    """
    with np.load(sample_path().with_name("sample_truth.npz")) as truth:
        return {name: truth[name] for name in truth.files}
