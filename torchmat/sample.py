"""The sample that ships with the package, so that everything can be tried without data."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

import numpy as np

from torchmat.errors import DataError, check_option, message

FOLDER = "data"
_FILES = {"grid": "sample.zip", "random": "sample_random.zip"}


def sample_path(directions: str = "grid") -> Path:
    """Return the path of the embedded BTF: 25 views x 25 lights, 64 x 64 texels, path-traced, linear.

    Made by ``scripts/make_sample.py`` with Mitsuba 3.

    Args:
        directions: "grid", or "random" for 36 images of the same material whose light and view were both drawn at random
            between those of the grid, at least 4 degrees from each: to test a fit on, ``tm.fit(btf, model, test=...)``.
    """
    check_option("sample_path", "directions", directions, _FILES)
    path = Path(str(files("torchmat") / FOLDER / _FILES[directions]))
    if not path.is_file():
        step = f"Install the package again, or run scripts/make_sample.py{'' if directions == 'grid' else ' --random 36'}."
        raise DataError(message(str(path), "the embedded sample", "exist", "it is not there", step))
    return path


def sample_truth() -> dict[str, np.ndarray]:
    """Return what the embedded sample was rendered from.

    `height` [H, W] in texture widths with mean 0, unit `normal` [3, H, W], diffuse `albedo` [3, H, W], and
    `gloss_mask` [H, W]; row 0 at the top.
    """
    with np.load(sample_path().with_name("sample_truth.npz")) as truth:
        return {name: truth[name] for name in truth.files}
