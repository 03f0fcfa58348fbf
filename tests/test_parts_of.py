"""A part of a library without the rest, which stays as it is for whoever imports it."""

from __future__ import annotations

import subprocess
import sys

import pytest

_ALONE = """
import sys
import torch
from torchmat import colour, metrics

image = torch.rand(1, 3, 12, 12)
shown = colour.srgb_to_lab(colour.display(image))
errors = metrics.SampleErrors()
all_of = torch.ones(1, 1, 12, 12, dtype=torch.bool)
errors.add(image, image.flip(3), all_of, ~all_of, torch.ones(1, dtype=torch.bool))
assert not [name for name in sys.modules if name.partition(".")[0] == "kornia"]
import kornia
import kornia.augmentation
from kornia.metrics import ssim
assert torch.equal(kornia.color.rgb_to_lab(kornia.color.linear_rgb_to_rgb(image)), shown)
assert abs(float(ssim(*map(colour.display, (image, image.flip(3))), 11).mean()) - errors.report()["ssim"]) < 1e-6
assert kornia.geometry.transform.resize(image, (6, 6)).shape == (1, 3, 6, 6)
"""


def test_colours_and_similarity_are_had_alone_and_the_library_stays_whole():
    done = subprocess.run([sys.executable, "-c", _ALONE], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


_NEEDS_ITS_PACKAGE = """
import sys
sys.path.insert(0, {place!r})
from torchmat.parts_of import part_of
assert part_of("whole.part", "value") == 3
"""


def test_a_module_that_needs_its_package_is_imported_with_it(tmp_path):
    (tmp_path / "whole").mkdir()
    (tmp_path / "whole" / "__init__.py").write_text("three = 3\n")
    (tmp_path / "whole" / "part.py").write_text("from whole import three as value\n")
    subprocess.run([sys.executable, "-c", _NEEDS_ITS_PACKAGE.format(place=str(tmp_path))], check=True)


def test_what_is_not_there_is_said():
    from torchmat.parts_of import part_of

    with pytest.raises(ModuleNotFoundError, match="no_such_library"):
        part_of("no_such_library.part", "name")
    with pytest.raises(AttributeError):
        part_of("kornia.color", "no_such_name")
