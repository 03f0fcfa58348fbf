"""Plans of the next photographs: the expected error is what simulation shows, the search finds it, and the files say it."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
import torch
from tests.support import all_pairs, assert_close, hemisphere, plausible_images

import torchmat as tm
from torchmat.btf.light_table import parse_lights
from torchmat.cli import main
from torchmat.errors import DataError, RangeError, ShapeError
from torchmat.fitting.certainty.expected import Design, likeness
from torchmat.fitting.certainty.search import choose
from torchmat.frames import spiral
from torchmat.report.planning import plan_picture, plan_table, write_plan

RNG = np.random.default_rng(2)
LIGHT = hemisphere(((0, 1), (30, 4), (45, 5)))


def design(texels=2, pairs=9, colours=1, ways=3, noise=0.3) -> Design:
    direction = spiral(pairs, 0.3)
    up = torch.tensor([[0.0, 0.0, 1.0]]).double().expand(pairs, 3)
    slope = torch.from_numpy(RNG.standard_normal((texels, pairs, colours, ways)))
    return Design(slope, noise, likeness(direction, up, direction, up))


def test_the_expected_error_is_the_mean_over_simulated_fits():
    one, chosen, targets = design(), [0, 2, 3, 5], [1, 4, 8]
    random, count = torch.Generator().manual_seed(0), 40_000
    misfit = torch.linalg.cholesky(one.noise * 0.8 * one.alike + 1e-9 * torch.eye(9).double())
    found = torch.zeros(3, dtype=torch.float64)
    for slope in one.slope[:, :, 0]:
        truth = torch.randn(3, count, generator=random, dtype=torch.float64)
        exact = slope @ truth + misfit @ torch.randn(9, count, generator=random, dtype=torch.float64)
        seen = exact[chosen] + math.sqrt(0.2 * one.noise) * torch.randn(4, count, generator=random, dtype=torch.float64)
        some = slope[chosen]
        fitted = torch.linalg.solve(some.T @ some + one.noise * torch.eye(3).double(), some.T @ seen)
        found += (slope[targets] @ fitted - exact[targets]).square().mean(dim=1) / 2
    assert_close(one.errors(chosen, targets), found, 0.03)


def test_one_more_pair_is_as_if_it_had_been_chosen():
    one, targets = design(colours=3), list(range(9))
    added = one.errors_with([0, 2, 3], [5, 7], targets)
    assert_close(added[0], one.errors([0, 2, 3, 5], targets), 1e-10)
    assert_close(added[1], one.errors([0, 2, 3, 7], targets), 1e-10)


def test_the_volume_is_that_of_the_covariance():
    one = design(texels=1)
    rows = [0, 2, 3, 6]
    covariance = one.noise * (0.8 * one.alike[rows][:, rows] + 0.2 * torch.eye(4).double())
    some = one.slope[0, rows, 0]
    told = some.T @ torch.linalg.inv(covariance) @ some + torch.eye(3).double()
    assert_close(one.volumes(rows[:3], [6])[0], torch.logdet(torch.linalg.inv(told)), 1e-10)


def test_the_search_is_at_least_as_good_as_any_pair_exchanged():
    one, every = design(pairs=12), list(range(12))
    found = choose(one, [0], every[1:], every, 3, "mean")
    best = float(one.errors([0, *found], every).mean())
    for place in range(3):
        others = found[:place] + found[place + 1 :]
        rest = [number for number in every[1:] if number not in others]
        assert best <= float(one.errors_with([0, *others], rest, every).mean(dim=1).min()) + 1e-12
    assert len(set(found)) == 3 and sorted(choose(one, [0], every[1:], every, 11, "D")) == every[1:]


def test_likeness_is_of_the_angle_between_lights():
    light = torch.tensor([[0.0, 0.0, 1.0], [math.sin(0.3), 0.0, math.cos(0.3)]]).double()
    up = light[:1].expand(2, 3)
    assert_close(likeness(light, up, light, up), torch.tensor([[1.0, math.exp(-0.5)], [math.exp(-0.5), 1.0]]).double(), 1e-7)


@pytest.fixture(scope="module")
def btf():
    view = np.tile((0.0, 0.0, 1.0), (len(LIGHT), 1))
    return tm.Btf.from_tensors(plausible_images(LIGHT, view).astype(np.float32), LIGHT.astype(np.float32), view.astype(np.float32))


@pytest.fixture(scope="module")
def found(btf):
    return tm.plan(btf, "ptm", count=3, polar_deg=75)


def test_a_plan_goes_where_no_light_was(found, btf):
    polar = torch.rad2deg(torch.arccos(found.light[:, 2]))
    assert float(polar.min()) > 50 and float(polar.max()) <= 75  # none was taken below 45 degrees
    assert bool((found.view == btf.view[0].double()).all()) and found.space == "srgb"
    assert_close(found.expected[[0, -1]].square(), torch.stack((found.before, found.after)).square().mean(dim=1), 1e-9)
    assert float(found.expected[-1]) < 0.8 * float(found.expected[0])
    assert bool((found.expected.diff() < 0).all())
    again = tm.plan(btf, "ptm", count=3, polar_deg=75)
    assert torch.equal(again.light, found.light)


def test_a_plan_of_what_can_be_taken_names_no_other_light(btf):
    light = torch.from_numpy(hemisphere(((60, 4), (70, 3))))
    view = torch.tensor([[0.0, 0.0, 1.0]]).double().expand(len(light), 3)
    some = tm.plan(btf, "ptm", count=2, candidates=(light, view), criterion="D")
    assert all(bool((light == one).all(dim=1).any()) for one in some.light)
    with pytest.raises(RangeError, match="count must be at most 7"):
        tm.plan(btf, "ptm", count=8, candidates=(light, view))


def test_texels_that_differ_and_views_that_are_free():
    light, view = all_pairs(hemisphere(((20, 3), (50, 4))), hemisphere(((0, 1), (40, 2))))
    images = plausible_images(light, view, 3, 3).astype(np.float32)
    btf = tm.Btf.from_tensors(images, light.astype(np.float32), view.astype(np.float32))
    start = tm.fit(btf, "texture", measure="none", tiles=False).material
    maps = {
        "diffuse": start.maps["albedo"].detach(), "specular_f0": torch.full((3, 3, 3), 0.06), "roughness": torch.full((1, 3, 3), 0.4),
    }
    material = tm.models.Microfacet(maps)
    lights, views = (torch.from_numpy(one) for one in all_pairs(hemisphere(((10, 2), (35, 4), (60, 5))), hemisphere(((15, 3), (45, 4)))))
    some = tm.plan(btf, material, count=2, candidates=(lights, views))
    # A mirror's pair tells its roughness: half vectors of what is proposed are nearer to the normal than those of most pairs.
    half = torch.nn.functional.normalize(some.light + some.view, dim=1)[:, 2]
    every = torch.nn.functional.normalize(lights + views, dim=1)[:, 2]
    assert float(half.min()) > float(every.median()) and some.space == "display"
    with pytest.raises(ShapeError, match="plan: material must have the size of the images"):
        tm.plan(btf.window(0, 0, 2, 2), material)


def test_a_plan_is_written_whole_and_its_lights_are_read_back(found, tmp_path):
    folder = write_plan(found, tmp_path / "plan")
    names = sorted(path.name for path in folder.iterdir())
    assert names == ["plan.json", "plan.lp", "plan.png"]
    table = parse_lights("plan.lp", (folder / "plan.lp").read_text("utf-8"))
    assert_close(torch.as_tensor(table.light).double(), found.light, 1e-6)
    assert json.loads((folder / "plan.json").read_text("utf-8"))["photographs"][0]["file"] == "next_001.jpg"
    write_plan(found, folder, pictures=False)
    (folder / "plan.lp").write_text("mine", encoding="utf-8")
    with pytest.raises(DataError, match="plan.lp"):
        write_plan(found, folder)
    assert plan_picture(found, tmp_path / "picture.png").stat().st_size > 10_000
    text = plan_table(found)
    assert "view polar" not in text and text.count("\n") >= 5


def test_the_command_prints_and_writes_the_plan(tmp_path, capsys):
    assert main(["plan", "sample", "--model", "ptm", "--views", "free", "--count", "1", "--crop", "0", "0", "3", "3", "--no-cache", "--out", str(tmp_path / "p")]) == 0
    said = capsys.readouterr().out
    assert "view polar" in said and "manifest.csv" in said
    assert (tmp_path / "p" / "manifest.csv").read_text("utf-8").startswith("file,view_polar_deg")
    assert main(["plan", "sample", "--criterion", "d"]) == 2
    assert "--criterion must be one of 'mean', 'D'" in capsys.readouterr().err


def test_what_cannot_be_planned_is_refused(btf):
    with pytest.raises(RangeError, match="plan: views must be one of"):
        tm.plan(btf, "ptm", views="some")
    with pytest.raises(RangeError, match="polar_deg must lie in"):
        tm.plan(btf, "ptm", polar_deg=90)
    with pytest.raises(RangeError, match="count must be at least 1"):
        tm.plan(btf, "ptm", count=0)
    with pytest.raises(RangeError, match="uncertainty of lptm"):
        tm.plan(btf, "lptm")
    with pytest.raises(ShapeError, match="candidates must be lights and views"):
        tm.plan(btf, "ptm", candidates=(torch.zeros(2, 3), torch.zeros(1, 3)))
