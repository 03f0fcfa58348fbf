"""Fits for a scene: weighted sums against loops, the whole fit where all is used alike, windows, smaller copies."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch
from tests.models.examples import PLAIN
from tests.fitting.reference_scene import relief_scene
from tests.support import all_pairs, assert_close, hemisphere, plausible_images

import torchmat as tm
from torchmat import Btf, DataError, RangeError, Scene, fit
from torchmat.btf.interpolated import RawBtf
from torchmat.fitting.evaluate import comparable
from torchmat.fitting.geometry import Flat
from torchmat.fitting.models.linear import LambertShared
from torchmat.fitting.models.lobe import fit_lobe
from torchmat.fitting.models.streamed import solve_texels, stream_moments
from torchmat.fitting.recipe import RECIPES
from torchmat.fitting.relief.surface import bring_onto, without_shadow
from torchmat.fitting.scene.fit import choose
from torchmat.fitting.training import Training, make_training
from torchmat.metrics import relative
from torchmat.models.lobes import LOBES
from torchmat.rendering import Camera, render
from torchmat.solvers.least_squares import make_design

LIGHTS, VIEWS = hemisphere(), hemisphere(((0, 1), (30, 5), (60, 7)))
WEIGHING = ("texture", "lambert", "ptm", "lptm", "hsh", "phong_srf", "pca", "rbf", "shading_map", "sphere_images")
SMALL = {
    "pca": {"components": 3}, "local_pca": {"components": 2, "clusters": 2}, "rbf": {"components": 5}, "sphere_images": {"size": 12},
    "distribution": {"geometry": "flat", "lobes": 1, "effort": 0.02, "specular_size": 12, "fresnel": False, "rotation": False},
    "neural": {"geometry": "flat", "effort": 0.02},
    "microfacet": {"geometry": "flat", "effort": 0.02, **PLAIN},
}


@pytest.fixture(scope="module")
def btf() -> Btf:
    light, view = all_pairs(LIGHTS, VIEWS)
    return Btf.from_tensors(plausible_images(light, view, 16, 16), light, view)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return Scene("sphere", [(0.4, 0.5, 0.8)], size=40, repeat=2.0)


def near_quad(pixels: int = 24) -> Scene:
    """Return a scene that sees the middle of a quad under one light."""
    camera = Camera((0.0, 0.0, 4.0), target=(0.0, 0.0, 0.0), width=0.3)
    return Scene("quad", [(0.3, 0.2, 0.9)], camera, size=pixels, rays=1)


def everything(btf: Btf, importance: float = 1.0) -> Training:
    """Return a training in which each sample is said to count the same."""
    training = make_training(btf, torch.arange(len(btf)), 0, True, torch.float64, False)
    return Training(btf, training.used, dtype=torch.float64, importance=torch.full((len(btf),), importance).double())


def whole_error(material, scene: Scene, btf: Btf) -> float:
    truth, found = scene.picture(RawBtf(btf, dtype=material.dtype)), render(material, scene)
    return relative(float((found - truth).square().sum()), float(truth.square().sum()))


def test_weighted_least_squares_is_that_of_a_loop_over_texels():
    random = np.random.default_rng(0)
    matrix, importance = random.normal(size=(30, 4)), random.uniform(0, 3, 30)
    values, weight = random.uniform(0, 1, (30, 3, 2, 3)), random.uniform(size=(30, 2, 3)) < 0.7
    importance[4] = 0
    directions = torch.from_numpy(np.tile([[0.0, 0.0, 1.0]], (30, 1)))
    btf = Btf.from_tensors(values, directions, directions, weight)
    used = torch.ones(30, dtype=torch.bool)
    design = make_design(torch.from_numpy(matrix), used, importance=torch.from_numpy(importance))
    found = solve_texels(btf, design, stream_moments(btf, design, used, torch.float64), used).coefficients
    for row in range(2):
        for column in range(3):
            root = np.sqrt(importance * weight[:, row, column])[:, None]
            expected = np.linalg.lstsq(root * matrix, root * values[:, :, row, column], rcond=None)[0]
            assert_close(found[:, :, row, column], expected, 1e-10)


def test_a_weighted_lobe_is_that_of_repeated_samples():
    random = np.random.default_rng(1)
    light, view = (torch.from_numpy(d)[:, :, None, None] for d in all_pairs(LIGHTS, VIEWS))
    values = torch.from_numpy(random.uniform(0, 1, (len(light), 3)))
    times = torch.from_numpy(random.integers(1, 4, len(light)))
    found, _ = fit_lobe(LOBES["phong"], light, view, values, importance=times.double())
    again = torch.arange(len(light)).repeat_interleave(times)
    expected, _ = fit_lobe(LOBES["phong"], light[again], view[again], values[again])
    assert_close(found, expected, 1e-5)  # where Levenberg-Marquardt stops; measured 2e-7


@pytest.mark.parametrize("model", WEIGHING)
def test_samples_that_count_alike_give_the_plain_fit(btf, model):
    options, plain = SMALL.get(model, {}), Training(btf, torch.ones(len(btf), dtype=torch.bool), dtype=torch.float64)
    with torch.no_grad():
        expected, found = (RECIPES[model].run(t, **options).material for t in (plain, everything(btf)))
    for name, value in expected.maps.items():
        assert_close(found.maps[name], value, 1e-9)


@pytest.mark.parametrize("model", ("texture", "lambert", "ptm", "hsh"))
def test_a_sample_that_counts_twice_is_the_sample_given_twice(btf, model):
    times = torch.ones(len(btf)).double()
    times[::3] = 2
    training = Training(btf, torch.ones(len(btf), dtype=torch.bool), dtype=torch.float64, importance=times)
    doubled = btf.picked(torch.cat((torch.arange(len(btf)), torch.arange(0, len(btf), 3))))
    with torch.no_grad():
        found = RECIPES[model].run(training).material
        expected = RECIPES[model].run(everything(doubled)).material
    for name, value in expected.maps.items():
        assert_close(found.maps[name], value, 1e-9)


@pytest.mark.parametrize("model", ("lambert", "ptm"))
def test_on_a_relief_too_a_sample_that_counts_twice_is_the_sample_given_twice(model):
    """Lambert keeps samples in shadow and fits ambient light itself; all others fit what is lit. Some are held out."""
    small = {"rows": 10, "columns": 12, "views": ((0, 1), (40, 2)), "lights": ((15, 1), (35, 4), (60, 3))}
    btf = relief_scene(**small).btf(np.float64)
    height = relief_scene(**small).true_height
    held_out = torch.arange(len(btf)) % 5 == 1
    counts = torch.where(held_out, 9.0, 1.0 + (torch.arange(len(btf)) % 3 == 0)).double()
    again = torch.cat((torch.arange(len(btf))[~held_out], torch.nonzero((counts == 2) & ~held_out)[:, 0]))
    found = []
    for data, used, importance in (
        (btf, ~held_out, counts), (btf.picked(again), torch.ones(len(again), dtype=torch.bool), None), (btf, ~held_out, None),
    ):
        shared = LambertShared(mean_value=0.3)  # that of all texels and samples, however often they count
        training = Training(data, used, dtype=torch.float64, progress=False, importance=importance, shared=shared)
        surface = bring_onto(training, height)
        with torch.no_grad():
            if model == "lambert":
                found.append(RECIPES[model].on_relief(surface, height).material)
            else:
                found.append(RECIPES[model].run(without_shadow(surface, torch.full((3, 10, 12), 0.01).double())).material)
    counted, twice, alike = found
    for name in set(counted.maps) - {"height"}:
        assert_close(counted.maps[name], twice.maps[name], 1e-9)
    value = "albedo" if model == "lambert" else "polynomial"
    assert float((counted.maps[value] - alike.maps[value]).detach().abs().max()) > 1e-3, "the counts make no difference"


def test_images_are_drawn_as_often_as_they_count(btf):
    importance = torch.zeros(len(btf)).double()
    importance[3], importance[8] = 3.0, 1.0
    training = Training(btf, torch.ones(len(btf), dtype=torch.bool), importance=importance)
    drawn = torch.cat([training.drawn(torch.arange(len(btf)), torch.Generator().manual_seed(s)) for s in range(20)])
    assert set(drawn.tolist()) == {3, 8}
    assert float((drawn == 3).double().mean()) == pytest.approx(0.75, abs=0.03)
    again = [training.drawn(torch.arange(len(btf)), torch.Generator().manual_seed(1)) for _ in range(2)]
    assert torch.equal(*again)


@pytest.mark.parametrize("model", sorted(RECIPES))
def test_every_model_fits_a_scene_and_reports_it(btf, scene, model):
    result = fit(btf, model, scene=scene, **SMALL.get(model, {}))
    found = result.report["scene"]
    assert 0 < found["samples"] < 0.75 * len(btf) and 0 < found["samples_share"] < 1
    assert found["bytes"] <= found["whole_bytes"]
    for name in ("inside_points", "inside_held_out", "outside_held_out"):
        assert np.isfinite(found[name])
    json.dumps(found)
    assert bool(torch.isfinite(render(result.material, scene)).all())


@pytest.mark.parametrize("model", ("texture", "lambert", "ptm", "phong_srf"))
def test_inside_of_the_scene_the_error_is_smaller_than_that_of_the_whole_fit(btf, scene, model):
    errors = [whole_error(fit(btf, model, measure=False, scene=s).material, scene, btf) for s in (None, scene)]
    assert errors[1] < errors[0]


def test_samples_that_the_scene_uses_are_kept_and_count_most(btf, scene):
    training = make_training(btf, torch.arange(len(btf)), 0, True, torch.float32, False)
    choice = choose(training, scene.use(), Flat())
    weight = scene.use().sample_weights(btf.light, btf.view).weight
    assert float(weight[choice.rows].sum()) > 0.95
    assert float(choice.importance.mean()) == pytest.approx(1)
    assert int(choice.rows[choice.importance.argmax()]) == int(weight.argmax())
    frontal = btf.view_index == 0
    assert set(frontal.nonzero()[:, 0].tolist()) <= set(choice.rows.tolist())


def test_held_out_samples_leave_no_trace(btf, scene):
    rows = torch.arange(0, len(btf), 2)
    training = make_training(btf, rows, 0, True, torch.float32, False)
    assert set(choose(training, scene.use(), Flat()).rows.tolist()) <= set(rows.tolist())


def test_a_window_of_the_texture_gives_the_picture_of_the_whole(btf):
    scene = near_quad()
    result = fit(btf, "ptm", scene=scene, measure=False)
    found = result.report["scene"]
    assert result.material.cutout is not None and result.material.size == tuple(found["window"][2:])
    assert found["bytes"] < 0.3 * found["whole_bytes"] and found["texels_share"] < 0.3
    # The same weights without a window: a scene that is told to have none.
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("torchmat.scene_use.SceneUse.window", lambda *_: None)
        whole = fit(btf, "ptm", scene=scene, measure=False).material
    assert whole.cutout is None
    assert_close(render(result.material, scene), render(whole, scene), 1e-4)  # products round by their widths: 3e-6


def test_a_window_is_stored_and_read_and_measured(btf, tmp_path):
    scene = near_quad()
    result = fit(btf, "lambert", scene=scene)
    tm.save_material(result.material, tmp_path / "part")
    assert torch.equal(render(tm.load_material(tmp_path / "part"), scene), render(result.material.as_exported(), scene))
    shown, part = comparable(result.material, btf)
    assert (part.height, part.width) == shown.size == tuple(result.report["scene"]["window"][2:])
    assert result.report["held_out"]["relative_error"] < 0.5


def test_a_texture_seen_from_afar_is_stored_smaller(btf):
    far = Scene("quad", [(0.3, 0.2, 0.9)], size=6, rays=1)
    result = fit(btf, "texture", scene=far)
    assert result.report["scene"]["halved"] == 1 and result.material.size == (8, 8)
    assert result.report["scene"]["bytes"] * 4 == result.report["scene"]["whole_bytes"]
    with torch.no_grad():
        assert whole_error(result.material, far, btf) < 0.05
    assert comparable(result.material, btf)[0].size == (16, 16)


def test_texels_without_data_count_nothing_in_smaller_copies():
    light, view = all_pairs(LIGHTS, VIEWS)
    images, weight = plausible_images(light, view, 16, 16), np.ones((len(light), 16, 16), dtype=bool)
    weight[:, ::2, ::2] = False
    images[:, :, ::2, ::2] = 1e3
    far = Scene("quad", [(0.3, 0.2, 0.9)], size=6, rays=1)
    found = fit(Btf.from_tensors(images, light, view, weight), "texture", scene=far, measure=False).material
    assert float(found.maps["albedo"].detach().max()) < 2


@pytest.mark.parametrize("geometry", ("recover", "given"))
def test_a_relief_keeps_all_texels(geometry):
    data = tm.load_btf(tm.sample_path(), crop=(0, 0, 24, 24))
    given = 0.01 * torch.rand(1, 24, 24, generator=torch.Generator().manual_seed(0))
    height = "recover" if geometry == "recover" else given
    result = fit(data, "lambert", scene=near_quad(), geometry=height, tiles=False, measure=False)
    assert result.material.size == (24, 24) and result.report["scene"]["window"] is None
    assert geometry == "recover" or result.material.has_relief


def test_a_given_height_stays_in_its_size_from_afar(btf):
    far = Scene("quad", [(0.3, 0.2, 0.9)], size=6, rays=1)
    height = 0.01 * torch.rand(1, 16, 16, generator=torch.Generator().manual_seed(0))
    result = fit(btf, "lambert", scene=far, geometry=height, measure=False)
    assert result.material.size == (16, 16) and result.report["scene"]["halved"] == 0


def test_picked_samples_keep_images_weights_and_directions():
    light, view = all_pairs(LIGHTS, VIEWS)
    weight = np.random.default_rng(0).random((len(light), 4, 4)) < 0.8
    whole = Btf.from_tensors(plausible_images(light, view, 4, 4), light, view, weight)
    rows = torch.tensor([40, 3, 77])
    part = whole.picked(rows)
    assert torch.equal(part.images([0, 1, 2]), whole.images(rows))
    assert torch.equal(part.weights([0, 1, 2]), whole.weights(rows))
    assert torch.equal(part.lights[part.light_index], whole.lights[whole.light_index[rows]])
    assert torch.equal(part.views[part.view_index], whole.views[whole.view_index[rows]])
    assert len(part) == 3 and part.invalid_share == pytest.approx(1 - float(whole.weights(rows).mean()))


def test_a_list_of_scenes_is_what_all_of_them_use(btf, scene):
    both = fit(btf, "texture", scene=[scene, near_quad()], measure=False)
    joined = fit(btf, "texture", scene=scene.use() + near_quad().use(), measure=False)
    assert torch.equal(both.material.maps["albedo"], joined.material.maps["albedo"])


def test_two_runs_and_two_threads_give_the_same_bits(btf, scene):
    found = []
    for threads in (1, 2, 2):
        before = torch.get_num_threads()
        torch.set_num_threads(threads)
        try:
            found.append(fit(btf, "phong_srf", scene=scene.use(), measure=False).material)
        finally:
            torch.set_num_threads(before)
    for other in found[1:]:
        assert all(torch.equal(value, other.maps[name]) for name, value in found[0].maps.items())


def test_one_view_says_how_much_lies_outside():
    light, view = all_pairs(LIGHTS, VIEWS[:1])
    btf = Btf.from_tensors(plausible_images(light, view), light, view)
    report = fit(btf, "texture", scene=Scene("sphere", size=16), measure=False).report
    assert report["scene"]["outside_measured_share"] > 0.9


def test_contradictions_are_told(btf, scene, tmp_path):
    for given in ({"tile_size": 8}, {"memory_mb": 100}, {"work": tmp_path / "work"}):
        with pytest.raises(RangeError, match="come without tiles"):
            fit(btf, "texture", scene=scene, **given)
    with pytest.raises(RangeError, match="name its model"):
        fit(btf, "auto", scene=scene, bytes=10)
    with pytest.raises(RangeError, match="see the object"):
        fit(btf, "texture", scene=Scene("sphere", camera=Camera((0, 0, 5), target=(0, 0, 9)), size=8))
    with pytest.raises(RangeError, match="be a Scene"):
        fit(btf, "texture", scene="teapot")


def test_the_folder_of_a_window_has_a_report_with_pictures(btf, tmp_path):
    from torchmat.report import write_fit

    result = fit(btf, "lambert", scene=near_quad())
    folder = write_fit(btf, result, tmp_path / "out")
    assert "The scene" in (folder / "report.html").read_text(encoding="utf-8")
    assert json.loads((folder / "report.json").read_text())["scene"]["window"] == list(result.report["scene"]["window"])
    with pytest.raises(DataError):
        tm.load_material(tmp_path)
