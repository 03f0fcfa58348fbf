"""Btf: what it refuses, and that every way to its samples gives the same ones."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tests.support import all_pairs, assert_close, hemisphere, plausible_images

from torchmat import Btf, RangeError, ShapeError
from torchmat.btf import store as store_module
from torchmat.btf import stream as stream_module
from torchmat.btf.btf import unique_directions
from torchmat.btf.decode import Decoder
from torchmat.btf.store import CLIPPED, INVALID, PixelStore, summarise

UP = [[0.0, 0.0, 1.0]]


def flagged_btf(clipped_weight: float = 0.25, exposure: float = 1.0) -> Btf:
    """Five 8-bit images of 1 x 2 texels: image 1 has a clipped texel, image 3 an invalid one."""
    pixels = np.arange(30, dtype=np.uint8).reshape(5, 3, 1, 2)
    pixels[1, 0, 0, 1] = 255
    flags = np.zeros((5, 1, 2), dtype=np.uint8)
    flags[1, 0, 1], flags[3, 0, 0] = CLIPPED, INVALID
    up = torch.tensor(UP).repeat(5, 1)
    return Btf(summarise(pixels, flags), up, up, Decoder(np.uint8, "linear", exposure), clipped_weight=clipped_weight)


@pytest.mark.parametrize("height, width", [(1, 1), (1, 9), (7, 1), (3, 5), (8, 8)])
def test_every_size(height, width):
    images = np.random.default_rng(0).uniform(0, 3, (2, 3, height, width)).astype(np.float32)
    btf = Btf.from_tensors(images, UP * 2, UP * 2)
    assert (len(btf), btf.height, btf.width) == (2, height, width)
    assert torch.equal(btf.image(1), torch.from_numpy(images[1]))
    assert btf.weight(0).tolist() == [[[1.0] * width] * height]
    assert btf.value_range == (images.min(), images.max())
    assert torch.equal(torch.cat([block.images for block in btf.blocks()]), torch.from_numpy(images))


def test_one_sample_from_lists():
    btf = Btf.from_tensors(np.full((1, 3, 1, 1), 0.5), UP, UP)
    assert (len(btf), len(btf.lights), len(btf.views)) == (1, 1, 1)
    assert btf.image(0).flatten().tolist() == [0.5, 0.5, 0.5]
    assert repr(btf) == "Btf(tensors, 1 samples, 1 lights, 1 views, 1 x 1)"


def test_a_light_below_the_horizon_is_legal():
    btf = Btf.from_tensors(torch.zeros(2, 3, 1, 1), [[0.6, 0, -0.8], [1, 0, 0]], UP * 2)
    assert btf.lights[:, 2].tolist() == pytest.approx([0, -0.8])


def test_precision_of_the_images_is_kept():
    images = torch.full((1, 3, 1, 1), 1 / 3, dtype=torch.float64)
    btf = Btf.from_tensors(images, UP, UP)
    assert btf.light.dtype == torch.float64
    assert btf.images([0], torch.float64).flatten()[0].item() == 1 / 3
    assert next(btf.blocks(dtype=torch.float64)).images.flatten()[0].item() == 1 / 3
    assert btf.image(0).dtype == torch.float32
    half = Btf.from_tensors(images.half(), UP, UP)
    assert (half.stored_dtype, half.light.dtype) == ("float32", torch.float32)


def test_images_with_a_graph_are_taken_as_data():
    images = torch.ones(1, 3, 2, 2, requires_grad=True)
    assert not Btf.from_tensors(images * 2, UP, UP).image(0).requires_grad


@pytest.mark.parametrize("shape", [(2, 1, 1, 2), (2, 1, 2)])
def test_weight_zero_may_hide_anything(shape):
    images = torch.ones(2, 3, 1, 2)
    images[0, 1, 0, 1], images[1, 0, 0, 0] = torch.nan, torch.inf
    weight = torch.tensor([[[1, 0]], [[0, 1]]]).reshape(shape)
    btf = Btf.from_tensors(images, UP * 2, UP * 2, weight.bool())
    assert btf.weights([0, 1]).flatten().tolist() == [1, 0, 0, 1]
    assert btf.valid([0, 1]).flatten().tolist() == [True, False, False, True]
    assert btf.image(0).tolist() == [[[1, 0]]] * 3
    assert btf.invalid_share == 0.5
    assert btf.clipped_share == 0
    assert bool(images[0, 1].isnan().any()), "the caller's tensor must stay as it was"


@pytest.mark.parametrize(
    "change, error, text",
    [
        ({"images": torch.ones(3, 1, 1)}, ShapeError, "images must be .*shape is \\(3, 1, 1\\)"),
        ({"images": torch.ones(2, 4, 1, 1)}, ShapeError, "images must be"),
        ({"images": torch.ones(0, 3, 1, 1)}, ShapeError, "no dimension of 0"),
        ({"images": torch.ones(2, 3, 0, 1)}, ShapeError, "no dimension of 0"),
        ({"images": torch.ones(2, 3, 1, 1, dtype=torch.uint8)}, RangeError, "floating point; they are torch.uint8"),
        ({"images": torch.tensor([[[[torch.nan]]] * 3] * 2)}, RangeError, "6 of 6 values are NaN or Inf.*weight 0"),
        ({"light": UP}, ShapeError, "2 images and light is \\(1, 3\\)"),
        ({"light": UP[0]}, ShapeError, "light must be \\[sample, 3\\]"),
        ({"view": [[0, 1], [0, 1]]}, ShapeError, "view is \\(2, 2\\)"),
        ({"light": [[0, 0, 1], [0, 0, 2.5]]}, RangeError, "light must be unit.*row 1 with length 2.5"),
        ({"view": [[0, 0, 1], [0, 0, torch.nan]]}, RangeError, "view must be finite"),
        ({"view": [[0, 0, 1], [0, 0, -1]]}, RangeError, "1 of 2 views have z <= 0, first at sample 1"),
        ({"view": [[0, 0, 1], [1, 0, 0]]}, RangeError, "lie above the surface"),
        ({"weight": torch.ones(2, 3, 1, 1)}, ShapeError, "weight must be"),
        ({"weight": torch.ones(1, 2)}, ShapeError, "weight must be"),
        ({"weight": torch.full((2, 1, 1), 0.5)}, RangeError, "0/1; 2 values are neither"),
        ({"weight": torch.full((2, 1, 1), torch.nan)}, RangeError, "0/1; 2 values are neither"),
    ],
)
def test_refused(change, error, text):
    with pytest.raises(error, match=text):
        Btf.from_tensors(**({"images": torch.ones(2, 3, 1, 1), "light": UP * 2, "view": UP * 2} | change))


@pytest.mark.parametrize("weight", [-0.1, 1.1, float("nan")])
def test_clipped_weight_is_a_share(weight):
    with pytest.raises(RangeError, match="clipped_weight must lie in"):
        flagged_btf(clipped_weight=weight)


def test_distinct_directions_from_the_pole_outward():
    rows = torch.tensor([[0.6, 0, 0.8], [0, 0, 1], [0.6, -0.0, 0.8], [0, -0.6, 0.8], [-1, 0, 0], [-1, -0.0, 0]])
    distinct, index = unique_directions(rows)
    assert torch.equal(distinct, rows[[1, 3, 0, 4]])
    assert index.tolist() == [2, 0, 2, 1, 3, 3]


def test_directions_that_differ_by_rounding_are_one():
    rows = torch.tensor([[0.6, 0, 0.8], [0.6, 1e-6, 0.8], [0.6001, 0, 0.8]])
    _, index = unique_directions(rows)
    assert index.tolist() == [0, 0, 1]


@pytest.mark.parametrize("axis", [0, 1])
def test_directions_near_the_pole_stay_apart(axis):
    rows = torch.zeros(4, 3)
    rows[:, axis] = torch.tensor([0, 0.002, 0.004, -0.002])
    rows[:, 2] = (1 - rows.square().sum(1)).sqrt()
    distinct, index = unique_directions(rows)
    assert len(distinct) == 4
    assert torch.equal(distinct[index], rows)


def test_indices_lead_back_to_the_directions(small_btf):
    assert (len(small_btf.lights), len(small_btf.views)) == (22, 22)
    assert torch.equal(small_btf.lights[small_btf.light_index], small_btf.light)
    assert torch.equal(small_btf.views[small_btf.view_index], small_btf.view)
    assert small_btf.lights[0].tolist() == [0, 0, 1]
    assert bool((small_btf.lights[:-1, 2] >= small_btf.lights[1:, 2] - 1e-4).all())


@pytest.mark.parametrize("values, blocks", [(1, 5), (12, 3), (29, 2), (10**6, 1)])
def test_blocks_cover_every_sample_once(values, blocks, monkeypatch):
    monkeypatch.setattr(stream_module, "BLOCK_VALUES", values)
    btf = flagged_btf()
    seen, images, weights = [], [], []
    for block in btf.blocks():
        seen.append(block.samples)
        images.append(block.images.clone())
        weights.append(torch.ones(len(block.samples), 1, 1, 2) if block.weight is None else block.weight.clone())
    assert len(seen) == blocks
    assert [sample for run in seen for sample in run] == list(range(5))
    assert torch.equal(torch.cat(images), btf.images(range(5)))
    assert torch.equal(torch.cat(weights), btf.weights(range(5)))


@pytest.mark.parametrize("values", [1, 12, 29, 10**6])
@pytest.mark.parametrize("clipped_weight", [0.25, 1.0])
def test_weight_blocks_are_those_with_a_weight_below_one(values, clipped_weight, monkeypatch):
    monkeypatch.setattr(stream_module, "BLOCK_VALUES", values)
    btf = flagged_btf(clipped_weight)
    weights = torch.ones(5, 1, 1, 2)
    for samples, weight in btf.weight_blocks():
        assert bool((weight < 1).any())
        weights[list(samples)] = weight
    assert torch.equal(weights, btf.weights(range(5)))
    assert weights[:, 0, 0].tolist() == [[1, 1], [1, clipped_weight], [1, 1], [0, 1], [1, 1]]


def test_an_abandoned_pass_leaves_the_next_one_whole(monkeypatch):
    monkeypatch.setattr(stream_module, "BLOCK_VALUES", 1)
    btf = flagged_btf()
    for block in btf.blocks():
        block.images.fill_(9.0)  # scratch: overwriting it must not reach the store
        break
    assert torch.equal(torch.cat([block.images.clone() for block in btf.blocks()]), btf.images(range(5)))


def test_unwanted_blocks_are_skipped(monkeypatch):
    monkeypatch.setattr(stream_module, "BLOCK_VALUES", 1)
    btf = flagged_btf()
    wanted = torch.tensor([False, True, False, False, True])
    assert [block.samples[0] for block in btf.blocks(wanted)] == [1, 4]
    assert [samples[0] for samples, _ in btf.weight_blocks(wanted)] == [1]


def test_blocks_without_flags_have_no_weight(small_btf):
    assert all(block.weight is None for block in small_btf.blocks())
    assert list(small_btf.weight_blocks()) == []
    assert bool(small_btf.valid([0, 3]).all())
    assert not bool(small_btf.clipped([0, 3]).any())
    assert small_btf.clip_level == float("inf")


def test_flags():
    btf = flagged_btf(exposure=0.5)
    assert btf.clipped([0, 1, 3]).flatten().tolist() == [False, False, False, True, False, False]
    assert btf.valid([0, 1, 3]).flatten().tolist() == [True, True, True, True, False, True]
    assert (btf.clipped_share, btf.invalid_share) == (0.1, 0.1)
    assert btf.value_range == (0.0, 2.0)
    assert 1.99 < btf.clip_level < 2 == btf.image(1).max()


def test_samples_can_be_chosen_by_number_or_mask(small_btf):
    light, view = all_pairs(hemisphere(), hemisphere())
    expected = torch.from_numpy(plausible_images(light, view)).float()
    mask = small_btf.light_index == 3
    for chosen in (mask, mask.nonzero()[:, 0], mask.nonzero()[:, 0].tolist(), mask.numpy()):
        assert_close(small_btf.images(chosen), expected[mask])
        assert small_btf.weights(chosen).shape == (22, 1, 5, 4)
    assert small_btf.images([]).shape == (0, 3, 5, 4)
    assert torch.equal(small_btf.image(-1), small_btf.image(len(small_btf) - 1))
    with pytest.raises(IndexError):
        small_btf.image(len(small_btf))
    with pytest.raises(ShapeError, match="a mask of samples must be \\[484\\]"):
        small_btf.images(mask[:5])
    with pytest.raises(RangeError, match="sample numbers must be whole"):
        small_btf.images(torch.tensor([0.5]))


def test_a_window_holds_the_same_samples_of_its_texels():
    light, view = all_pairs(hemisphere(((0, 1), (40, 4))), hemisphere(((0, 1), (50, 3))))
    images = torch.from_numpy(plausible_images(light, view, 7, 9))
    btf = Btf.from_tensors(images, light, view)
    part = btf.window(2, 3, 4, 5)
    assert (len(part), part.height, part.width) == (len(btf), 4, 5)
    assert torch.equal(part.images(range(len(btf)), torch.float64), images[:, :, 2:6, 3:8])
    blocks = [block.images.clone() for block in part.blocks(dtype=torch.float64)]
    assert torch.equal(torch.cat(blocks), images[:, :, 2:6, 3:8])
    assert part.value_range == (images[:, :, 2:6, 3:8].float().min(), images[:, :, 2:6, 3:8].float().max())
    assert part.lights is btf.lights
    assert np.shares_memory(part._store.pixels, btf._store.pixels)
    again = part.window(1, 1, 2, 2)
    assert torch.equal(again.image(5), images[5, :, 3:5, 4:6].float())
    assert torch.equal(btf.window(1, 0, 6, 9, step=4).image(3), images[3, :, 1:7:4, ::4].float())


def test_a_window_counts_its_own_flags():
    btf = flagged_btf()
    left, right = btf.window(0, 0, 1, 1), btf.window(0, 1, 1, 1)
    assert (left.clipped_share, left.invalid_share) == (0, 0.2)
    assert (right.clipped_share, right.invalid_share) == (0.2, 0)
    assert left.weights(range(5)).flatten().tolist() == [1, 1, 1, 0, 1]
    assert right.weights(range(5)).flatten().tolist() == [1, 0.25, 1, 1, 1]
    assert [list(samples) for samples, _ in left.weight_blocks()] == [[0, 1, 2, 3, 4]]
    assert left.clip_level == btf.clip_level


@pytest.mark.parametrize("window", [(0, 0, 2, 1), (-1, 0, 1, 1), (0, 1, 1, 2), (0, 0, 0, 1), (0, 0, 1, 0)])
def test_a_window_beyond_the_images_is_refused(window):
    with pytest.raises(RangeError, match="window's (rows|columns) must lie within the images"):
        flagged_btf().window(*window)


def test_a_window_is_given_in_whole_texels():
    with pytest.raises(RangeError, match="be whole numbers"):
        flagged_btf().window(0.0, 0, 1, 1)
    with pytest.raises(RangeError, match="be whole numbers"):
        flagged_btf().window(0, 0, 1, 1, step=0)


def test_a_window_of_a_mapped_file_lets_its_pages_go(tmp_path, monkeypatch):
    monkeypatch.setattr(store_module, "RELEASE_BYTES", 0)
    images = np.random.default_rng(0).uniform(0, 1, (40, 3, 32, 32)).astype(np.float32)
    images.tofile(tmp_path / "pixels")
    mapped = np.memmap(tmp_path / "pixels", np.float32, "c", shape=images.shape)
    none = np.zeros(40, np.int64)
    store = PixelStore(mapped, None, none, none)
    up = torch.tensor(UP).repeat(40, 1)
    part = Btf(store, up, up, Decoder(np.float32, "linear", 1.0)).window(20, 10, 12, 22)
    monkeypatch.setattr(stream_module, "BLOCK_VALUES", 3 * 12 * 22 * 7)
    found = torch.cat([block.images.clone() for block in part.blocks()])
    assert torch.equal(found, torch.from_numpy(images[:, :, 20:, 10:]))
    assert torch.equal(part.image(39), torch.from_numpy(images[39, :, 20:, 10:]))
