"""A model that is registered from outside works everywhere, and any material can be fitted without registration."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from tests.fitting.ggx_model import RECIPE, Ggx
from tests.fitting.reference_scene import relief_scene
from tests.support import all_pairs, assert_close, hemisphere

import torchmat as tm
from torchmat import Btf, Material, RangeError, Recipe, ShapeError
from torchmat.fitting.recipe import RECIPES, unregister

LIGHT, VIEW = all_pairs(hemisphere(((10, 4), (30, 6), (50, 8))), hemisphere(((0, 1), (25, 4), (45, 6))))


def ggx_value(albedo, f0, alpha, light, view):
    """Return the GGX value of one texel and pair, by a formula of its own: D, Smith's lambda and f_r, not their product."""
    half = (light + view) / np.linalg.norm(light + view)
    cos2 = half[2] ** 2
    tan2 = (1 - cos2) / cos2
    d = 1 / (np.pi * alpha**2 * cos2**2 * (1 + tan2 / alpha**2) ** 2)

    def smith(w):
        return (np.sqrt(1 + alpha**2 * (1 / w[2] ** 2 - 1)) - 1) / 2

    g = 1 / (1 + smith(light) + smith(view))
    return np.pi * (albedo / np.pi + d * g * f0 / (4 * light[2] * view[2])) * light[2]


@pytest.fixture(scope="module")
def truth():
    rng = np.random.default_rng(5)
    maps = {"diffuse": rng.uniform(0.1, 0.6, (3, 6, 5)), "reflectance": rng.uniform(0.03, 0.1, (1, 6, 5)),
            "roughness": rng.uniform(0.25, 0.5, (1, 6, 5))}
    images = np.zeros((len(LIGHT), 3, 6, 5))
    for i, (l, v) in enumerate(zip(LIGHT.astype(float), VIEW.astype(float), strict=True)):
        for r in range(6):
            for c in range(5):
                images[i, :, r, c] = ggx_value(maps["diffuse"][:, r, c], maps["reflectance"][0, r, c], maps["roughness"][0, r, c], l, v)
    return {name: torch.tensor(value) for name, value in maps.items()}, Btf.from_tensors(images.astype(np.float32), LIGHT, VIEW)


@pytest.fixture
def registered():
    tm.register(RECIPE)
    yield "outside_ggx"
    unregister("outside_ggx")


def test_a_model_from_outside_recovers_what_an_oracle_made(truth, registered):
    maps, btf = truth
    result = tm.fit(btf, registered, solver="lbfgs", steps=2000, dtype=torch.float64, progress=False)
    assert result.report["held_out"]["relative_error"] < 1e-5
    for name, tolerance in (("diffuse", 5e-3), ("reflectance", 4e-3), ("roughness", 2e-2)):
        assert_close(result.material.maps[name].double(), maps[name], tolerance)


@pytest.mark.parametrize("solver", ["minibatch", "adam"])
def test_it_is_optimised_by_default_and_not_left_at_its_start(truth, registered, solver):
    btf = truth[1]
    start = tm.fit(btf, registered, solver=solver, steps=1, progress=False).report["held_out"]["psnr_db"]
    found = tm.fit(btf, registered, solver=solver, progress=False)
    assert found.report["held_out"]["psnr_db"] > start + 5 and found.report["options"]["solver"] == solver


def test_it_works_on_a_relief_by_tiles_in_compare_on_disk_and_in_pictures(truth, registered, tmp_path):
    btf = truth[1]
    tiled = tm.fit(btf, registered, tile_size=3, steps=120, progress=False)
    assert tiled.report["figures"]["tiles"]["count"] == 4 and tiled.report["held_out"]["psnr_db"] > 30
    rows = tm.compare(btf, ["lambert", f"{registered}:steps=60"], progress=False)
    assert rows[1]["failed"] is None if "failed" in rows[1] else rows[1]["psnr_db"] > rows[0]["psnr_db"]
    folder = tm.save_material(tiled.material, tmp_path / "ggx")
    loaded = tm.load_material(folder)
    assert isinstance(loaded, Ggx)
    assert_close(loaded.maps["roughness"], tiled.material.maps["roughness"], 1e-3)
    picture = tm.render(loaded, "sphere", size=16)
    assert float(picture.max()) > 0.05
    scene = relief_scene()
    flat = tm.fit(scene.btf(), registered, steps=50, progress=False).report["held_out"]["psnr_db"]
    result = tm.fit(scene.btf(), registered, geometry="recover", steps=50, progress=False)
    assert result.material.has_relief and result.report["held_out"]["psnr_db"] > flat + 1


def test_any_material_is_fitted_on_without_being_registered(truth):
    maps, btf = truth
    assert "outside_ggx" not in RECIPES
    start = {name: value.float() for name, value in maps.items()} | {"diffuse": torch.full((3, 6, 5), 0.3)}
    material = Ggx(start)
    result = tm.fit(btf, material, solver="lbfgs", steps=200, keep=("roughness", "reflectance"), progress=False)
    assert isinstance(result.material, Ggx)
    assert torch.equal(result.material.maps["roughness"], material.maps["roughness"])
    assert_close(result.material.maps["diffuse"].double(), maps["diffuse"], 2e-3)
    assert result.report["options"]["keep"] == ["reflectance", "roughness"]
    assert result.report["held_out"]["relative_error"] < 1e-6


def test_a_material_on_a_relief_keeps_its_height_and_improves():
    scene = relief_scene()
    btf = tm.Btf.from_tensors((scene.images + 0.15).astype(np.float32), scene.light, scene.view)
    fitted = tm.fit(btf, "lambert", geometry=scene.true_height, progress=False)
    begun = fitted.material
    grey = begun.with_maps(albedo=torch.full_like(begun.maps["albedo"], 0.4))
    found = tm.fit(btf, grey, steps=300, progress=False)
    assert torch.equal(found.material.maps["height"], grey.maps["height"])
    assert torch.equal(found.material.maps["ambient"], grey.maps["ambient"])
    before = tm.evaluate(grey, btf, found.split.held_out).report["psnr_db"]
    assert found.report["held_out"]["psnr_db"] > before + 3
    # What is in shadow is left out here, and with its ambient light taken off the rest says the same albedo.
    assert abs(found.report["held_out"]["psnr_db"] - fitted.report["held_out"]["psnr_db"]) < 0.2  # measured 39.87 of 39.90 dB


def test_one_seed_gives_the_same_bits(truth):
    maps, btf = truth
    material = Ggx({name: value.float() * 0.9 for name, value in maps.items()})
    first, second = (tm.fit(btf, material, steps=30, seed=3, measure=False, progress=False).material for _ in range(2))
    assert all(torch.equal(first.maps[name], second.maps[name]) for name in maps)


def test_wrong_registrations_say_what_to_give(registered):
    with pytest.raises(RangeError, match="'outside_ggx' is taken"):
        tm.register(RECIPE)
    with pytest.raises(RangeError, match="must be a Recipe"):
        tm.register(Ggx)
    with pytest.raises(RangeError, match="neither is given"):
        Recipe(Ggx)
    with pytest.raises(RangeError, match="both are given"):
        Recipe(Ggx, fit=lambda training: None, start=lambda training: None)
    with pytest.raises(RangeError, match="subclass of Material"):
        Recipe(torch.nn.Module, start=lambda training: None)
    with pytest.raises(RangeError, match="have a name"):
        Recipe(type("Nameless", (Material,), {}), start=lambda training: None)


@pytest.mark.parametrize(("given", "error", "words"), [
    ({"solver": "closed_form"}, RangeError, "solver"), ({"step": 3}, RangeError, "steps"), ({"keep": "roughness"}, RangeError, "list of names"),
    ({"keep": ("roughnes",)}, RangeError, "roughness"), ({"keep": ("diffuse", "reflectance", "roughness")}, RangeError, "leave a map to fit"),
    ({"steps": -1}, RangeError, "steps"), ({"geometry": "recover"}, RangeError, "geometry"), ({"tile_size": 4}, RangeError, "tile_size"),
    ({"rate": float("inf")}, RangeError, "rate"), ({"psnr": 30}, RangeError, "psnr"), ({"dtype": torch.float64}, RangeError, "dtype"),
])
def test_wrong_wishes_for_a_material_are_refused(truth, given, error, words):
    maps, btf = truth
    with pytest.raises(error, match=words):
        tm.fit(btf, Ggx({name: value.float() for name, value in maps.items()}), **given)


def test_a_material_of_another_size_is_refused(truth):
    maps, btf = truth
    small = Ggx({name: value.float()[:, :4] for name, value in maps.items()})
    with pytest.raises(ShapeError, match="be 6 x 5 as the images; it is 4 x 5"):
        tm.fit(btf, small)


def test_the_example_of_the_page_runs_as_it_stands(truth):
    page = (Path(tm.__file__).parent / "fitting" / "README.md").read_text("utf-8")
    code = page.split("```python\n")[1].split("```")[0]
    room = {"btf": truth[1]}
    try:
        exec(code.replace('geometry="recover"', "steps=20, progress=False"), room)  # noqa: S102
        assert room["result"].material.name == "tinted"
    finally:
        unregister("tinted")
