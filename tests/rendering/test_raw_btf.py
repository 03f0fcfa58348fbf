"""The raw BTF on an object: exact where it was measured, continuous between, dark at the horizon."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from tests.reference.raw_btf import around, shaded
from tests.support import all_pairs, assert_close, hemisphere, plausible_images

from torchmat import Btf, DataError, RangeError, ShapeError, load_btf, sample_path
from torchmat.btf.interpolated import RawBtf
from torchmat.btf.neighbours import Triangulation
from torchmat.frames import from_polar
from torchmat.geometry.rays import texel_centres

HEIGHT, WIDTH = 5, 4


def scattered(count: int, seed: int, lowest_z: float = 0.3) -> np.ndarray:
    """Return random unit directions [count, 3] with z from `lowest_z` to 1: no four on a circle."""
    random = np.random.default_rng(seed)
    z, azimuth = random.uniform(lowest_z, 1, count), random.uniform(0, 2 * np.pi, count)
    across = np.sqrt(1 - z * z)
    return np.stack((across * np.cos(azimuth), across * np.sin(azimuth), z), axis=1)


def btf_of(lights: np.ndarray, views: np.ndarray, weight=None, dtype=np.float64, size=(HEIGHT, WIDTH)) -> Btf:
    """Return a BTF of all pairs, views outermost, of bumpy glossy images."""
    light, view = all_pairs(lights, views)
    images = plausible_images(light, view, *size)
    return Btf.from_tensors(images.astype(dtype), light.astype(dtype), view.astype(dtype), weight)


def planes(directions) -> torch.Tensor:
    """Return directions [n, 3] as pixels of one row, [3, 1, n]."""
    return torch.as_tensor(directions).T[:, None]


def at(direction, dtype=torch.float64) -> torch.Tensor:
    """Return one direction as [3, 1, 1]."""
    return torch.as_tensor(direction).to(dtype)[:, None, None]


def polar(degrees: float, azimuth: float = 0.0) -> torch.Tensor:
    """Return a unit direction [3], float64; the azimuth in radians."""
    return from_polar(*torch.tensor([math.radians(degrees), azimuth], dtype=torch.float64))


POLE = [0.0, 0.0, 1.0]


@pytest.mark.parametrize("tiles", [True, False])
@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("memory_gb", [2.0, 0.0])
def test_agrees_with_the_loop_over_pixels(dtype, tiles, masked, memory_gb):
    lights, views = scattered(9, 1), scattered(7, 2)
    random = np.random.default_rng(3)
    valid = np.ones((63, HEIGHT, WIDTH)) if not masked else (random.random((63, HEIGHT, WIDTH)) > 0.3).astype(float)
    btf = btf_of(lights, views, torch.from_numpy(valid) if masked else None)
    raw = RawBtf(btf, tiles, memory_gb, dtype)
    count = 60
    uv, light, view = random.uniform(-1.5, 2.5, (count, 2)), scattered(count, 4, 0.0), scattered(count, 5, 0.0)
    light[:3, 2] *= -1
    view[3:5, 2] *= -1
    if not tiles:
        uv = random.uniform(0, 1, (count, 2))
    images = btf.images(range(63), torch.float64).numpy().reshape(7, 9, 3, HEIGHT, WIDTH).swapaxes(0, 1)
    flags = valid.reshape(7, 9, HEIGHT, WIDTH).swapaxes(0, 1)
    expected = [shaded(images, flags, lights, views, *row, tiles) for row in zip(uv, light, view, strict=True)]
    value = raw.shade_at(planes(uv).to(dtype), planes(light).to(dtype), planes(view).to(dtype))
    assert value.dtype == dtype
    # Texture coordinates and barycentric weights of float32 input: 1e-7 of a texture is 4e-7 of a texel.
    assert_close(value[:, 0].T, np.array(expected), 1e-5 if dtype == torch.float32 else 1e-11)
    assert not value[:, 0, :5].any()


@pytest.mark.parametrize("count, lowest", [(9, 0.3), (5, 0.05), (3, 0.5), (40, 0.0)])
def test_triangles_are_those_of_the_sphere(count, lowest):
    known, wanted = scattered(count, 6, lowest), scattered(40, 7, 0.0)
    found = Triangulation(torch.from_numpy(known)).find(torch.from_numpy(wanted))
    for number in range(0, 40, 1 if count < 10 else 20):
        weights, ratio = around(known, wanted[number])
        dense, expected = np.zeros(count), np.zeros(count)
        np.add.at(dense, found.index[number].numpy(), found.weight[number].numpy())
        expected[list(weights)] = list(weights.values())
        assert_close(dense, expected, 1e-10)
        assert float(found.ratio[number]) == pytest.approx(ratio, rel=1e-10)


@pytest.mark.parametrize("rings", [((0, 1), (25, 5), (50, 7), (70, 9)), ((60, 8),), ((30, 4), (60, 4)), ((45, 3),)])
def test_exact_where_it_was_measured(dtype, rings):
    directions = hemisphere(rings)
    btf = btf_of(directions, directions, dtype=np.float32 if dtype == torch.float32 else np.float64)
    raw = RawBtf(btf, dtype=dtype)
    light, view = (d.to(dtype)[:, :, None, None] for d in (btf.light, btf.view))
    value = raw.shade_at(texel_centres(HEIGHT, WIDTH, dtype), light, view)
    assert_close(value, btf.images(range(len(btf)), dtype), 3e-6 if dtype == torch.float32 else None)


def test_exact_on_the_embedded_sample():
    btf = load_btf(sample_path())
    raw = RawBtf(btf)
    chosen = torch.arange(0, len(btf), 89)
    light, view = (d[chosen][:, :, None, None] for d in (btf.light, btf.view))
    value = raw.shade_at(texel_centres(*raw.size), light, view)
    assert_close(value, btf.images(chosen).clamp(min=0), 3e-6)


def test_halfway_between_two_lights_by_hand():
    lights = torch.stack((polar(30), polar(30, math.pi)))
    images = torch.zeros(2, 3, 1, 1, dtype=torch.float64)
    images[0], images[1] = 0.2, 0.6
    raw = RawBtf(Btf.from_tensors(images, lights, torch.tensor([POLE, POLE]).double()), dtype=torch.float64)
    uv = torch.full((2, 1, 1), 0.3, dtype=torch.float64)
    assert_close(raw.shade_at(uv, at(POLE), at(POLE)), torch.full((3, 1, 1), 0.4, dtype=torch.float64))
    # In the disc 15 degrees lie at tan(7.5 degrees), the two lights at plus and minus tan(15 degrees).
    share = 0.5 + 0.5 * math.tan(math.radians(7.5)) / math.tan(math.radians(15))
    expected = torch.full((3, 1, 1), share * 0.2 + (1 - share) * 0.6, dtype=torch.float64)
    assert_close(raw.shade_at(uv, at(polar(15)), at(polar(40, 2.0))), expected)
    # Across the arc the nearest light on it is the pole.
    value = raw.shade_at(uv, at(polar(60, math.pi / 2)), at(POLE))
    assert_close(value, torch.full((3, 1, 1), 0.2, dtype=torch.float64))


def test_one_light_falls_with_its_cosine():
    images = torch.full((1, 3, 2, 2), 0.8, dtype=torch.float64)
    light = polar(60)[None]
    raw = RawBtf(Btf.from_tensors(images, light, polar(20)[None]), dtype=torch.float64)
    uv = texel_centres(2, 2, torch.float64)
    for degrees, expected in ((60, 0.8), (0, 1.6), (89.9, 1.6 * math.cos(math.radians(89.9)))):
        value = raw.shade_at(uv, at(polar(degrees, 1.0)), at(polar(70, 3.0)))
        assert_close(value, torch.full((3, 2, 2), expected, dtype=torch.float64), 1e-10)


@pytest.mark.parametrize(
    "lights",
    [hemisphere(), hemisphere(((60, 8),)), torch.stack([polar(d) for d in (-75, -30, 0, 45, 75)]).numpy(),
     scattered(6, 8)],
    ids=["rings", "one ring", "arc", "scattered"],
)
def test_continuous_along_any_path(lights):
    raw = RawBtf(btf_of(lights, hemisphere(((0, 1), (40, 5)))), dtype=torch.float64)
    step = 1e-3
    angle = torch.arange(-math.pi / 2, math.pi / 2, step, dtype=torch.float64)
    for azimuth in (0.0, 0.3, 1.9):
        path = from_polar(angle, torch.full_like(angle, azimuth), dim=0)[:, None]
        uv = torch.full((2, 1, len(angle)), 0.4, dtype=torch.float64)
        for value in (raw.shade_at(uv, path, at(polar(20, 1.0))), raw.shade_at(uv, at(polar(20, 1.0)), path)):
            jump = (value[:, 0, 2:] - value[:, 0, 1:-1]).abs().max()  # the first stands on the horizon
            assert float(value.max()) > 0.05
            assert float(jump) < 12 * step


@pytest.mark.parametrize("memory_gb", [2.0, 0.0])
def test_black_at_the_horizon_and_below(memory_gb):
    raw = RawBtf(btf_of(hemisphere(), hemisphere()), memory_gb=memory_gb, dtype=torch.float64)
    uv = texel_centres(HEIGHT, WIDTH, torch.float64)
    grazing, low = at(polar(90 - 1e-6, 0.2)), at([1.0, 0.0, 0.0])
    near = raw.shade_at(uv, grazing, at(polar(30)))
    assert 0 < float(near.max()) < 1e-6
    for other in (low, at(polar(100)), at([0.0, 0.0, -1.0])):
        assert not raw.shade_at(uv, other, at(polar(30))).any()
        assert not raw.shade_at(uv, at(polar(30)), other).any()
    assert torch.isfinite(raw.shade_at(uv, grazing, at(polar(90 - 1e-6, 0.2 + math.pi)))).all()


def test_missing_pairs_take_the_nearest_measured_one():
    lights, views = scattered(6, 10), scattered(5, 11)
    full = btf_of(lights, views)
    keep = torch.ones(30, dtype=torch.bool)
    keep[[4, 17, 18, 29]] = False
    kept = Btf.from_tensors(full.images(keep, torch.float64), full.light[keep], full.view[keep])
    raw, uv = RawBtf(kept, dtype=torch.float64), texel_centres(HEIGHT, WIDTH, torch.float64)
    for number in range(30):
        value = raw.shade_at(uv, at(full.light[number]), at(full.view[number]))
        expected = full.images([number], torch.float64)[0]
        if not keep[number]:
            place = torch.cat([d[:, :2] / (1 + d[:, 2:]) for d in (full.light, full.view)], dim=1)
            distance = (place - place[number]).norm(dim=1)
            nearest = int(torch.where(keep, distance, torch.inf).argmin())
            factor = full.light[number, 2] / full.light[nearest, 2]
            expected = full.images([nearest], torch.float64)[0] * factor
        assert_close(value, expected, 1e-10)


def test_scattered_pairs():
    light, view = scattered(25, 12), scattered(25, 13)
    btf = Btf.from_tensors(plausible_images(light, view, 3, 3), light, view)
    raw, uv = RawBtf(btf, dtype=torch.float64), texel_centres(3, 3, torch.float64)
    value = raw.shade_at(uv, *(d[:, :, None, None] for d in (btf.light, btf.view)))
    assert_close(value, btf.images(range(25), torch.float64), 1e-10)
    everywhere = torch.from_numpy(scattered(50, 14, 0.0))[:, :, None, None]
    value = raw.shade_at(uv, everywhere, everywhere.flip(0))
    assert bool(torch.isfinite(value).all()) and float(value.min()) >= 0


def test_too_scattered_to_interpolate():
    light, view = scattered(1001, 15), scattered(1001, 16)
    btf = Btf.from_tensors(np.ones((1001, 3, 1, 1)), light, view)
    with pytest.raises(DataError, match="memory: lights and views must form a grid .* 1002001 pairs, of which 1001"):
        RawBtf(btf)


def test_one_view_of_many_lights():
    light = np.concatenate((hemisphere(), [[0.0, 0.0, 1.0]]))[:-1]
    view = np.tile([[0.0, 0.0, 1.0]], (len(light), 1))
    btf = Btf.from_tensors(plausible_images(light, view), light, view)
    raw, uv = RawBtf(btf, dtype=torch.float64), texel_centres(HEIGHT, WIDTH, torch.float64)
    same = [raw.shade_at(uv, at(light[3]), at(polar(degrees, 1.0))) for degrees in (0, 30, 89)]
    for value in same:
        assert_close(value, btf.images([3], torch.float64)[0], 1e-10)


def test_of_a_pair_measured_twice_the_first_counts():
    light = torch.stack((polar(20), polar(20), polar(20, 2.0), polar(20, 4.0)))
    view = torch.tensor([POLE] * 4).double()
    images = torch.arange(1, 5).double()[:, None, None, None].expand(4, 3, 1, 1)
    raw = RawBtf(Btf.from_tensors(images, light, view), dtype=torch.float64)
    uv = torch.full((2, 1, 1), 0.5, dtype=torch.float64)
    assert_close(raw.shade_at(uv, at(light[0]), at(POLE)), torch.ones(3, 1, 1).double(), 1e-10)


def test_images_of_lights_below_the_surface_do_not_count():
    lights = np.concatenate((scattered(5, 17), [[0.8, 0.0, -0.6], [0.0, 1.0, 0.0]]))
    views, few = scattered(4, 18), lights[:5]
    light, view = all_pairs(lights, views)
    images = np.where(light[:, 2] > 0, 1, np.nan)[:, None, None, None] * plausible_images(light, view)
    weight = (light[:, 2] > 0).astype(float)[:, None, None, None] * np.ones((28, 1, HEIGHT, WIDTH))
    raw, expected = RawBtf(Btf.from_tensors(images, light, view, weight)), RawBtf(btf_of(few, views))
    direction = torch.from_numpy(scattered(30, 19, 0.0)).float()[:, :, None, None]
    uv = texel_centres(HEIGHT, WIDTH)
    values = [kind.shade_at(uv, direction, direction.flip(0)) for kind in (raw, expected)]
    assert_close(*values, 1e-6)


def test_texels_without_data_leave_their_share_to_others():
    lights = torch.stack((polar(30), polar(30, math.pi)))
    images = torch.full((2, 3, 1, 2), math.nan, dtype=torch.float64)
    weight = torch.zeros(2, 1, 1, 2)
    images[1, :, 0, 0], weight[1, 0, 0, 0] = 0.5, 1
    btf = Btf.from_tensors(images, lights, torch.tensor([POLE, POLE]).double(), weight)
    for memory_gb in (0.0, 1.0):
        raw = RawBtf(btf, memory_gb=memory_gb, dtype=torch.float64)
        uv = torch.tensor([[0.25, 0.4, 0.5]], dtype=torch.float64).repeat(2, 1)[:, None]
        assert_close(raw.shade_at(uv, at(POLE), at(POLE)), torch.full((3, 1, 3), 0.5, dtype=torch.float64))
        value = raw.shade_at(texel_centres(1, 2, torch.float64), at(lights[0]), at(POLE))
        assert bool(torch.isfinite(value).all())
        assert_close(raw.halved().shade_at(uv, at(POLE), at(POLE)), torch.full((3, 1, 3), 0.5, dtype=torch.float64))


def test_nothing_but_missing_data_is_black():
    images, weight = torch.full((1, 3, 2, 2), math.nan), torch.zeros(1, 1, 2, 2)
    raw = RawBtf(Btf.from_tensors(images, torch.tensor([POLE]), torch.tensor([POLE]), weight))
    assert not raw.shade_at(texel_centres(2, 2), at(POLE, torch.float32), at(POLE, torch.float32)).any()


def test_negative_noise_is_black():
    images = torch.full((1, 3, 1, 1), -1e-5)
    raw = RawBtf(Btf.from_tensors(images, torch.tensor([POLE]), torch.tensor([POLE])))
    assert not raw.shade_at(texel_centres(1, 1), at(POLE, torch.float32), at(POLE, torch.float32)).any()


@pytest.mark.parametrize("memory_gb", [2.0, 0.0])
def test_half_the_size_is_the_mean_of_four(memory_gb):
    btf = btf_of(scattered(5, 20), scattered(4, 21), size=(6, 4))
    half = RawBtf(btf, memory_gb=memory_gb, dtype=torch.float64).halved()
    assert half.size == (3, 2)
    light, view = (d[:, :, None, None] for d in (btf.light, btf.view))
    value = half.shade_at(texel_centres(3, 2, torch.float64), light, view)
    images = btf.images(range(len(btf)), torch.float64)
    assert_close(value, images.reshape(-1, 3, 3, 2, 2, 2).mean(dim=(3, 5)), 1e-10)


def test_halved_until_one_texel_is_left():
    btf = btf_of(scattered(5, 22), scattered(4, 23), size=(5, 8))
    raw, sizes = RawBtf(btf, dtype=torch.float64), []
    while raw.size != (1, 1):
        raw = raw.halved()
        sizes.append(raw.size)
    assert sizes == [(3, 4), (2, 2), (1, 1)]
    value = raw.shade_at(torch.full((2, 1, 1), 0.7, dtype=torch.float64), at(btf.light[7]), at(btf.view[7]))
    assert_close(value, btf.images([7], torch.float64)[0].mean(dim=(1, 2), keepdim=True), 1e-10)
    assert raw.halved().size == (1, 1)


def test_tiles_repeat_and_borders_go_on():
    btf = btf_of(scattered(5, 24), scattered(4, 25))
    light, view = at(btf.light[2]), at(btf.view[2])
    uv = torch.rand(2, 3, 3, dtype=torch.float64)
    raw = RawBtf(btf, dtype=torch.float64)
    moved = uv + torch.tensor([3.0, -2.0], dtype=torch.float64)[:, None, None]
    assert_close(raw.shade_at(moved, light, view), raw.shade_at(uv, light, view), 1e-10)
    corner = torch.tensor([7.0, -3.0], dtype=torch.float64)[:, None, None]  # far to the lower right
    value = RawBtf(btf, tiles=False, dtype=torch.float64).shade_at(corner, light, view)
    assert_close(value[:, 0, 0], btf.images([2], torch.float64)[0, :, -1, -1], 1e-10)


def test_leading_dimensions_broadcast():
    btf = btf_of(scattered(6, 26), scattered(5, 27))
    raw, uv = RawBtf(btf, dtype=torch.float64), torch.rand(2, 2, 3, dtype=torch.float64)
    light = torch.from_numpy(scattered(2, 28, 0.0))[:, None, :, None, None]
    view = torch.from_numpy(scattered(18, 29, 0.0)).reshape(3, 2, 3, 3).movedim(-1, 1)
    value = raw.shade_at(uv, light, view)
    assert value.shape == (2, 3, 3, 2, 3)
    for i in range(2):
        for j in range(3):
            assert torch.equal(value[i, j], raw.shade_at(uv, light[i, 0], view[j]))


@pytest.mark.parametrize("memory_gb", [2.0, 0.0])
def test_no_points(memory_gb):
    raw = RawBtf(btf_of(scattered(5, 30), scattered(4, 31)), memory_gb=memory_gb)
    nothing = torch.zeros(3, 1, 0)
    assert raw.shade_at(torch.zeros(2, 1, 0), nothing, nothing).shape == (3, 1, 0)


def test_two_runs_give_the_same_bits():
    btf = btf_of(hemisphere(), hemisphere())
    direction = torch.from_numpy(scattered(200, 32, 0.0)).float()
    uv = torch.rand(2, 1, 200)
    for memory_gb in (2.0, 0.0):
        runs = [RawBtf(btf, memory_gb=memory_gb) for _ in range(2)]
        first, second = (raw.shade_at(uv, planes(direction), planes(direction.flip(0))) for raw in runs)
        assert torch.equal(first, second)


def test_bad_input():
    btf = btf_of(scattered(5, 33), scattered(4, 34))
    raw, uv, pole = RawBtf(btf), texel_centres(HEIGHT, WIDTH), at(POLE, torch.float32)
    with pytest.raises(ShapeError, match=r"RawBtf.shade_at: uv must be \[2, H, W\]; it is \(3, 1, 1\)"):
        raw.shade_at(torch.zeros(3, 1, 1), pole, pole)
    with pytest.raises(ShapeError, match=r"light must be .*; it is \(3, 2, 2\).*dimension -3"):
        raw.shade_at(uv, torch.ones(3, 2, 2), pole)
    with pytest.raises(ShapeError, match="view must be"):
        raw.shade_at(uv, pole, torch.ones(1, 1, 3))
    with pytest.raises(RangeError, match="view must be torch.float32; it is torch.float64"):
        raw.shade_at(uv, pole, pole.double())
    with pytest.raises(RangeError, match="memory_gb must not be negative; it is -1"):
        RawBtf(btf, memory_gb=-1)
    below = Btf.from_tensors(torch.ones(1, 3, 1, 1), torch.tensor([[0.6, 0.0, -0.8]]), torch.tensor([POLE]))
    with pytest.raises(DataError, match="a light must stand above the surface; none does"):
        RawBtf(below)
