"""A light below the surface is refused in a file, and said of what is given in memory or on the command line."""

from __future__ import annotations

import torch

from torchmat import Btf
from torchmat.cli import main

_UP, _DOWN = (0.0, 0.0, 1.0), (0.0, 0.6, -0.8)


def test_images_in_memory_say_how_many_lights_lie_below():
    images = torch.rand(4, 3, 2, 2, generator=torch.Generator().manual_seed(0))
    light = torch.tensor([_UP, _DOWN, _UP, _DOWN])
    btf = Btf.from_tensors(images, light, torch.tensor([_UP] * 4))
    assert btf.source.notes == ("warning: 2 of 4 lights are below the surface, first that of sample 1",)
    assert Btf.from_tensors(images, torch.tensor([_UP] * 4), torch.tensor([_UP] * 4)).source.notes == ()


def test_a_patch_that_is_lit_from_below_says_so(tmp_path, capsys):
    from torchmat.sample import sample_path
    from torchmat import fit, load_btf, save_material

    btf = load_btf(sample_path(), cache=False, crop=(0, 0, 4, 4), progress=False)
    save_material(fit(btf, "texture", measure=False, progress=False).material, tmp_path / "made")
    light = ["--light", "0", "0.6", "-0.8", "--light", "0", "0", "1"]
    assert main(["render", str(tmp_path / "made"), "--mesh", "patch", "--size", "8", *light]) == 0
    assert "warning    1 of 2 lights below the surface of the patch, first --light 0 0.6 -0.8\n" in capsys.readouterr().out
