"""Exposure brackets: merged values against the light that they were made of, wrong exposures and moved frames named."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tests.btf.files import put_image

from torchmat.capturing.brackets import bracket_groups, merge_bracket, merge_photographs
from torchmat.capturing.develop import Developed
from torchmat.capturing.photographs import photograph
from torchmat.errors import DataError, RangeError

pytest.importorskip("cv2")
NAMES = ["short.jpg", "middle.jpg", "long.jpg"]


def light(seed=0):
    """Blots of light [3, 120, 160] from 0.004 to 40, of one colour."""
    blots = torch.rand(1, 1, 16, 20, generator=torch.Generator().manual_seed(seed))
    smooth = torch.nn.functional.interpolate(blots, (120, 160), mode="bicubic", align_corners=False)[0].clamp(0, 1)
    return 0.004 * 10 ** (4 * smooth) * torch.tensor([1.0, 0.8, 0.6])[:, None, None]


def codes(linear, exposure, seed=0):
    """Return 8-bit sRGB codes [3, H, W] of an exposure with the noise of 10,000 photons at white."""
    random = np.random.default_rng(seed)
    seen = linear.numpy() * exposure
    seen = np.clip(seen + np.sqrt(np.maximum(seen, 0) * 1e-4) * random.standard_normal(seen.shape), 0, 1)
    return np.round(np.where(seen <= 0.0031308, 12.92 * seen, 1.055 * np.maximum(seen, 1e-9) ** (1 / 2.4) - 0.055) * 255).astype(np.uint8)


def frame(linear, exposure, seed=0):
    shown = codes(linear, exposure, seed) / 255
    back = np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)
    return Developed(torch.from_numpy(back).float(), torch.from_numpy((shown >= 253 / 255).any(0)), 1 / 255 / 12.92, ("no colour profile: taken as sRGB",))


def test_merged_values_are_the_light_over_four_decades():
    true = light()
    frames = [frame(true, one, seed) for seed, one in enumerate((1 / 64, 1 / 8, 1.0, 8.0))]
    found = merge_bracket(["a", "b", "c", "d"], frames, [1, 8, 64, 512])
    scale = (1 / 64, 1 / 8, 1.0, 8.0)[found.reference]
    assert found.ratios / found.ratios[0] == pytest.approx([1, 8, 64, 512], rel=0.02) and found.used.all() and found.notes == ()
    off = (found.developed.linear / scale / true - 1)[:, ~found.developed.clipped]
    # The photons of the longest exposure that does not clip: 10,000 at white are 1 %, and 0.02 of that are 7 %.
    assert float(off.square().mean().sqrt()) < 0.05 and float(off.abs().max()) < 0.4
    # One exposure alone: what is dark is coarse, what is bright is lost.
    alone = frames[2].linear / true - 1
    assert float(alone.square().mean().sqrt()) > 0.3 and not found.developed.clipped.any()
    assert found.developed.notes == ("no colour profile: taken as sRGB",)


def test_what_all_exposures_clip_is_clipped():
    true = light()
    true[:, 40:60, 50:70] = 500.0
    found = merge_bracket(NAMES, [frame(true, one) for one in (1 / 64, 1 / 8, 1.0)], [1, 8, 64])
    inside = torch.zeros(120, 160, dtype=torch.bool)
    inside[40:60, 50:70] = True
    assert (found.developed.clipped == inside).all()


def test_a_wrong_exposure_is_measured_and_named_and_rounded_times_are_not():
    frames = [frame(light(), one) for one in (1 / 16, 1 / 4, 1.0)]
    found = merge_bracket(NAMES, frames, [1, 8, 16])
    assert found.ratios / found.ratios[0] == pytest.approx([1, 4, 16], rel=0.02)
    assert len(found.notes) == 2 and found.notes[0].startswith("middle.jpg: its file says 8 times the exposure of short.jpg, the photographs show 4")
    assert merge_bracket(NAMES, frames, [1 / 15, 1 / 4, 1]).notes == ()
    assert merge_bracket(NAMES, frames, [None] * 3).ratios == pytest.approx(found.ratios)


def test_frames_that_do_not_overlap_need_their_exposure():
    true = torch.full((3, 120, 160), 0.9)
    frames = [frame(true, 1 / 1000), frame(true, 1.0)]
    with pytest.raises(DataError, match="b.jpg: its exposure must be known"):
        merge_bracket(["a.jpg", "b.jpg"], frames, [None, None])
    found = merge_bracket(["a.jpg", "b.jpg"], frames, [1, 1000])
    assert "taken as its file says" in found.notes[0] and found.ratios[1] / found.ratios[0] == pytest.approx(1000)


def test_a_frame_that_moved_is_left_out_and_named():
    true = light()
    frames = [frame(true, 1 / 8), frame(true, 1 / 2), frame(true.roll((2, 3), (1, 2)), 1 / 32, 1)]
    found = merge_bracket(NAMES, frames, [4, 16, 1])
    assert found.used.tolist() == [True, True, False] and found.moved[2] == pytest.approx(np.hypot(2, 3), abs=0.5)
    assert found.notes[-1].startswith("long.jpg: moved by 3.")
    with pytest.raises(DataError, match="middle.jpg: the exposure must have the size of the others"):
        merge_bracket(NAMES, [frames[0], frame(true[:, 1:], 1.0), frames[2]], [1, 2, 3])


def test_brackets_are_found_by_exposures_that_repeat():
    assert bracket_groups([1, 4, 16] * 2) == [[0, 1, 2], [3, 4, 5]]
    assert bracket_groups([1, 1.02, 4, 3.9]) == [[0], [1], [2], [3]]
    assert bracket_groups([1, 4, 2, 4]) == [[0], [1], [2], [3]] and bracket_groups([None, 1]) == [[0], [1]]
    assert bracket_groups([None] * 4, 2) == [[0, 1], [2, 3]]
    with pytest.raises(RangeError, match="5 photographs in brackets of 2"):
        bracket_groups([1.0] * 5, 2)


def test_files_in_brackets_become_one_photograph_each(tmp_path):
    paths = []
    for number, (thing, exposure) in enumerate((thing, one) for thing in (0, 1) for one in (1 / 16, 1.0)):
        pixels = codes(light(thing), exposure).transpose(1, 2, 0)
        paths.append(put_image(tmp_path / f"img_{number}.png", np.ascontiguousarray(pixels), ExposureTime=exposure / 10))
    found, notes = merge_photographs([photograph(path) for path in paths])
    assert len(found) == 2 and notes == ["4 photographs are brackets of 2 exposures"]
    for number, one in enumerate(found):
        merged = one.developed()
        scale = 1 / 16 if one.name in ("img_0.png", "img_2.png") else 1.0
        off = (merged.linear / scale / light(number) - 1)[:, ~merged.clipped]
        assert float(off.abs().median()) < 0.03
    single, nothing = merge_photographs([photograph(path) for path in paths[:1]])
    assert single[0].name == "img_0.png" and nothing == []
