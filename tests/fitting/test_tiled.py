"""Fits by tiles: the answer of the whole, without seams; bounded memory; and a killed run that goes on."""

from __future__ import annotations

import functools
import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from tests.fitting.reference_scene import glossy_scene, relief_scene
from tests.support import all_pairs, assert_close, hemisphere, plausible_images

import torchmat as tm
from torchmat import Btf, DataError, FitConfig, RangeError
from torchmat.fitting import RECIPES
from torchmat.fitting.geometry import Flat, Recover
from torchmat.fitting.relief.surface import bring_onto
from torchmat.fitting.relief.window import Window, surroundings
from torchmat.fitting.tiles import work as tile_files
from torchmat.fitting.tiles import memory as tile_memory
from torchmat.fitting.tiles import fit as tiled
from torchmat.fitting.tiles.work import fit_key, open_work
from torchmat.fitting.training import make_training

OPTIONS = {
    "pca": {"components": 6}, "local_pca": {"clusters": 3, "components": 3}, "rbf": {"components": 5}, "sphere_images": {"size": 12},
    "distribution": {
        "geometry": "flat", "lobes": 2, "fresnel": True, "rotation": True, "tilt": True, "specular_size": 8, "effort": 0.005,
        "storage": "half",
    },
}
TILED = [name for name in RECIPES if RECIPES[name].tiling.refused is None]
# Largest difference to the fit of the whole, relative to a map's largest value, in float64: sums round otherwise in
# blocks of other lengths. Measured below 1e-12, also after ten of Adam's steps.
BOUND = 1e-10


@functools.lru_cache(maxsize=None)
def btf_of(height: int = 22, width: int = 19) -> Btf:
    light, view = all_pairs(hemisphere(((0, 1), (25, 5), (50, 7))), hemisphere(((0, 1), (60, 3))))
    return Btf.from_tensors(plausible_images(light, view, height, width), light, view)


def fitted(model: str, tile: int, btf: Btf | None = None, **more):
    options = {"dtype": torch.float64, "measure": False, **OPTIONS.get(model, {}), **more}
    return tm.fit(btf or btf_of(), model, tile_size=tile, **options)


def compare(found, whole, bound: float) -> None:
    """Assert that two materials hold the same maps, to `bound` of each map's largest value."""
    assert set(found.maps) == set(whole.maps)
    for name, value in whole.maps.items():
        if name == "cluster":
            assert torch.equal(found.maps[name], value)
        else:
            assert_close(found.maps[name], value, bound)


@pytest.mark.parametrize("model", TILED)
def test_tiles_join_to_the_fit_of_the_whole(model):
    found, whole = fitted(model, 12), fitted(model, 22)
    assert found.report["figures"]["tiles"]["count"] == 4 and whole.report["figures"]["tiles"]["count"] == 1
    compare(found.material, whole.material, BOUND)
    if whole.coverage is not None:
        assert torch.equal(found.coverage, whole.coverage)


@pytest.mark.parametrize("model", [name for name in TILED if name != "distribution"])
def test_one_small_image_gives_what_the_plain_fit_gives(model):
    compare(fitted(model, 12).material, fitted(model, 0).material, 1e-9)


@pytest.mark.parametrize("model, tiles", [
    ("texture", True), ("lambert", True), ("lambert", False), ("phong_srf", False), ("pca", True),
    ("distribution", False),
])
def test_on_a_relief_samples_come_from_beyond_the_tile(model, tiles):
    scene = relief_scene()
    height = scene.true_height * 0.3
    more = {"btf": scene.btf(np.float64), "geometry": height, "tiles": tiles}
    found, whole = fitted(model, 13, **more), fitted(model, 24, **more)
    assert found.material.has_relief and found.material.tiles == tiles
    compare(found.material, whole.material, BOUND)


def test_a_comparison_of_maps_can_fail():
    other = fitted("texture", 8, btf=btf_of().window(0, 0, 22, 19).window(0, 0, 22, 18))
    with pytest.raises(AssertionError):
        compare(other.material, fitted("texture", 8).material, 1)
    moved = fitted("texture", 8).material
    with pytest.raises(AssertionError):
        compare(moved.with_maps(albedo=moved.maps["albedo"] * 1.001), moved, 1e-6)


@pytest.mark.parametrize(
    "window", [Window(0, 0, 5, 6), Window(17, 20, 7, 4), Window(9, 8, 3, 3), Window(0, 0, 24, 24, 3)]
)
@pytest.mark.parametrize("tiles", [True, False])
def test_a_window_of_the_surface_is_that_of_the_whole(window, tiles):
    scene = relief_scene()
    btf = scene.btf(np.float64)
    training = make_training(btf, torch.arange(len(btf)), 0, tiles, torch.float64, False)
    height = scene.true_height.double() * 0.2
    whole, part = bring_onto(training, height), bring_onto(training, height, window=window)
    expected = torch.from_numpy(whole.pixels)[:, :, window.rows, window.columns]
    assert_close(torch.from_numpy(part.pixels.copy()), expected, 1e-12)
    assert np.array_equal(part.flags, whole.flags[:, window.rows, window.columns])
    assert torch.equal(part.lit, window.crop(whole.lit)) and torch.equal(part.slopes, window.crop(whole.slopes))


def test_surroundings_reach_over_the_border_of_what_tiles():
    images = torch.arange(2 * 3 * 40 * 50, dtype=torch.float64).reshape(2, 3, 40, 50)
    btf = Btf.from_tensors(images, [[0, 0, 1.0]] * 2, [[0, 0, 1.0]] * 2)
    around = surroundings(btf, Window(0, 44, 6, 6), (2.5, 1.0), True)
    assert (around.top, around.left, around.size) == (-6, 40, (18, 14))
    rows, columns = torch.arange(-6, 12) % 40, torch.arange(40, 54) % 50
    assert torch.equal(around.images(torch.arange(2), torch.float64), images[:, :, rows][:, :, :, columns])
    cut = surroundings(btf, Window(0, 44, 6, 6), (2.5, 1.0), False)
    assert (cut.top, cut.left, cut.size) == (0, 40, (12, 10))
    assert surroundings(btf, Window(10, 10, 6, 6), (99, 1), True).size[0] == 40
    place = around.place(torch.tensor([44.5 / 50, 1 - 0.5 / 40], dtype=torch.float64)[:, None, None])
    assert_close(place.flatten(), torch.tensor([4.5 / 14, 1 - 6.5 / 18], dtype=torch.float64))


def test_what_is_shared_comes_from_a_bounded_choice_of_texels(monkeypatch):
    recipe = RECIPES["phong_srf"]
    few = replace(recipe, tiling=replace(recipe.tiling, sharing_texels=30))
    monkeypatch.setitem(RECIPES, "phong_srf", few)
    found = fitted("phong_srf", 8)
    assert found.report["figures"]["tiles"]["texels_for_what_is_shared"] == 5 * 4  # every fifth row and column
    whole = fitted("phong_srf", 0)
    assert_close(found.material.maps["lobe"], whole.material.maps["lobe"], 0.5)
    assert not torch.equal(found.material.maps["lobe"], whole.material.maps["lobe"])


@pytest.mark.parametrize("model", ["ptm", "phong_srf"])
def test_masked_and_clipped_texels_count_alike_in_tiles(model):
    light, view = all_pairs(hemisphere(((0, 1), (25, 5), (50, 7))), hemisphere(((0, 1), (60, 3))))
    weight = np.random.default_rng(3).uniform(size=(len(light), 1, 12, 12)) > 0.3
    weight[:, :, 2, 3] = False
    btf = Btf.from_tensors(plausible_images(light, view, 12, 12), light, view, weight)
    found, whole = fitted(model, 5, btf), fitted(model, 0, btf)
    compare(found.material, whole.material, 1e-9)
    assert torch.equal(found.coverage, whole.coverage) and float(found.coverage.min()) == 0


def test_memory_decides_the_side_of_the_tiles(monkeypatch):
    btf, report = btf_of(), []
    monkeypatch.setattr(tile_memory, "LEAST_SIDE", 2)
    monkeypatch.setattr(tile_memory, "FEWEST_TEXELS", 4)
    monkeypatch.setattr(tile_memory, "STEP", 2)
    for extra in (0.2, 1.0, 3.0):
        mb = 290.4 + extra  # of which the program takes 90, blocks of float64 200, and a texture 0.4
        report.append(tm.fit(btf, "texture", dtype=torch.float64, memory_mb=mb).report["figures"]["tiles"]["side"])
    assert report[0] < report[1] < report[2] <= 22


def test_too_little_memory_says_how_much_is_needed():
    with pytest.raises(RangeError, match=r"memory_mb must be at least \d+; it is 50, and texture on this data takes"):
        tm.fit(btf_of(), "texture", memory_mb=50)
    with pytest.raises(RangeError, match="memory_mb must be at least 1200; .* recovering the relief"):
        tm.fit(btf_of(), "texture", memory_mb=900, geometry="recover")
    needed = 210  # 20 more than the program and its blocks
    with pytest.raises(RangeError, match="tile_size must fit into"):
        tm.fit(btf_of(), "texture", memory_mb=needed, tile_size=4000)


def test_what_fits_all_texels_at_once_is_refused():
    with pytest.raises(RangeError, match="network"):
        tm.fit(btf_of(), "neural", tile_size=8)
    with pytest.raises(RangeError, match="solver must suit tiles; it is 'lbfgs'"):
        tm.fit(btf_of(), "phong_srf", tile_size=8, solver="lbfgs")
    with pytest.raises(RangeError, match="solver must suit tiles; it is 'adam'"):
        tm.fit(btf_of(), "distribution", tile_size=8, solver="adam")


def test_a_long_side_is_one_row_of_tiles():
    light, view = all_pairs(hemisphere(((0, 1), (25, 5), (50, 7))), hemisphere(((0, 1),)))
    btf = Btf.from_tensors(plausible_images(light, view, 1, 300), light, view)
    compare(fitted("ptm", 64, btf).material, fitted("ptm", 0, btf).material, 1e-11)


def test_recovered_geometry_is_shared_by_all_tiles():
    scene = relief_scene()
    whole = tm.fit(scene.btf(), "lambert", geometry="recover", relief="fast", measure=False)  # as tiles are
    found = tm.fit(scene.btf(), "lambert", geometry="recover", measure=False, tile_size=9)
    assert found.report["figures"]["geometry"]["chosen"] == whole.report["figures"]["geometry"]["chosen"] == "recover"
    compare(found.material, whole.material, 1e-4)
    flat = tm.fit(glossy_scene().btf(), "texture", geometry="recover", measure=False, tile_size=9)
    assert not flat.material.has_relief


# A run that is killed.

_KILLED = """
import os, sys
import torch
sys.path.insert(0, {tests!r})
from tests.fitting.test_tiled import run_to_the_end
from torchmat.fitting.tiles import work as tile_files
save, count = tile_files.Work.save_tile, 0
def save_and_die(self, number, part):
    global count
    save(self, number, part)
    count += 1
    if count == {after}:
        os._exit(9)
tile_files.Work.save_tile = save_and_die
run_to_the_end({work!r})
"""


def run_to_the_end(work: str | Path):
    return tm.fit(btf_of(), "phong_srf", tile_size=8, work=work, seed=2)


def test_a_killed_run_goes_on_and_gives_the_same_bits(tmp_path, monkeypatch):
    work = tmp_path / "work"
    code = _KILLED.format(tests=str(Path(__file__).parents[2]), after=4, work=str(work))
    alone = {**os.environ, "OMP_NUM_THREADS": "1"}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=alone)
    assert done.returncode == 9, done.stderr
    assert sorted(path.name for path in work.glob("tile-*")) == [f"tile-{number:06d}.npz" for number in range(4)]
    fits = []
    monkeypatch.setattr(tiled, "fit_tile", _counted(tiled.fit_tile, fits))
    monkeypatch.setattr(tiled, "plan_tiles", _counted(tiled.plan_tiles, fits))
    found = run_to_the_end(work)
    assert len(fits) == 5  # the plan and four tiles were there
    whole = run_to_the_end(None)
    assert all(torch.equal(found.material.maps[name], value) for name, value in whole.material.maps.items())
    assert found.report["figures"] == whole.report["figures"] and found.report["held_out"] == whole.report["held_out"]
    assert not work.exists()


def _counted(function, calls: list):
    def counting(*arguments, **keywords):
        calls.append(function.__name__)
        return function(*arguments, **keywords)

    return counting


def begun(work: Path, monkeypatch, **more) -> None:
    """Leave a folder in which all tiles of a fit are done and the fit is not."""
    with monkeypatch.context() as patch:
        patch.setattr(sys.modules["torchmat.fitting.fit"], "clear_work", lambda path: None)
        tm.fit(btf_of(), "phong_srf", tile_size=8, work=work, measure=False, **more)


@pytest.mark.parametrize("damage", ["cut", "zeros", "turned", "empty", "json"])
@pytest.mark.parametrize("name", ["plan.npz", "tile-000003.npz", "fit.json"])
def test_a_damaged_file_is_made_again(tmp_path, monkeypatch, name, damage):
    work = tmp_path / "work"
    begun(work, monkeypatch)
    content = bytearray((work / name).read_bytes())
    middle = len(content) // 2
    if damage == "turned":
        content[middle] ^= 255
    wrong = {"cut": content[:middle], "zeros": bytes(len(content)), "turned": content, "empty": b"", "json": b"[1]"}
    (work / name).write_bytes(wrong[damage])
    if name == "fit.json" and damage == "turned":
        return  # another text is another key: see the next test
    found, whole = (tm.fit(btf_of(), "phong_srf", tile_size=8, work=at, measure=False) for at in (work, None))
    assert all(torch.equal(found.material.maps[name], value) for name, value in whole.material.maps.items())
    assert not work.exists()


def test_the_folder_of_another_fit_is_refused(tmp_path, monkeypatch):
    work = tmp_path / "work"
    begun(work, monkeypatch)
    kept = {path.name: path.read_bytes() for path in work.iterdir()}
    height = torch.linspace(0, 0.01, 22 * 19).reshape(1, 22, 19)
    for other in ({"seed": 5}, {"residual": "quadratic"}, {"tile_size": 9}, {"tiles": False}, {"geometry": height}):
        with pytest.raises(DataError, match="be of this fit"):
            tm.fit(btf_of(), "phong_srf", **{"tile_size": 8, "work": work, **other})
    with pytest.raises(DataError, match="be of this fit"):
        tm.fit(btf_of(22, 20), "phong_srf", tile_size=8, work=work)
    assert {path.name: path.read_bytes() for path in work.iterdir()} == kept


def test_a_folder_with_anything_else_is_refused(tmp_path):
    (tmp_path / "letter.txt").write_text("dear")
    with pytest.raises(DataError, match="letter.txt"):
        tm.fit(btf_of(), "texture", work=tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["letter.txt"]


def test_what_is_put_beside_the_work_stays(tmp_path):
    work = tmp_path / "work"
    training = make_training(btf_of(), torch.arange(len(btf_of())), 0, True, torch.float32, False)
    open_work(work, training, "texture", {}, Flat(), 8, 0)
    (work / "letter.txt").write_text("dear")
    tile_files.clear_work(work)
    assert [path.name for path in work.iterdir()] == ["letter.txt"]


def test_a_plan_comes_back_as_it_was(tmp_path):
    scene = relief_scene()
    training = make_training(scene.btf(), torch.arange(len(scene.btf())), 0, True, torch.float32, False)
    options = {"base": "phong", "residual": "half", "phong": "mean_brdf", "ridge": 1e-4, "storage": "half"}
    with torch.no_grad():
        plan = tiled.plan_tiles(training, "phong_srf", options, Recover(), 9, 0)
    work = open_work(tmp_path / "work", training, "phong_srf", {}, Recover(), 9, 0)
    work.save_plan(plan)
    again = work.load_plan()
    assert again.windows == plan.windows and again.figures == json.loads(json.dumps(plan.figures))
    assert torch.equal(again.height, plan.height) and torch.equal(again.relief.normal, plan.relief.normal)
    assert type(again.shared) is type(plan.shared) and again.shared_from == plan.shared_from == 24 * 24
    (tensors, numbers), (kept, known) = plan.shared.pieces(), again.shared.pieces()
    assert set(tensors) == {"tables.lobe", "usual_ambient"} and numbers == known == {}
    assert tensors.keys() == kept.keys() and all(torch.equal(kept[name], value) for name, value in tensors.items())
    first, second = (tiled.fit_tile(training, one, plan.windows[1]).maps for one in (plan, again))
    assert all(torch.equal(second[name], value) for name, value in first.items())


def test_other_data_has_another_key():
    def key(btf: Btf, **more):
        training = make_training(btf, torch.arange(len(btf)), 0, True, torch.float32, False)
        return fit_key(training, "ptm", {}, Flat(), 8, 0)

    light, view = all_pairs(hemisphere(((0, 1), (40, 4))), hemisphere(((0, 1),)))
    images = plausible_images(light, view, 4, 4)
    first = key(Btf.from_tensors(images, light, view))
    assert first == key(Btf.from_tensors(images.copy(), light, view))
    images[3, 1, 2, 2] += 0.5
    assert first != key(Btf.from_tensors(images, light, view))


def test_the_command_goes_on_where_it_was(tmp_path, capsys):
    from torchmat.cli import main

    (tmp_path / "fit.toml").write_text('model = "texture"\ntile_size = 32\n')
    work, out = tmp_path / "work", tmp_path / "out"
    assert main(["fit", str(tmp_path / "fit.toml"), "--out", str(out), "--work", str(work), "--no-pictures"]) == 0
    assert json.loads((out / "report.json").read_text())["figures"]["tiles"]["side"] == 32 and not work.exists()


def test_a_config_names_tile_and_memory():
    assert FitConfig("ptm", tile_size=64, memory_mb=2000).tile_size == 64
    with pytest.raises(RangeError, match="tile_size"):
        FitConfig("ptm", tile_size=-1)
