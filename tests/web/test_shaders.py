"""Every model's shader gives what its `shade` gives."""

from __future__ import annotations

import re

import pytest
import torch
from tests.models.examples import EXAMPLE_OPTIONS, make
from tests.web.browser import PACKAGE
from tests.web.cases import CASES, SHADED, hard_and_random, make_exact, of_every_formula
from tests.web.drawing import relative_error

from torchmat.errors import RangeError
from torchmat.models import MATERIALS, Material, Ptm, Texture
from torchmat.models.storage import decode
from torchmat.models.storage import MapSpec
from torchmat.web.payload import describe, has_shader

FLAT, SPHERES = 1e-9, 1e-6  # relative squared errors; measured at most 1e-12


def test_every_model_of_maps_has_a_shader():
    assert set(MATERIALS) - set(SHADED) == {"pca", "local_pca", "rbf", "neural"}


def worst_error(drawing, material: Material) -> float:
    """Return the largest relative squared error of a picture under one light and view."""
    light, view = hard_and_random()
    drawing.load(material)
    found = drawing.evaluate(light, view, material.size)
    with torch.no_grad():
        expected = material.shade(light, view)
    assert float(expected.double().square().mean()) > 1e-5, "the example is nearly black and tests little"
    return max(map(relative_error, found, expected))


@pytest.mark.parametrize("name, options", CASES)
def test_a_shader_equals_shade(drawing, name, options):
    assert worst_error(drawing, make_exact(name, options, 5, 7)) < (SPHERES if name == "sphere_images" else FLAT)


def test_every_formula_of_a_shading_map_equals_shade(drawing):
    for material in of_every_formula():
        assert worst_error(drawing, material) < FLAT, material.options["brdf"]


@pytest.mark.parametrize("storage", ["half", "png8", "png16", "paint8", "paint16"])
def test_codes_of_every_storage_are_decoded(drawing, storage):
    options = {"lobes": 2, "parts": ["normal", "specular_mask", "fresnel", "rotation", "tilt"], "mask_channels": 3}
    material = make("distribution", options, 6, 5, torch.float32, storage=storage)
    light, view = hard_and_random()
    drawing.load(material)
    with torch.no_grad():
        expected = material.as_exported().shade(light, view)
    assert relative_error(drawing.evaluate(light, view, material.size), expected) < FLAT


def test_maps_that_are_stored_small_are_brought_back(drawing):
    from torchmat.models.storage import StoredAs

    options = {"parts": ["normal", "anisotropy", "coat"]}
    small = {"normal": (3, 4), "rotation": (5, 2), "diffuse": (4, 9), "coat": (1, 1), "roughness": (1, 1)}
    for tiles in (True, False):
        material = make("microfacet", options, 8, 9, torch.float32, storage="float", tiles=tiles)
        material = material.stored_at({name: StoredAs(size=size) for name, size in small.items()})
        light, view = hard_and_random()
        drawing.load(material)
        with torch.no_grad():
            expected = material.as_exported().shade(light, view)
        assert relative_error(drawing.evaluate(light, view, material.size), expected) < FLAT


def test_a_cut_out_surface_is_black_in_its_holes(drawing):
    material = make_exact("texture", {}, 6, 5).with_maps(opacity=(torch.arange(30.0) % 3 / 2).reshape(1, 6, 5))
    light, view = hard_and_random()
    drawing.load(material)
    found = drawing.evaluate(light, view, material.size)
    with torch.no_grad():
        assert relative_error(found, material.shade(light, view)) < FLAT
    assert float(found[..., material.maps["opacity"][0] == 0].abs().max()) == 0


def test_models_without_a_shader_say_so():
    for name in ("pca", "local_pca", "rbf", "neural"):
        material = make(name, EXAMPLE_OPTIONS[name][0], 4, 4, torch.float32)
        assert not has_shader(material)
        with pytest.raises(RangeError, match=f"a model with a shader; {name} has none"):
            describe(material)


class Doubled(Texture):
    name = "doubled"

    def value(self, light, view):
        return 2 * super().value(light, view)


def test_a_model_of_others_brings_its_own_shader(drawing, tmp_path):
    material = Doubled({"albedo": torch.rand(3, 4, 4)}, storage="float")
    assert not has_shader(material), "its value is no longer what the shader of a texture gives"
    (tmp_path / "doubled.glsl").write_text("vec3 value(Place here, vec3 light, vec3 view) { return 2.0 * light.z * read(map_albedo, here, 0).rgb; }\n")

    class Brought(Doubled):
        glsl = tmp_path / "doubled.glsl"

    assert worst_error(drawing, Brought(dict(material.maps), storage="float")) < FLAT


def test_the_shader_of_the_readme(drawing, tmp_path):
    blocks = re.findall(r"```glsl\n(.+?)```", (PACKAGE / "web" / "README.md").read_text(encoding="utf-8"), re.DOTALL)
    (tmp_path / "tinted.glsl").write_text(blocks[0].replace('"../', f'"{PACKAGE}/'))

    class Tinted(Material):
        name, glsl = "tinted", tmp_path / "tinted.glsl"

        def own_specs(self):
            falloff = MapSpec("falloff", "exponent of the cosine", layer_channels=1, low=0.2, high=4.0, fixed_range=True)
            return (MapSpec("albedo", "diffuse colour", low=0.0, colour=True), falloff)

        def value(self, light, view):
            return self.maps["albedo"] * light[..., 2:3, :, :] ** self.maps["falloff"]

    maps = {"albedo": torch.rand(3, 4, 6), "falloff": 0.2 + 3 * torch.rand(1, 4, 6)}
    assert worst_error(drawing, Tinted(maps, storage="float")) < FLAT


def test_a_wrong_shader_says_which_line(drawing, tmp_path):
    (tmp_path / "wrong.glsl").write_text("vec3 value(Place here, vec3 light, vec3 view) {\n  return missing_word;\n}\n")

    class Wrong(Ptm):
        glsl = tmp_path / "wrong.glsl"

        def value(self, light, view):
            return super().value(light, view)

    drawing.load(Wrong({"polynomial": torch.rand(18, 4, 4)}))
    with pytest.raises(Exception, match="The shader does not compile: .*missing_word.*\n +return missing_word;"):
        drawing.evaluate(*hard_and_random(), (4, 4))


@pytest.mark.parametrize("storage", ["half", "float", "png8", "paint8", "paint16"])
def test_ranges_are_those_of_all_values(storage):
    material = make("distribution", {"parts": ["normal", "rotation", "specular_mask"]}, 6, 5, torch.float32, storage=storage)
    held = {texture.spec.name: [] for texture in material.textures()}
    for texture in material.textures():
        held[texture.spec.name].append(decode(texture.codes()))
    for entry in describe(material).description["maps"]:
        values = held[entry["name"]]
        assert entry["range"] == [float(min(map(torch.min, values))), float(max(map(torch.max, values)))]
