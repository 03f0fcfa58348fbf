"""Tables over half and difference angles: angles, both interpolations, ends and wraps, missing entries, files."""

from __future__ import annotations

import math
import struct
import tracemalloc

import numpy as np
import pytest
import torch
from tests.brdf.directions import HARD_PAIRS, graze, planes, random_directions, shade_and_differentiate
from tests.brdf.files import merl_bytes
from tests.reference.brdf import half_difference, merl_linear, merl_nearest
from tests.support import assert_close

from torchmat import load_brdf
from torchmat.brdf import AnalyticBrdf, MerlBrdf, RglBrdf, read_merl, tabulate, write_merl
from torchmat.brdf.half_difference import from_half_difference, to_half_difference
from torchmat.brdf.merl import bin_centres, fill_missing
from torchmat.errors import DataError, RangeError, ShapeError

SCALES = np.array([1 / 1500, 1.15 / 1500, 1.66 / 1500])


def random_table(*shape, seed=0, dtype=torch.float64):
    return torch.from_numpy(np.random.default_rng(seed).uniform(0.1, 2.0, shape)).to(dtype)


def test_angles_are_those_of_a_light_that_is_turned():
    light, view = random_directions(100, 1), random_directions(100, 2)
    found = torch.stack(to_half_difference(planes(light), planes(view)))[:, :, 0, 0]
    expected = np.array([half_difference(*row) for row in zip(light.tolist(), view.tolist(), strict=True)]).T
    expected[2] %= 2 * np.pi
    assert_close(found, torch.from_numpy(expected), 1e-7)  # the oracle's acos loses half of the digits near the pole


def test_angles_and_directions_are_inverse():
    half, difference, azimuth = (angle.flatten() for angle in torch.meshgrid(
        torch.linspace(0.1, 0.7, 4).double(), torch.linspace(0.1, 0.7, 4).double(),
        torch.linspace(0.1, 6.1, 9).double(), indexing="ij"
    ))
    light, view = from_half_difference(half[:, None], difference[:, None], azimuth[:, None])
    found = torch.stack(to_half_difference(light, view))[:, :, 0]
    assert_close(found, torch.stack((half, difference, azimuth)))


def test_angles_near_the_mirror_direction_are_exact_in_float32():
    # A cosine in float32 cannot tell 1e-5 radians from 0; the highlight of a mirror is that narrow.
    angle = torch.tensor([1e-5])
    light, view = from_half_difference(angle[:, None], torch.tensor([[0.5]]), torch.tensor([[1.0]]))
    assert_close(to_half_difference(light, view)[0], torch.tensor([[1e-5]]), 1e-2)


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("interpolation, oracle", [("linear", merl_linear), ("nearest", merl_nearest)])
def test_values_match_the_oracle(channels, interpolation, oracle):
    table = random_table(channels, 4, 3, 6)
    light, view = random_directions(150, 3), random_directions(150, 4)
    found = MerlBrdf(table, interpolation=interpolation).shade(planes(light), planes(view))[:, :, 0, 0]
    rows = zip(light.tolist(), view.tolist(), strict=True)
    expected = [np.broadcast_to(oracle(table.numpy(), *row), 3) * np.pi * row[0][2] for row in rows]
    assert found.shape == (150, 3)
    assert_close(found, torch.from_numpy(np.array(expected)), 1e-7 if interpolation == "linear" else 1e-12)


def test_both_interpolations_return_the_entries_at_the_centres_of_bins():
    table = random_table(3, 6, 5, 8)
    half, difference, azimuth = bin_centres((6, 5, 8))
    light, view = from_half_difference(half[:, None, None], difference[:, None], azimuth)
    above = (light[:, 2:3] > 0) & (view[:, 2:3] > 0)
    assert 0.5 < float(above.double().mean()) < 1
    for interpolation in ("linear", "nearest"):
        found = MerlBrdf(table, interpolation=interpolation).reflectance(light, view)
        assert_close(torch.where(above, found, 0), torch.where(above, table.movedim(0, 1), 0), 1e-12)


def test_the_azimuth_wraps_over_half_a_turn():
    brdf = MerlBrdf(random_table(3, 4, 4, 6))
    angles = torch.tensor([1e-9, math.pi - 1e-9, math.pi + 1e-9, 2 * math.pi - 1e-9], dtype=torch.float64)[:, None]
    light, view = from_half_difference(torch.tensor(0.4).double(), torch.tensor(0.5).double(), angles)
    found = brdf.reflectance(light, view)
    assert_close(found, found[:, :1].expand_as(found), 1e-7)


@pytest.mark.parametrize("polar, difference", [(0.0, 0.6), (0.6, 0.0), (0.0, 0.0)])
def test_values_are_continuous_where_the_azimuth_is_undefined(polar, difference):
    brdf = MerlBrdf(random_table(3, 5, 5, 6))
    angles = torch.linspace(0, 2 * math.pi, 13, dtype=torch.float64)[:, None]
    for step, bound in ((1e-6, 2e-2), (1e-10, 2e-4)):  # the half angle enters by its root
        polars = (torch.tensor(angle + step, dtype=torch.float64) for angle in (polar, difference))
        found = brdf.reflectance(*from_half_difference(*polars, angles))
        assert float((found - found[:, :1]).abs().max()) < bound


def test_reciprocal_and_isotropic():
    brdf = MerlBrdf(random_table(3, 5, 4, 6))
    light, view = planes(random_directions(40, 5)), planes(random_directions(40, 6))
    assert brdf.reciprocal and brdf.isotropic
    assert_close(brdf.reflectance(light, view), brdf.reflectance(view, light), 1e-9)
    turn = torch.tensor([[0.6, -0.8, 0], [0.8, 0.6, 0], [0, 0, 1]], dtype=torch.float64)
    turned = [torch.einsum("ij,njhw->nihw", turn, d) for d in (light, view)]
    assert_close(brdf.shade(*turned), brdf.shade(light, view), 1e-9)


def test_gradcheck_in_table_and_directions():
    table = random_table(1, 3, 3, 4).requires_grad_()
    light, view = (planes(random_directions(3, seed, 0.2)).requires_grad_() for seed in (7, 8))
    assert torch.autograd.gradcheck(lambda t, l, v: MerlBrdf(t).shade(l, v), (table, light, view))


def test_the_gradient_of_a_table_is_the_same_with_two_threads():
    table = random_table(3, 10, 10, 20, dtype=torch.float32).requires_grad_()
    light, view = (planes(random_directions(15_000, seed), torch.float32) for seed in (9, 10))
    threads, found = torch.get_num_threads(), []
    for count in (1, 2):
        torch.set_num_threads(count)
        found.append(torch.autograd.grad(MerlBrdf(table).shade(light, view).square().sum(), table)[0])
    torch.set_num_threads(threads)
    assert torch.equal(*found)


def test_case_1_interpolated_values_at_hard_directions_match_the_oracle_and_gradients_are_finite(dtype):
    for pair, directions in HARD_PAIRS.items():
        table = random_table(3, 5, 4, 6, dtype=dtype).requires_grad_()
        found = shade_and_differentiate(MerlBrdf(table), *directions, dtype, table)[:, 0, 0]
        exact = [np.array(one) / np.linalg.norm(one) for one in directions]
        expected = merl_linear(table.detach().double().numpy(), *exact) * np.pi * exact[0][2]
        # At mirrored directions the oracle's acos has half of its digits; float32 rounds the light at 1e-7 by 1e-8.
        np.testing.assert_allclose(found, expected, rtol=1e-5 if dtype == torch.float64 else 2e-2, err_msg=pair)


def test_case_1_the_nearest_values_at_hard_directions_are_entries_of_the_table_and_gradients_finite(dtype):
    same = []
    for pair, directions in HARD_PAIRS.items():
        table = random_table(3, 5, 4, 6, dtype=dtype).requires_grad_()
        brdf = MerlBrdf(table, interpolation="nearest")
        found = shade_and_differentiate(brdf, *directions, dtype, table)[:, 0, 0].double() / (math.pi * directions[0][2])
        off = (table.detach().double() / found[:, None, None, None] - 1).abs().amax(dim=0)
        assert float(off.min()) < 1e-5, f"{pair}: {found} is no entry"
        expected = torch.from_numpy(merl_nearest(table.detach().double().numpy(), *directions))
        same += [pair] if float((found / expected - 1).abs().max()) < 1e-5 else []
    # Directions on the edge between bins may round into either.
    assert len(same) >= (10 if dtype == torch.float64 else 6), same


def test_case_2_value_is_continuous_on_the_way_into_the_horizon():
    heights = [10.0**-k for k in range(2, 9)]
    light, view = (planes([graze(a, h) for h in heights]) for a in (0.3, 0.8))
    steps = MerlBrdf(random_table(3, 5, 4, 6)).shade(light, view).diff(dim=0).abs().amax(dim=(1, 2, 3))
    assert float(steps[-1]) < 1e-3
    assert float(steps[-1]) <= float(steps[0])


def test_case_10_a_table_of_one_entry_is_lambert():
    brdf = MerlBrdf(torch.full((1, 1, 1, 1), 0.25, dtype=torch.float64))
    light, view = planes(random_directions(9, 11)), planes(random_directions(9, 12))
    expected = (0.25 * math.pi * light[:, 2:3]).expand(-1, 3, -1, -1)
    assert_close(brdf.shade(light, view), expected, 1e-12)


def test_missing_entries_take_the_nearest_along_the_difference_angle():
    table = torch.arange(1, 9, dtype=torch.float64).reshape(1, 1, 8, 1).repeat(1, 2, 1, 1)
    missing = torch.zeros(2, 8, 1, dtype=torch.bool)
    missing[0, [0, 3, 4, 5, 7], 0] = True
    missing[1] = True
    filled = fill_missing(table, missing)
    assert filled[0, 0, :, 0].tolist() == [2, 2, 3, 3, 3, 7, 7, 7]
    assert torch.equal(filled[0, 1], filled[0, 0])  # a row with nothing at all takes the nearest one
    assert not bool(fill_missing(table, torch.ones_like(missing)).any())


def test_entries_along_the_azimuth_serve_where_nothing_else_does():
    table = torch.tensor([5.0, 6.0, 7.0])[None, None, None]
    filled = fill_missing(table, torch.tensor([True, False, True])[None, None])
    assert filled.flatten().tolist() == [6, 6, 6]


def test_a_tabulated_formula_is_close_to_the_formula():
    ggx = AnalyticBrdf("ggx", diffuse=(0.3, 0.2, 0.1), specular=0.1, roughness=0.4)
    found = tabulate(ggx, (45, 30, 36))
    assert found.resolution == (45, 30, 36) and 0 < found.missing_count < 45 * 30 * 36 / 2
    light, view = (planes(random_directions(400, seed, 0.2), torch.float32) for seed in (13, 14))
    expected = ggx.shade(light, view)
    error = float((found.shade(light, view) - expected).square().sum() / expected.square().sum())
    assert error < 1e-4  # measured 2e-5


def test_tabulating_a_table_returns_its_entries():
    table = random_table(3, 6, 5, 8)
    found = tabulate(MerlBrdf(table), (6, 5, 8))
    there = ~found.missing
    assert_close(found.table[:, there], table[:, there], 1e-12)


def test_tabulating_averages_what_is_not_reciprocal():
    class Sloped(MerlBrdf):
        reciprocal = False

        def value(self, light, view):
            return (math.pi * light[..., 2:3, :, :] * view[..., 2:3, :, :] ** 2).expand(3, -1, -1)

    sloped = Sloped(random_table(1, 1, 1, 1))
    found = tabulate(sloped, (4, 4, 4))
    half, difference, azimuth = bin_centres((4, 4, 4))
    light, view = from_half_difference(half[1], difference[2], azimuth[1].reshape(1, 1))
    expected = (light[2] ** 2 + view[2] ** 2) / 2
    assert_close(found.table[0, 1, 2, 1].reshape(1, 1), expected, 1e-12)


def test_an_anisotropic_brdf_has_no_such_table():
    aniso = AnalyticBrdf("ggx_anisotropic", roughness_along=0.2, roughness_across=0.4)
    with pytest.raises(RangeError, match="brdf must be isotropic; ggx_anisotropic is not"):
        tabulate(aniso, (2, 2, 2))
    with pytest.raises(RangeError, match="three numbers"):
        tabulate(AnalyticBrdf("lambert"), (2, 0, 2))


def test_a_file_of_the_database_is_read_with_its_scales(tmp_path):
    stored = np.random.default_rng(15).uniform(0, 3000, (3, 90, 90, 180))
    stored[:, 80:, 70:] = -1  # what was below the horizon
    path = tmp_path / "made up.binary"
    path.write_bytes(merl_bytes(stored))
    brdf = load_brdf(path)
    assert isinstance(brdf, MerlBrdf) and brdf.resolution == (90, 90, 180)
    assert brdf.missing_count == 10 * 20 * 180
    expected = torch.from_numpy(stored * SCALES[:, None, None, None]).float()
    assert_close(brdf.table[:, :80], expected[:, :80], 1e-7)
    assert torch.equal(brdf.table[:, 80:, 70:], brdf.table[:, 80:, 69:70].expand(-1, -1, 20, -1))
    # The index arithmetic of BRDFRead.cpp, on the bytes themselves.
    light, view = random_directions(1, 16)[0], random_directions(1, 17)[0]
    half, difference, azimuth = half_difference(light.tolist(), view.tolist())
    index = int(azimuth % math.pi / math.pi * 180) + 180 * int(difference / (math.pi / 2) * 90)
    index += 180 * 90 * int(math.sqrt(half / (math.pi / 2)) * 90)
    numbers = [struct.unpack_from("<d", path.read_bytes(), 12 + 8 * (index + c * 1_458_000))[0] for c in range(3)]
    nearest = read_merl(path, torch.float64, interpolation="nearest")
    found = nearest.reflectance(*planes(np.stack((light, view)))[:, None])
    assert_close(found[0, :, 0, 0], torch.from_numpy(np.array(numbers) * SCALES), 1e-12)


def test_a_written_file_reads_back(tmp_path, dtype):
    brdf = tabulate(AnalyticBrdf("cook_torrance", roughness=0.3, diffuse=(0.1, 0.2, 0.3), dtype=dtype), (8, 7, 6))
    path = write_merl(tmp_path / "short.binary", brdf)
    assert path.stat().st_size == 12 + 3 * 8 * 8 * 7 * 6
    again = load_brdf(path, dtype)
    assert again.dtype == dtype
    assert torch.equal(again.missing, brdf.missing) and again.missing_count == brdf.missing_count > 0
    assert_close(again.table, brdf.table, 1e-7 if dtype == torch.float32 else 1e-15)
    assert write_merl(tmp_path / "twice.binary", again).read_bytes() == path.read_bytes()
    assert sorted(p.name for p in tmp_path.glob("*.binary")) == ["short.binary", "twice.binary"]
    assert not [p for p in tmp_path.iterdir() if "building" in p.name]


def test_a_formula_is_tabulated_at_the_size_of_the_database_when_written(tmp_path):
    path = write_merl(tmp_path / "lambert.binary", AnalyticBrdf("lambert", diffuse=(0.2, 0.4, 0.6)))
    assert path.stat().st_size == 12 + 3 * 8 * 90 * 90 * 180
    assert struct.unpack_from("<3i", path.read_bytes()) == (90, 90, 180)
    light, view = (planes(random_directions(50, seed, 0.1), torch.float32) for seed in (18, 19))
    expected = torch.tensor([0.2, 0.4, 0.6])[:, None, None] * light[:, 2:3]
    assert_close(read_merl(path).shade(light, view), expected, 1e-6)


def test_a_grey_table_is_written_three_times(tmp_path):
    table = random_table(1, 3, 4, 5)
    again = read_merl(write_merl(tmp_path / "grey.binary", MerlBrdf(table)), torch.float64)
    assert_close(again.table, table.expand(3, -1, -1, -1), 1e-15)


def test_reading_holds_one_channel_in_float64_at_a_time(tmp_path):
    entries = 90 * 90 * 90
    path = tmp_path / "half.binary"
    path.write_bytes(merl_bytes(np.ones((3, 90, 90, 90))))
    tracemalloc.start()  # sees NumPy's memory, where the float64 numbers are; torch's holds the float32 table
    read_merl(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 2.5 * 8 * entries


def test_writing_to_no_folder_is_an_error_that_leaves_nothing(tmp_path):
    brdf = MerlBrdf(random_table(1, 1, 1, 1))
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(DataError, match="x.binary: the file must be writable"):
        write_merl(tmp_path / "file" / "x.binary", brdf)
    (tmp_path / "folder.binary").mkdir()
    with pytest.raises(DataError, match="folder.binary"):
        write_merl(tmp_path / "folder.binary", brdf)
    assert [p.name for p in tmp_path.iterdir() if "binary" in p.name] == ["folder.binary"]


@pytest.mark.parametrize(
    "error, words, table",
    [
        (ShapeError, "table must be", torch.ones(2, 3, 3, 3)),
        (ShapeError, "table must be", torch.ones(3, 3, 3)),
        (ShapeError, "table must be", torch.ones(3, 0, 3, 3)),
        (RangeError, "2 entries are negative", torch.tensor([-1.0, 1.0, -1.0]).reshape(3, 1, 1, 1)),
        (RangeError, "finite", torch.full((1, 2, 2, 2), math.nan)),
    ],
)
def test_bad_tables_are_refused_by_name(error, words, table):
    with pytest.raises(error, match=words):
        MerlBrdf(table)


def test_bad_options_are_refused_by_name():
    with pytest.raises(RangeError, match="interpolation must be one of 'linear', 'nearest'"):
        MerlBrdf(torch.ones(1, 1, 1, 1), interpolation="cubic")
    with pytest.raises(ShapeError, match="missing must be"):
        MerlBrdf(torch.ones(1, 2, 1, 1), missing=torch.ones(1, 1, 1, dtype=torch.bool))
    assert not RglBrdf.reciprocal
