"""Held-out samples."""

from __future__ import annotations

import pytest
import torch
from tests.support import shared_path

from torchmat import Btf, RangeError, load_btf, split_samples

UP, TILTED = [0.0, 0.0, 1.0], [0.6, 0.0, 0.8]


@pytest.mark.parametrize("by", ["pair", "light", "view"])
def test_parts_are_disjoint_ascending_and_cover_all(small_btf, by):
    split = split_samples(small_btf, 0.3, by, seed=4)
    assert torch.equal(torch.cat(split).sort().values, torch.arange(484))
    assert all(bool((part.diff() > 0).all()) for part in split)


@pytest.mark.parametrize("by, held_out", [("pair", 97), ("light", 4 * 22), ("view", 4 * 22)])
def test_share(small_btf, by, held_out):
    assert len(split_samples(small_btf, 0.2, by).held_out) == held_out  # round(0.2 x 484), round(0.2 x 22) groups


@pytest.mark.parametrize("by", ["light", "view"])
def test_a_held_out_direction_is_never_seen(small_btf, by):
    index = getattr(small_btf, f"{by}_index")
    split = split_samples(small_btf, 0.2, by)
    assert not set(index[split.train].tolist()) & set(index[split.held_out].tolist())


def test_a_pair_measured_twice_stays_together():
    light = torch.tensor([UP, TILTED, UP, TILTED, UP, TILTED])
    btf = Btf.from_tensors(torch.ones(6, 3, 1, 1), light, torch.tensor([UP]).repeat(6, 1))
    for seed in range(4):
        split = split_samples(btf, 0.5, "pair", seed)
        assert split.held_out.tolist() in ([0, 2, 4], [1, 3, 5])


@pytest.mark.parametrize("by", ["pair", "light", "view"])
def test_a_seed_decides(small_btf, by):
    first, again, other = (split_samples(small_btf, 0.2, by, seed).held_out for seed in (0, 0, 1))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


def test_the_split_of_seed_0_stays_what_it_was(small_btf):
    assert split_samples(small_btf, 0.01).held_out.tolist() == sorted(
        torch.randperm(484, generator=torch.Generator().manual_seed(0))[:5].tolist()
    )


@pytest.mark.parametrize("share, held_out", [(1e-9, 1), (0.5, 1), (0.999999, 1)])
def test_one_is_held_out_and_one_kept(share, held_out):
    btf = Btf.from_tensors(torch.ones(2, 3, 1, 1), [UP, TILTED], [UP, UP])
    split = split_samples(btf, share, "light")
    assert (len(split.train), len(split.held_out)) == (2 - held_out, held_out)


def test_share_zero_holds_out_nothing(small_btf):
    split = split_samples(small_btf, 0.0)
    assert (len(split.train), len(split.held_out)) == (484, 0)


def test_one_view_cannot_be_held_out():
    btf = Btf.from_tensors(torch.ones(2, 3, 1, 1), [UP, TILTED], [UP, UP])
    with pytest.raises(RangeError, match="at least two views.*Hold out in another way"):
        split_samples(btf, 0.2, "view")


@pytest.mark.parametrize("share", [-0.1, 1.0, 20, float("nan")])
def test_share_out_of_range(small_btf, share):
    with pytest.raises(RangeError, match=r"share must lie in \[0, 1\)"):
        split_samples(small_btf, share)


def test_by_both_light_and_view_are_new(small_btf):
    split = split_samples(small_btf, 0.2, "both")
    assert (len(split.held_out), len(split.train)) == (4 * 4, 18 * 18)  # round(0.2 x 22) of each
    for index in (small_btf.light_index, small_btf.view_index):
        assert not set(index[split.train].tolist()) & set(index[split.held_out].tolist())
    by_light = split_samples(small_btf, 0.2, "light")
    assert set(split.held_out.tolist()) < set(by_light.held_out.tolist())  # the same lights
    assert torch.equal(split.held_out, split_samples(small_btf, 0.2, "both").held_out)


def test_by_both_some_of_both_kinds_must_have_been_measured():
    one = Btf.from_tensors(torch.ones(2, 3, 1, 1), [UP, TILTED], [UP, UP])
    with pytest.raises(RangeError, match="at least two views"):
        split_samples(one, 0.2, "both")
    diagonal = Btf.from_tensors(torch.ones(2, 3, 1, 1), [UP, TILTED], [UP, TILTED])
    found = set()
    for seed in range(8):
        try:
            found.add(tuple(split_samples(diagonal, 0.5, "both", seed).held_out.tolist()))
        except RangeError as error:
            assert "have samples of both kinds; 0 samples are of kept lights and views, 0 of held-out ones" in str(error)
            found.add("refused")
    assert found == {(0,), (1,), "refused"}


def test_unknown_way(small_btf):
    with pytest.raises(RangeError, match="Did you mean 'light'"):
        split_samples(small_btf, 0.2, "lights")


def polar_directions(*angles_deg: tuple[float, float]) -> torch.Tensor:
    polar, azimuth = torch.deg2rad(torch.tensor(angles_deg, dtype=torch.float64)).T
    return torch.stack((polar.sin() * azimuth.cos(), polar.sin() * azimuth.sin(), polar.cos()), dim=1).float()


def arc_of(lights, views) -> list[int]:
    btf = Btf.from_tensors(torch.ones(len(lights), 3, 1, 1), polar_directions(*lights), polar_directions(*views))
    split = split_samples(btf, 0.2, "arc")
    assert torch.equal(torch.cat(split).sort().values, torch.arange(len(lights)))
    return split.train.tolist()


def test_the_arc_is_lights_at_azimuth_0():
    lights = [(0, 0), (15, 0), (30, 60), (45, 359.5), (60, 0.8), (60, 1.5), (75, 180), (0.5, 90), (5, 90), (89, 0)]
    assert arc_of(lights, [(0, 0)] * 10) == [0, 1, 3, 4, 7, 9]


def test_the_arc_is_seen_along_the_normal():
    assert arc_of([(15, 0)] * 5, [(0, 0), (4, 70), (6, 0), (60, 180), (4.9, 180)]) == [0, 1, 4]


def test_lights_below_the_surface_are_on_no_arc():
    assert arc_of([(15, 0), (95, 0), (30, 0)], [(0, 0)] * 3) == [0, 2]


def test_neither_share_nor_seed_change_the_arc_but_0_holds_nothing_out():
    lights = [(15, 0), (30, 0), (30, 90), (45, 120)]
    btf = Btf.from_tensors(torch.ones(4, 3, 1, 1), polar_directions(*lights), polar_directions(*[(0, 0)] * 4))
    for share, seed in ((0.2, 0), (0.9, 3), (1e-9, 1)):
        assert split_samples(btf, share, "arc", seed).train.tolist() == [0, 1]
    assert split_samples(btf, 0.0, "arc").train.tolist() == [0, 1, 2, 3]


def test_data_without_an_arc(small_btf):
    lights = [(15, 0), (30, 90), (45, 180)]
    btf = Btf.from_tensors(torch.ones(3, 3, 1, 1), polar_directions(*lights), polar_directions(*[(0, 0)] * 3))
    with pytest.raises(RangeError, match="at least two samples on the arc; 1 of 3 samples are on it.*azimuth 0"):
        split_samples(btf, 0.2, "arc")
    with pytest.raises(RangeError, match="share must lie"):
        split_samples(small_btf, 1.5, "arc")


def test_the_real_wallpapers_arc():
    btf = load_btf(shared_path("real/ubo2003_wallpaper"))
    split = split_samples(btf, by="arc")
    assert len(split.held_out) == 75
    assert all("pl000" in btf.source.files[k] for k in split.train) and len(split.train) == 6
