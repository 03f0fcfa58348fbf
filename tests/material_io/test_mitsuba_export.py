"""Exports to Mitsuba: the plugin evaluates what the model shades, and the plain form loads."""

from __future__ import annotations

import importlib.util
import json

import numpy as np
import pytest
import torch
from tests.material_io.forms import microfacet, of_metalness, rand
from tests.models.examples import EXAMPLE_OPTIONS, directions, make

import torchmat as tm
from torchmat.material_io.mitsuba import PLUGIN
from torchmat.models import Microfacet

EVALUATED = ("texture", "lambert", "phong_srf", "distribution", "microfacet")
CASES = [(name, number) for name in EVALUATED for number in range(len(EXAMPLE_OPTIONS[name]))]


def test_files_are_those_that_the_description_names(tmp_path):
    material = make("distribution", EXAMPLE_OPTIONS["distribution"][2], 3, 4, torch.float32)
    losses = tm.export(material, tmp_path / "m", to="mitsuba")
    table = json.loads((tmp_path / "m" / "material.json").read_text("utf-8"))
    files = {file for entry in table["maps"].values() for file in entry["files"]}
    assert {path.name for path in (tmp_path / "m").iterdir()} == files | {"material.json", "loss.json", PLUGIN}
    assert set(losses.exact) == {spec.name for spec in material.specs()} and losses.errors == {"native": 0}
    assert compile((tmp_path / "m" / PLUGIN).read_text("utf-8"), PLUGIN, "exec")


def test_a_relief_leaves_its_normals_and_other_models_become_microfacets(tmp_path):
    losses = tm.export(microfacet().on_relief(0.01 * rand(1, 3), rand(3, 4)), tmp_path / "a", to="mitsuba")
    assert set(losses.lost) == {"height", "ambient"} and (tmp_path / "a" / "normal.exr").is_file()
    losses = tm.export(make("sphere_images", {"angles_deg": [0.0, 45.0, 90.0]}, 2, 3, torch.float32), tmp_path / "b", to="mitsuba")
    assert isinstance(losses.held, Microfacet) and losses.errors["native"] > 0


@pytest.fixture(scope="module")
def mi(request, tmp_path_factory):
    found = pytest.importorskip("mitsuba", reason="Mitsuba is not installed: pip install 'torchmat[mitsuba]'")
    request.getfixturevalue("variant")
    folder = tmp_path_factory.mktemp("plugin")
    tm.export(microfacet(), folder / "m", to="mitsuba")
    spec = importlib.util.spec_from_file_location("torchmat_bsdf", folder / "m" / PLUGIN)
    spec.loader.exec_module(importlib.util.module_from_spec(spec))
    return found


def evaluated(mi, bsdf, size, light, view) -> np.ndarray:
    """Return pi times what a BSDF says at texel centres [3, H, W] for directions [3]."""
    height, width = size
    context, found = mi.BSDFContext(), np.zeros((3, height, width))
    for row in range(height):
        for column in range(width):
            si = mi.SurfaceInteraction3f()
            si.uv = [(column + 0.5) / width, 1 - (row + 0.5) / height]
            si.wi = view.tolist()
            si.n, si.sh_frame = [0, 0, 1], mi.Frame3f([0, 0, 1])
            found[:, row, column] = np.array(bsdf.eval(context, si, mi.Vector3f(light.tolist()), True))
    return np.pi * found


@pytest.mark.parametrize(("name", "number"), CASES, ids=[f"{name}-{number}" for name, number in CASES])
def test_the_plugin_evaluates_the_model(mi, tmp_path, name, number):
    material = make(name, EXAMPLE_OPTIONS[name][number], 2, 3, torch.float32)
    if name == "microfacet":
        material = material._like({**material.maps, "opacity": torch.rand(1, 2, 3)})
    tm.export(material, tmp_path / "m", to="mitsuba")
    bsdf = mi.load_dict({"type": "torchmat", "folder": str(tmp_path / "m")})
    for light, view in zip(directions(4, torch.float32, 1), directions(4, torch.float32, 2), strict=True):
        with torch.no_grad():
            wanted = material.shade(light[:, None, None], view[:, None, None]).numpy()
        off = np.abs(evaluated(mi, bsdf, material.size, light, view) - wanted).max()
        assert off <= 1e-5 * max(1.0, float(wanted.max()))


def test_between_texels_and_over_the_border_it_filters_as_the_model_does(mi, tmp_path):
    material = microfacet("normal", "anisotropy")
    tm.export(material, tmp_path / "m", to="mitsuba")
    bsdf, context = mi.load_dict({"type": "torchmat", "folder": str(tmp_path / "m")}), mi.BSDFContext()
    light, view = directions(1, torch.float32, 3)[0], directions(1, torch.float32, 4)[0]
    for u, v in ((0.31, 0.47), (0.99, 0.01), (1.2, -0.3)):
        with torch.no_grad():
            wanted = material.shade_at(torch.tensor([u, v])[:, None, None], light[:, None, None], view[:, None, None]).flatten().numpy()
        si = mi.SurfaceInteraction3f()
        si.uv, si.wi = [u, v], view.tolist()
        found = np.pi * np.array(bsdf.eval(context, si, mi.Vector3f(light.tolist()), True))
        assert np.abs(found - wanted).max() <= 2e-5 * max(1.0, float(wanted.max()))


def test_below_the_horizon_there_is_nothing_and_samples_are_worth_their_density(mi, tmp_path):
    tm.export(microfacet(), tmp_path / "m", to="mitsuba")
    bsdf, context = mi.load_dict({"type": "torchmat", "folder": str(tmp_path / "m")}), mi.BSDFContext()
    si = mi.SurfaceInteraction3f()
    si.uv, si.wi = [0.3, 0.3], [0.6, 0, 0.8]
    assert list(bsdf.eval(context, si, mi.Vector3f(0, 0.6, -0.8), True)) == [0, 0, 0]
    drawn, weight = bsdf.sample(context, si, 0.5, mi.Point2f(0.3, 0.7), True)
    value = np.array(bsdf.eval(context, si, drawn.wo, True))
    assert np.allclose(np.array(weight), value / bsdf.pdf(context, si, drawn.wo, True), rtol=1e-5)


def test_the_plain_form_loads_and_is_near(mi, tmp_path):
    material = of_metalness("normal", opacity=(rand(1, 5) > 0.1).float())
    losses = tm.export(material, tmp_path / "m", to="mitsuba", form="plain")
    assert losses.errors["native"] < 1e-6 and (tmp_path / "m" / "material.xml").is_file()
    found = mi.load_file(str(tmp_path / "m" / "material.xml"))
    assert found is not None
