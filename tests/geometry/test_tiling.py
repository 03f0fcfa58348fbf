"""Whether a surface repeats is asked of its images, alike in every command, unless the user says so."""

from __future__ import annotations

import json
import math

import pytest
import torch
from PIL import Image

import torchmat as tm
from torchmat.btf.tiling import btf_tiling, decided
from torchmat.cli import main
from torchmat.create import material_from_picture
from torchmat.errors import RangeError
from torchmat.geometry.tiling import Tiling, tiling_of

SIZE = 16
_ACROSS = torch.arange(SIZE, dtype=torch.float64)
RAMP = (_ACROSS / SIZE).expand(1, 3, SIZE, SIZE)
_WAVE = 0.5 + 0.4 * torch.sin(2 * math.pi * (_ACROSS + 0.5) / SIZE)
WAVES = (_WAVE[:, None] * _WAVE).expand(1, 3, SIZE, SIZE)


def head() -> torch.Tensor:
    """Return an object in the middle of even paper."""
    picture = torch.full((1, 3, SIZE, SIZE), 0.5, dtype=torch.float64)
    picture[..., 4:12, 4:12] = torch.rand(8, 8, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    return picture


def test_a_ramp_steps_back_by_all_that_it_has_risen():
    found = tiling_of(RAMP)
    assert not found.repeats and found.seam == pytest.approx(SIZE - 1) and found.border == pytest.approx(1)
    assert found.sentence() == "it does not repeat: the step across its border is 15.00 of the largest inside"
    assert not tiling_of(RAMP.mT).repeats


def test_waves_repeat_and_a_part_of_them_does_not():
    found = tiling_of(WAVES)
    assert found.repeats and found.seam == pytest.approx(1)  # the steepest step of a sine is that across its border
    assert found.sentence() == "it repeats: the step across its border is 1.00 of the largest inside"
    assert not tiling_of(WAVES[..., : SIZE // 2 + 2]).repeats


def test_an_object_before_a_background_does_not_repeat():
    found = tiling_of(head())
    assert not found.repeats and found.seam == 0 and found.border == 0
    assert found.sentence() == "it does not repeat: its border is even, as a background is (0.00 of what varies inside)"


def test_what_says_nothing_repeats():
    assert tiling_of(torch.full((1, 3, 4, 4), 0.3)) == Tiling(True, 0.0, 0.0)
    assert tiling_of(torch.rand(4, 3, 32, 32, generator=torch.Generator().manual_seed(0))).repeats
    assert tiling_of(torch.rand(1, 3, 1, 1)).repeats


def test_blocks_say_what_all_images_at_once_do():
    images = torch.rand(3, 3, 5, 7, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    assert tiling_of(images[n : n + 1] for n in range(3)) == pytest.approx(tiling_of(images))


def _btf(picture: torch.Tensor) -> tm.Btf:
    light = torch.nn.functional.normalize(torch.tensor([[0, 0, 1.0], [1, 0, 1], [-1, 0, 1], [0, 1, 1], [0, -1, 1], [1, 1, 2]]), dim=1)
    return tm.Btf.from_tensors(picture.float() * light[:, 2, None, None, None], light, torch.tensor([[0, 0, 1.0]]).expand(6, 3))


def test_the_sample_repeats_unless_the_user_says_otherwise():
    assert btf_tiling(tm.load_btf(tm.sample_path(), cache=False, progress=False)).repeats
    assert decided("fit", _btf(RAMP), True) == (True, None) and decided("fit", _btf(RAMP), "auto")[0] is False
    with pytest.raises(RangeError, match="fit: tiles must be true, false or auto; it is 'yes'"):
        decided("fit", _btf(RAMP), "yes")


@pytest.mark.parametrize(("picture", "repeats"), [(RAMP, False), (WAVES, True), (head(), False)])
def test_a_fit_asks_the_images_and_says_what_they_said(picture, repeats):
    result = tm.fit(_btf(picture), "texture", holdout=0, measure=False, progress=False)
    assert result.material.tiles is repeats and result.report["tiles"] is repeats
    assert result.report["tiling"] == tiling_of(_btf(picture).images(range(6))).report()
    given = tm.fit(_btf(picture), "texture", holdout=0, measure=False, progress=False, tiles=not repeats)
    assert given.material.tiles is not repeats and given.report["tiling"] is None


def test_a_picture_is_asked_too():
    assert not material_from_picture(RAMP[0], lobes=0, specular=()).tiles
    assert material_from_picture(WAVES[0], lobes=0, specular=()).tiles
    assert material_from_picture(RAMP[0], lobes=0, specular=(), tiles=True).tiles


@pytest.mark.parametrize(("given", "repeats", "said"), [((), False, True), (("--tiles", "True"), True, False)])
def test_the_commands_say_it_and_let_the_user_decide(given, repeats, said, tmp_path, capsys):
    codes = (RAMP[0] * 255).round().to(torch.uint8).permute(1, 2, 0).numpy()
    Image.fromarray(codes).save(tmp_path / "ramp.png")
    assert main(["create", str(tmp_path / "ramp.png"), "--out", str(tmp_path / "made"), "--no-pictures", *given]) == 0
    assert ("tiles      it does not repeat: the step across its border" in capsys.readouterr().out) is said
    assert json.loads((tmp_path / "made" / "manifest.json").read_text())["tiles"] is repeats
    assert main(["geometry", str(tmp_path / "ramp.png"), "--out", str(tmp_path / "relief"), *given]) == 0
    assert ("tiles      it does not repeat" in capsys.readouterr().out) is said
    manifest = next((tmp_path / "relief").glob("*.json")).read_text()
    assert f'"tiles": {str(repeats).lower()}' in manifest
