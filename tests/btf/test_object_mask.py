"""Which texels show the object: pictures of masks, alpha, a dark background; and what a Btf then says of the others."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
import torch
from tests.btf.files import either_way, put_image
from tests.support import hemisphere

from torchmat import Btf, load_btf
from torchmat.btf.background import otsu
from torchmat.btf.listing import is_mask
from torchmat.btf.object_mask import read_mask
from torchmat.btf.tiling import btf_tiling
from torchmat.errors import DataError, RangeError, ShapeError

LIGHT = hemisphere(((20, 3), (50, 5)))
SIZE = (20, 16)


def disk(rows: int = SIZE[0], columns: int = SIZE[1]) -> np.ndarray:
    """A disk in the middle, bool [H, W]."""
    down, across = np.mgrid[:rows, :columns]
    return (down - (rows - 1) / 2) ** 2 + (across - (columns - 1) / 2) ** 2 < (0.35 * min(rows, columns)) ** 2


def put_capture(folder, alpha=None, background=3, seed=0):
    """Photographs of a bright disk before something dark, one a light, in the form of DiLiGenT; return the folder."""
    random = np.random.default_rng(seed)
    folder.mkdir(parents=True)
    for number in range(len(LIGHT)):
        codes = np.where(disk(), random.integers(90, 250, SIZE), random.integers(0, background + 1, SIZE)).astype(np.uint8)
        planes = [codes[:, :, None].repeat(3, axis=2)] + ([] if alpha is None else [alpha[:, :, None]])
        put_image(folder / f"{number:03d}.png", np.concatenate(planes, axis=2))
    np.savetxt(folder / "light_directions.txt", LIGHT)
    return folder


def put_mask(path, mask, white=255, dtype=np.uint8):
    return put_image(path, (mask * white).astype(dtype)[:, :, None])


@either_way
@pytest.mark.parametrize("name", ["mask.png", "Mask.TIF", "cat.mask.tga"])
def test_a_mask_beside_the_photographs_is_no_photograph_and_used(tmp_path, pack, name):
    folder = put_capture(tmp_path / "d")
    whole = load_btf(folder, cache=False)
    put_mask(folder / name, disk())
    btf = load_btf(pack(folder), cache=False)
    assert len(btf) == len(LIGHT)
    assert torch.equal(btf.mask, torch.from_numpy(disk()))
    assert btf.source.mask.endswith(name)
    assert any(name in note and f"{100 * disk().mean():.1f} % of the texels" in note for note in btf.source.notes)
    assert torch.equal(btf.images([2])[0][:, disk()], whole.images([2])[0][:, disk()])
    bare = load_btf(folder, mask="none", cache=False)
    assert bare.mask is None and torch.equal(bare.images(range(8)), whole.images(range(8)))


def test_names_of_masks():
    assert [is_mask(name) for name in ("a/mask.png", "MASK.tif", "cat.mask.tga")] == [True] * 3
    assert [is_mask(name) for name in ("mask.txt", "masked.png", "cat_mask.png", "mask1.png")] == [False] * 4


@pytest.mark.parametrize(("pixels", "wanted"), [
    (np.array([[0, 127, 128, 255]], np.uint8)[:, :, None], [False, False, True, True]),
    (np.array([[0, 1, 1, 0]], np.uint8)[:, :, None], [False, True, True, False]),  # codes of 0 and 1
    (np.array([[0, 32767, 32768, 65535]], np.uint16)[:, :, None], [False, False, True, True]),
    (np.array([[[0, 0, 0], [255, 255, 255], [255, 0, 0], [255, 255, 0]]], np.uint8), [False, True, False, True]),
    (np.array([[[9, 9, 9, 0], [9, 9, 9, 255], [0, 0, 0, 255], [9, 9, 9, 1]]], np.uint8), [False, True, True, False]),  # alpha
    (np.array([[[0, 255], [255, 255], [255, 255], [0, 255]]], np.uint8), [False, True, True, False]),  # alpha says nothing
])
def test_what_a_picture_of_a_mask_says(tmp_path, pixels, wanted):
    assert read_mask(put_image(tmp_path / "m.png", pixels))[0].tolist() == wanted


def test_floating_point_and_one_bit(tmp_path):
    from PIL import Image

    values = np.array([[0.0, 0.49, 0.5, 1.0]], np.float32)[:, :, None]
    assert read_mask(put_image(tmp_path / "m.exr", values))[0].tolist() == [False, False, True, True]
    Image.fromarray(np.array([[False, True]])).save(tmp_path / "one.png", bits=1)
    assert read_mask(tmp_path / "one.png")[0].tolist() == [False, True]


def test_a_mask_that_is_given(tmp_path):
    folder = put_capture(tmp_path / "d")
    path = put_mask(tmp_path / "m.png", disk())
    expected = torch.from_numpy(disk())
    for mask in (path, str(path), expected, expected[None], disk().astype(np.float32)):
        assert torch.equal(load_btf(folder, mask=mask, cache=False).mask, expected)
    assert load_btf(folder, mask=path, cache=False).source.mask == str(path)


def test_masks_that_do_not_fit_are_refused_with_both_sizes(tmp_path):
    folder = put_capture(tmp_path / "d")
    wrong = put_mask(tmp_path / "m.png", disk(10, 8))
    with pytest.raises(ShapeError, match="photographs' size; it is 10 x 8 and they are 20 x 16"):
        load_btf(folder, mask=wrong, cache=False)
    shutil.copy(wrong, folder / "mask.png")
    with pytest.raises(ShapeError, match="mask.png.*it is 10 x 8 and they are 20 x 16.*--mask none"):
        load_btf(folder, cache=False)
    with pytest.raises(DataError, match="be a picture; there is no such file"):
        load_btf(folder, mask="alhpa", cache=False)
    with pytest.raises(ShapeError, match="boolean or 0/1"):
        load_btf(folder, mask=torch.full(SIZE, 0.5), cache=False)
    with pytest.raises(DataError, match="show the object; it is black throughout"):
        load_btf(folder, mask=np.zeros(SIZE, bool), cache=False)
    with pytest.raises(DataError, match="have photographs with alpha; they have none"):
        load_btf(folder, mask="alpha", cache=False)


def test_a_white_mask_leaves_nothing_out_and_that_is_said(tmp_path):
    btf = load_btf(put_capture(tmp_path / "d"), mask=np.ones(SIZE, bool), cache=False)
    assert btf.mask is None and btf.source.notes[-1] == "the mask of the one given is white throughout: no texel is left out"


def test_crop_and_downscale_are_those_of_the_photographs(tmp_path):
    folder = put_capture(tmp_path / "d")
    path = put_mask(tmp_path / "m.png", disk())
    btf = load_btf(folder, mask=path, crop=(3, 2, 13, 11), downscale=2, cache=False)
    blocks = disk()[3:15, 2:12].reshape(6, 2, 5, 2)
    assert torch.equal(btf.mask, torch.from_numpy(blocks.all(axis=(1, 3))))  # what is half background would be darker
    own = put_mask(tmp_path / "own.png", disk(6, 5))
    assert torch.equal(load_btf(folder, mask=own, crop=(3, 2, 13, 11), downscale=2, cache=False).mask, torch.from_numpy(disk(6, 5)))


def test_alpha_is_the_mask_where_it_leaves_texels_out(tmp_path):
    alpha = np.where(disk(), 255, 0).astype(np.uint8)
    btf = load_btf(put_capture(tmp_path / "d", alpha), cache=False)
    assert torch.equal(btf.mask, torch.from_numpy(disk()))
    assert btf.source.mask == "the photographs' alpha" and btf.invalid_share == 0
    opaque = load_btf(put_capture(tmp_path / "e", np.full(SIZE, 255, np.uint8)), cache=False)
    assert opaque.mask is None and "white throughout" not in " ".join(opaque.source.notes)
    asked = load_btf(tmp_path / "e", mask="alpha", cache=False)
    assert asked.mask is None and "white throughout" in asked.source.notes[-1]
    assert load_btf(tmp_path / "d", mask="none", cache=False).mask is None


def test_a_dark_background_is_suggested_and_found_on_request(tmp_path):
    folder = put_capture(tmp_path / "d")
    hint = load_btf(folder, cache=False).source.notes[-1]
    assert hint.startswith("100 % of the border is dark in all photographs") and "--mask background" in hint
    btf = load_btf(folder, mask="background", cache=False)
    assert torch.equal(btf.mask, torch.from_numpy(disk()))
    assert "is a guess" in btf.source.notes[-1] and btf.source.mask == "the background"


def test_a_dark_place_on_the_object_is_no_background_and_a_speck_is_no_object():
    images = np.full((4, 3, 40, 40), 0.001)
    images[:, :, 8:32, 8:32] = 0.5
    images[:, :, 18:22, 18:22] = 0.0
    images[:, :, 2, 2] = 0.4  # one texel of 1600: less than one in a thousand
    light = torch.from_numpy(hemisphere(((30, 4),))).float()
    view = torch.tensor([[0.0, 0.0, 1.0]]).repeat(4, 1)
    btf = Btf.from_tensors(images.astype(np.float32), light, view)
    from torchmat.btf.background import without_background

    mask, how = without_background(btf)
    assert int(mask.sum()) == 24 * 24 and bool(mask[8:32, 8:32].all())
    assert "0.001 in every photograph" in how
    bright = Btf.from_tensors(np.full((4, 3, 6, 6), 0.5, np.float32), light, view)
    with pytest.raises(DataError, match="be told from the object by its darkness"):
        without_background(bright)


def test_the_threshold_parts_two_heaps_in_the_middle_of_the_gap():
    values = np.concatenate((np.full(70, 0.1), np.full(30, 0.9)))
    assert otsu(values) == pytest.approx(0.5, abs=0.01)


def sample(mask: torch.Tensor | None = None, garbage: float = 7.0) -> Btf:
    random = torch.Generator().manual_seed(0)
    images = torch.rand(6, 3, 4, 5, generator=random)
    weight = torch.ones(6, 4, 5)
    weight[2, 1, 1], weight[3, 0, 0] = 0, 0
    if mask is not None:
        images[:, :, ~mask] = garbage
    light = torch.from_numpy(hemisphere(((30, 6),))).float()
    btf = Btf.from_tensors(images, light, torch.tensor([[0.0, 0.0, 1.0]]).repeat(6, 1), weight)
    return btf if mask is None else btf.masked(mask)


def test_what_a_masked_btf_says():
    mask = torch.zeros(4, 5, dtype=torch.bool)
    mask[1:3, 1:4] = True
    whole, btf = sample(), sample(mask)
    wanted = whole.images(range(6)) * mask
    assert torch.equal(btf.images(range(6)), wanted)
    assert torch.equal(btf.weights(range(6)), whole.weights(range(6)) * mask)
    assert torch.equal(btf.valid(range(6)), whole.valid(range(6)) & mask)
    blocks = list(btf.blocks())
    assert torch.equal(torch.cat([block.images for block in blocks]), wanted)
    assert torch.equal(torch.cat([block.weight for block in blocks]), whole.weights(range(6)) * mask)
    (run, weight), = btf.weight_blocks()
    assert torch.equal(weight[:, 0], torch.where(mask, whole.weights(run)[:, 0], 1.0))
    assert btf.inside.tolist() == [6, 7, 8, 11, 12, 13] and btf.object_share == 0.3
    assert btf.invalid_share == 1 / 36 and whole.invalid_share == 2 / 120
    assert btf.value_range == (float(wanted[:, :, mask].min()), float(wanted[:, :, mask].max()))
    assert btf.digest() != whole.digest() and btf.identity() != whole.identity()
    assert btf.source.mask == "the one given" and whole.source.mask == ""


def test_parts_of_a_masked_btf_keep_their_mask():
    mask = torch.zeros(4, 5, dtype=torch.bool)
    mask[1:3, 1:4] = True
    btf = sample(mask)
    assert torch.equal(btf.picked([1, 3]).mask, mask)
    assert torch.equal(btf.window(0, 0, 4, 3).mask, mask[:, :3])
    assert torch.equal(btf.window(0, 0, 4, 5, 2).mask, mask[::2, ::2])
    assert btf.window(1, 1, 2, 3).mask is None
    assert not bool(btf.window(0, 0, 1, 5).mask.any())
    assert torch.equal(btf.masked(mask.T.reshape(4, 5)).mask, mask & mask.T.reshape(4, 5))
    with pytest.raises(ShapeError, match=r"be \[4, 5\] as the images are; it is \[5, 4\]"):
        btf.masked(mask.T)
    with pytest.raises(RangeError, match="true somewhere"):
        btf.masked(~mask & mask)


def test_an_object_does_not_repeat():
    whole = Btf.from_tensors(torch.full((4, 3, 6, 6), 0.5), *(torch.tensor([[0.0, 0.0, 1.0]]).repeat(4, 1),) * 2)
    mask = torch.ones(6, 6, dtype=torch.bool)
    mask[0, 0] = False
    found = btf_tiling(whole.masked(mask))
    assert btf_tiling(whole).repeats and not found.repeats
    assert found.sentence() == "it does not repeat: an object mask cuts it out"
    assert found.report()["masked"] and "masked" not in btf_tiling(whole).report()
