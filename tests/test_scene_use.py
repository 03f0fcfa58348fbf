"""What a scene uses: shares of measured pairs against slow loops, texels, windows, levels, several pictures."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tests.reference.raw_btf import around
from tests.support import all_pairs, hemisphere

from torchmat import RangeError, ShapeError
from torchmat.scene_use import SceneUse, as_use, joined

LIGHTS, VIEWS = hemisphere(((0, 1), (35, 5), (65, 7))), hemisphere(((0, 1), (50, 6)))


def use_of(uv, light=(0.0, 0.0, 1.0), view=(0.0, 0.0, 1.0), weight=1.0, footprint=1e-6) -> SceneUse:
    """Return the use of points at `uv` [P, 2] that all have one light and view."""
    uv = torch.as_tensor(uv, dtype=torch.float64).T
    count = uv.shape[1]
    light, view = (torch.as_tensor(d, dtype=torch.float64)[:, None].expand(3, count) for d in (light, view))
    weight = torch.as_tensor(weight, dtype=torch.float64).expand(count)
    return SceneUse(uv, torch.full((count,), footprint, dtype=torch.float64), torch.arange(count), light, view, weight)


def scattered(count: int, seed: int) -> SceneUse:
    """Return points with lights and views all over the hemisphere, of unlike weights."""
    random = np.random.default_rng(seed)

    def directions() -> torch.Tensor:
        z, azimuth = random.uniform(0.05, 1, count), random.uniform(0, 2 * np.pi, count)
        across = np.sqrt(1 - z * z)
        return torch.from_numpy(np.stack((across * np.cos(azimuth), across * np.sin(azimuth), z)))

    uv, weight = torch.from_numpy(random.uniform(-1, 2, (2, count))), torch.from_numpy(random.uniform(0.1, 2, count))
    return SceneUse(uv, torch.full((count,), 1e-3), torch.arange(count), directions(), directions(), weight)


def test_sample_weights_are_those_of_a_loop_over_points_and_corners():
    lights, views = scattered(8, seed=8).light.T.numpy(), scattered(6, seed=9).view.T.numpy()  # no four on a circle
    light, view = (torch.from_numpy(d) for d in all_pairs(lights, views))
    use = scattered(80, seed=1)
    expected = np.zeros(len(light))
    for point in range(80):
        near = around(lights, use.light[:, point].numpy())[0], around(views, use.view[:, point].numpy())[0]
        for a, wa in near[0].items():
            for b, wb in near[1].items():
                expected[b * len(lights) + a] += float(use.weight[point]) * wa * wb
    found = use.sample_weights(light, view).weight
    np.testing.assert_allclose(found.numpy(), expected / float(use.weight.sum()), atol=1e-12)


def test_weights_add_up_to_one_also_where_pairs_are_missing():
    light, view = (torch.from_numpy(d) for d in all_pairs(LIGHTS, VIEWS))
    kept = torch.rand(len(light), generator=torch.Generator().manual_seed(0)) < 0.6
    found = scattered(500, seed=2).sample_weights(light[kept], view[kept])
    assert float(found.weight.sum()) == pytest.approx(1, abs=1e-12)
    assert bool((found.weight >= 0).all())


def test_a_measured_pair_that_is_used_alone_has_all_the_weight():
    light, view = (torch.from_numpy(d) for d in all_pairs(LIGHTS, VIEWS))
    use = use_of([[0.5, 0.5]], light=LIGHTS[3], view=VIEWS[2])
    found = use.sample_weights(light, view)
    assert int(found.weight.argmax()) == 2 * len(LIGHTS) + 3
    assert float(found.weight.max()) == pytest.approx(1, abs=1e-9)
    assert found.outside == 0


def test_use_beyond_the_measured_directions_is_told():
    light, view = (torch.from_numpy(d) for d in all_pairs(LIGHTS, VIEWS[:1]))
    assert scattered(400, seed=3).sample_weights(light, view).outside > 0.95  # one view
    low = use_of([[0.5, 0.5]], light=(np.sin(1.5), 0, np.cos(1.5)))
    assert low.sample_weights(*(torch.from_numpy(d) for d in all_pairs(LIGHTS, VIEWS))).outside == 1


def test_texels_are_those_that_a_bilinear_look_up_reads():
    touched = use_of([[3 / 8, 1 - 2.5 / 4]]).texels(4, 8)  # between columns 2 and 3, in the middle of row 2
    rows, columns = touched.nonzero().T.tolist()
    assert set(columns) == {2, 3} and set(rows) <= {2, 3} and 2 in rows


def test_texels_wrap_around_where_the_texture_tiles():
    corner = use_of([[0.001, 0.999]])
    assert corner.texels(6, 5).nonzero().tolist() == [[0, 0], [0, 4], [5, 0], [5, 4]]
    assert corner.texels(6, 5, tiles=False).nonzero().tolist() == [[0, 0]]
    assert torch.equal(use_of([[3.001, -1.001]]).texels(6, 5), corner.texels(6, 5))


def test_a_window_holds_all_that_is_touched_and_nothing_more():
    use = use_of([[0.3, 0.8], [0.55, 0.6]])
    top, left, height, width = use.window(20, 20)
    touched = use.texels(20, 20)
    inside = torch.zeros_like(touched)
    inside[top : top + height, left : left + width] = True
    assert not bool((touched & ~inside).any())
    assert bool(touched[top].any() and touched[top + height - 1].any() and touched[:, left].any())


@pytest.mark.parametrize("seed", range(6))
def test_a_window_is_the_box_of_the_texels_at_every_level(seed):
    random = np.random.default_rng(seed)
    uv = torch.from_numpy(random.uniform(0.35, 0.6, (2, 9)) + seed)
    footprint = torch.from_numpy(2.0 ** random.uniform(-8, -5, 9))
    one = torch.zeros(3, 9)
    one[2] = 1
    use = SceneUse(uv, footprint, torch.arange(9), one, one, torch.ones(9))
    top, left, height, width = use.window(128, 64)
    touched = use.texels(128, 64)
    step = 2 ** int(use.levels(128, 64).max().ceil())
    for along, first, length in ((touched.any(dim=1), top, height), (touched.any(dim=0), left, width)):
        at = along.nonzero()[:, 0]
        assert (int(at[0]) // step * step, -(-(int(at[-1]) + 1) // step) * step) == (first, first + length)


def test_no_window_around_the_border_or_of_nearly_all():
    assert use_of([[0.001, 0.5]]).window(16, 16) is None
    assert use_of([[0.001, 0.5]]).window(16, 16, tiles=False) is not None
    assert use_of([[0.04, 0.04], [0.96, 0.96]]).window(16, 16) is None
    assert use_of([[0.3, 0.5]]).window(1, 7) is None


def test_a_window_stands_on_the_texels_of_the_coarsest_level():
    window = use_of([[0.5, 0.5]], footprint=4 / 64).window(64, 64)
    assert window is not None and all(n % 4 == 0 for n in window)
    assert use_of([[0.5, 0.5]], footprint=4 / 63).window(63, 63) is None


def test_level_is_the_finest_that_is_seen():
    assert use_of([[0.5, 0.5]], footprint=1 / 64).level(64, 64) == 0
    assert use_of([[0.5, 0.5]], footprint=4.1 / 64).level(64, 32) == 2
    near, far = use_of(np.full((10, 2), 0.5), footprint=1 / 64), use_of(np.full((10, 2), 0.5), footprint=1 / 8)
    assert joined((near, far)).level(64, 64) == 0
    assert use_of([[0.5, 0.5]], footprint=100.0).level(64, 64) == 6


def test_pictures_add_up_by_their_pixels():
    light, view = (torch.from_numpy(d) for d in all_pairs(LIGHTS, VIEWS))
    one, other = scattered(40, seed=4), scattered(90, seed=5)
    both = one + other
    assert torch.equal(both.uv[:, both.point][:, 40:], other.uv)
    share = float(one.weight.sum() / (one.weight.sum() + other.weight.sum()))
    expected = share * one.sample_weights(light, view).weight + (1 - share) * other.sample_weights(light, view).weight
    torch.testing.assert_close(both.sample_weights(light, view).weight, expected, rtol=0, atol=1e-12)
    assert torch.equal(as_use([one, other]).weight, both.weight)


def test_many_points_give_the_weights_of_few():
    light, view = (torch.from_numpy(d) for d in all_pairs(LIGHTS, VIEWS))
    found = [scattered(count, seed=6).sample_weights(light, view).weight for count in (5_000, 60_000)]
    assert float((found[0] - found[1]).abs().max()) < 0.004  # of 91 samples; measured 0.0017


def test_bad_uses_are_told():
    good = use_of([[0.5, 0.5]])
    with pytest.raises(RangeError, match="shows none"):
        use_of([[0.5, 0.5]], weight=0.0)
    with pytest.raises(RangeError, match="shows none"):
        use_of(np.zeros((0, 2)))
    with pytest.raises(ShapeError, match="footprint"):
        SceneUse(good.uv, torch.zeros(3), good.point, good.light, good.view, good.weight)
    with pytest.raises(RangeError, match="be a Scene"):
        as_use("teapot")
    with pytest.raises(RangeError, match="be a Scene"):
        as_use([])
