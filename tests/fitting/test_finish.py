"""The finish: rays that move with the height, pictures that get better, a height that does not get worse, and when it is left out."""

from __future__ import annotations

import functools
import math

import numpy as np
import pytest
import torch
from tests.fitting.reference_scene import waves
from tests.support import all_pairs, assert_close, hemisphere

import torchmat as tm
from torchmat import Btf
from torchmat.fitting import finish as module
from torchmat.fitting.finish import finish
from torchmat.fitting.relief.followed import Followed
from torchmat.fitting.training import Fitted, Training, make_training
from torchmat.geometry import normals_from_slopes, slopes_from_height
from torchmat.models import Lambert
from torchmat.models.relief_maps import rays
from torchmat.solvers.clock import Watch

SIZE = 16


@functools.lru_cache(maxsize=None)
def truth(depth: float = 0.08) -> Lambert:
    """A matte relief of a few waves whose normals are its height's."""
    height = torch.from_numpy(depth * waves(SIZE, SIZE, 1, 6, 3)[0])[None].float()
    albedo = torch.from_numpy(np.stack([0.3 + 0.5 * waves(SIZE, SIZE, seed, 4, 2)[0] for seed in (5, 6, 7)])).float()
    normal = normals_from_slopes(slopes_from_height(height))
    return Lambert({"albedo": albedo, "normal": normal}).on_relief(height, 0.05 * albedo).with_relief("fine")


@functools.lru_cache(maxsize=None)
def data(depth: float = 0.08, noise: float = 0.0) -> Btf:
    """Pictures of it under 6 lights from 6 views."""
    light, view = all_pairs(hemisphere(((15, 2), (55, 4))), hemisphere(((0, 1), (40, 5))))
    planes = [torch.from_numpy(d).float()[:, :, None, None] for d in (light, view)]
    images = truth(depth).shade(*planes).detach().numpy()
    images = images + noise * np.random.default_rng(0).standard_normal(images.shape).astype(np.float32)
    return Btf.from_tensors(images.clip(0), light, view)


def training(btf: Btf, **more) -> Training:
    made = make_training(btf, torch.arange(len(btf)), 0, True, torch.float32, False, more.pop("watch", None))
    return Training(**{**vars(made), "relief": "fine", **more})


def blurred(depth: float = 0.08) -> Lambert:
    """The truth, its height off by waves of their own and its maps by as much as a fit on samples brought onto it is."""
    true = truth(depth)
    off = torch.from_numpy(0.6 * depth * (waves(SIZE, SIZE, 9, 5, 4)[0] - 0.5))[None].float()
    albedo = true.maps["albedo"].detach()
    dull = 0.9 * albedo + 0.1 * albedo.mean(dim=(1, 2), keepdim=True)
    return true.with_maps(height=true.maps["height"].detach() + off, albedo=dull)


def height_error(material, depth: float = 0.08) -> float:
    gap = material.maps["height"].detach() - truth(depth).maps["height"].detach()
    return float((gap - gap.mean()).square().mean().sqrt())


def distinct(btf: Btf) -> tuple[torch.Tensor, torch.Tensor]:
    return btf.lights[:, :, None, None].float(), btf.views[:, :, None, None].float()


def test_rays_of_an_unchanged_height_are_those_of_the_picture():
    height, (lights, views) = truth().maps["height"].detach(), distinct(data())
    with torch.no_grad():
        met = Followed(height, lights, views, True).on(height, torch.arange(6), torch.arange(6))
        wanted = rays(height, lights, views, True, "fine")
    assert_close(met.ends[met.view], wanted.ends[wanted.view], 1e-4)
    assert_close(met.lit[met.light], wanted.lit[wanted.light], 1e-3)


def test_rays_move_with_a_height_that_changes_a_little():
    height, (lights, views) = truth(0.03).maps["height"].detach(), distinct(data())
    change = torch.from_numpy(2e-4 * waves(SIZE, SIZE, 3, 4, 3)[0])[None].float()
    with torch.no_grad():
        every = torch.arange(6)
        moved = Followed(height, lights, views, True).on(height + change, every, every)
        wanted, before = (rays(one, lights, views, True, "fine") for one in (height + change, height))
    wanted, before, moved = (one.ends[one.view] for one in (wanted, before, moved))
    far = float((wanted - before).abs().max())
    assert far > 1e-4 and float((moved - wanted).abs().max()) < 0.1 * far


def test_it_pays_where_maps_and_height_are_off_and_the_height_gets_nearer():
    fitted = finish(training(data()), Fitted(blurred()), True, 0.4)
    told = fitted.figures["finish"]
    assert told["kept"] and told["after"]["kept back"]["psnr_db"] > told["before"]["kept back"]["psnr_db"] + 3
    assert told["height_moved_texels"] > 0 and height_error(fitted.material) < 0.96 * height_error(blurred())
    assert fitted.material.relief == "fine" and set(fitted.material.maps) == {*truth().maps, "ambient_falloff"}
    # A height that is off by waves brings much by moving, and light between texels is the same under every light there.
    assert told["height_moves"] and set(told["light_between"]) == {"map", "radiosity"}


def test_where_nothing_can_get_better_the_fit_stays_to_the_bit():
    begun = Fitted(truth())
    fitted = finish(training(data()), begun, True, 0.2)
    assert not fitted.figures["finish"]["kept"] and fitted.figures["finish"]["why"]
    assert fitted.material is begun.material


def test_slopes_hold_the_height_against_noise(monkeypatch):
    # Pictures with noise get better by a height that follows it; the tie does not let it.
    depth = 0.08
    btf, begun = data(depth, 0.05), Fitted(truth(depth))
    monkeypatch.setattr(module, "_better", lambda before, after: True)
    monkeypatch.setattr(module, "_MOVES_DB", -math.inf)
    held = height_error(finish(training(btf), begun, True, 0.15).material, depth)
    monkeypatch.setattr(module, "_INDEPENDENT", 1e6)
    free = height_error(finish(training(btf), begun, True, 0.15).material, depth)
    # Of a relief of 0.08 texture widths, measured 5e-5 held, and 4e-3 free; 1e-5 and as much on one of 0.01.
    assert held < 5e-4 and free > 2e-3


def test_a_height_that_is_given_stays_to_the_bit(monkeypatch):
    monkeypatch.setattr(module, "_STEPS", 10)  # one step that moved it would show, and one that may is kept
    monkeypatch.setattr(module, "_MOVES_DB", -math.inf)
    monkeypatch.setattr(module, "_better", lambda before, after: True)
    height = truth().maps["height"].detach()
    result = tm.fit(data(), "lambert", geometry=height, relief="fine", measure=False)
    assert torch.equal(result.material.maps["height"].detach(), height)
    assert result.material.relief == "fine" and "kept" in result.report["figures"]["finish"]
    plain = tm.fit(data(), "lambert", geometry=height, relief="fine", finish=False, measure=False)
    assert "finish" not in plain.report["figures"]


def test_it_is_the_same_twice():
    found = [finish(training(data()), Fitted(blurred()), True, effort=0.06).material for _ in range(2)]
    assert all(torch.equal(found[0].maps[name], value) for name, value in found[1].maps.items())


@pytest.mark.parametrize("why, more, material", [
    ("no relief", {}, truth().with_relief("fast")), ("no relief", {}, truth().without_relief()),
    ("no seconds", {"watch": Watch(0.0)}, truth()),
])
def test_it_says_why_it_is_left_out(why, more, material):
    fitted = finish(training(data(), **more), Fitted(material), True)
    assert fitted.material is material and why in fitted.figures["finish"]["why"]


def test_too_few_samples_are_not_parted():
    own = training(data())
    few = torch.zeros_like(own.used)
    few[:5] = True
    fitted = finish(training(data(), used=few), Fitted(truth()), True)
    assert "too few" in fitted.figures["finish"]["why"]


def lit_by_radiosity() -> Lambert:
    """The matte relief, three times as deep, where light goes between texels."""
    true = truth(0.24)
    return true.on_relief(true.maps["height"].detach(), indirect=torch.ones(1)).with_relief("fine")


def test_light_between_texels_is_told_by_radiosity_where_that_is_what_it_is():
    light, view = all_pairs(hemisphere(((15, 2), (55, 4))), hemisphere(((0, 1), (40, 5))))
    planes = [torch.from_numpy(d).float()[:, :, None, None] for d in (light, view)]
    with torch.no_grad():
        btf = Btf.from_tensors(lit_by_radiosity().shade(*planes).numpy(), light, view)
    true = truth(0.24)
    begun = true.on_relief(true.maps["height"].detach(), 0.02 * torch.ones(3, SIZE, SIZE)).with_relief("fine")
    fitted = finish(training(btf), Fitted(begun), False, 0.3)
    assert fitted.figures["indirect"] == "radiosity" and "ambient" not in fitted.material.maps
    assert float(fitted.material.maps["indirect"].detach()) == pytest.approx(1, abs=0.15)
    kept = finish(training(btf, indirect="map"), Fitted(begun), False, 0.3)
    assert kept.figures["indirect"] == "map" and "light_between" not in kept.figures["finish"]
    better, worse = (one.figures["finish"]["after"]["kept back"]["psnr_db"] for one in (fitted, kept))
    assert better > worse + 0.5


@pytest.mark.parametrize(("way", "there", "gone"), [("none", (), ("ambient", "indirect")), ("radiosity", ("indirect",), ("ambient",))])
def test_a_way_that_is_asked_for_is_taken(way, there, gone):
    result = tm.fit(data(), "lambert", geometry=truth().maps["height"].detach(), indirect=way, relief="fast", holdout=0, measure=False)
    assert all(name in result.material.maps for name in there) and not any(name in result.material.maps for name in gone)
    assert result.report["figures"]["indirect"] == way


def test_radiosity_needs_a_diffuse_colour_and_a_whole_fit():
    height = truth().maps["height"].detach()
    with pytest.raises(tm.RangeError, match="ptm has no diffuse colour that sends light"):
        tm.fit(data(), "ptm", geometry=height, indirect="radiosity", measure=False)
    with pytest.raises(tm.RangeError, match="indirect must be left to a fit of one model as a whole"):
        tm.fit(data(), "lambert", geometry=height, indirect="radiosity", tile_size=8, measure=False)
    with pytest.raises(tm.RangeError, match="indirect must be one of"):
        tm.fit(data(), "lambert", indirect="radiosty", measure=False)
