"""MaterialX documents: what they hold, that every file is there, and what MaterialX itself says of them."""

from __future__ import annotations

from xml.etree import ElementTree

import pytest
from tests.material_io.forms import microfacet, rand
from tests.models.distributions import distribution

import torchmat as tm
from torchmat import RangeError
from torchmat.material_io.materialx import DOCUMENT, FORMS

EVERY = ("normal", "anisotropy", "f90", "coat", "sheen", "rolloff", "layered")


def relief():
    return microfacet("normal", "anisotropy").on_relief(0.02 * rand(1, 3), 0.1 * rand(3, 4))


@pytest.mark.parametrize("form", FORMS)
def test_what_a_document_holds_is_near(tmp_path, form):
    losses = tm.export(microfacet("normal", "anisotropy", "coat", "sheen"), tmp_path / "m", to="materialx", form=form)
    assert losses.errors["native"] < 1e-6 and losses.lost == {}
    assert ("diffuse" in losses.approximated) and ("renderers" in losses.approximated["diffuse" if form == "portable" else "specular_f0"])


def test_what_it_does_not_hold_is_told(tmp_path):
    portable, closest = (tm.export(microfacet(*EVERY), tmp_path / form, to="materialx", form=form) for form in FORMS)
    assert set(portable.lost) == {"f90", "rolloff", "layered"} and set(closest.lost) == {"rolloff", "layered"}
    assert closest.errors["native"] < portable.errors["native"]
    with pytest.raises(RangeError, match="form must be one of 'portable', 'closest'"):
        tm.export(microfacet(), tmp_path / "x", to="materialx", form="nearest")
    with pytest.raises(RangeError, match="width must be positive"):
        tm.export(microfacet(), tmp_path / "x", to="materialx", width=0)


def test_the_height_is_a_displacement_in_the_width_of_the_object(tmp_path):
    material = relief()
    losses = tm.export(material, tmp_path / "m", to="materialx", width=2.5)
    assert losses.lost == {"ambient": "light from texel to texel has no place"} and "height" in losses.approximated
    root = ElementTree.parse(tmp_path / "m" / DOCUMENT).getroot()
    node = root.find("displacement")
    assert node.find("input[@name='scale']").get("value") == "2.5"
    height = material.maps["height"].detach()
    low, span = (float(root.find(f"nodegraph/*[@name='{name}']/input[@name='in2']").get("value")) for name in ("height_value", "height_range"))
    assert (low, low + span) == (pytest.approx(float(height.min()), rel=1e-6), pytest.approx(float(height.max()), rel=1e-6))


@pytest.mark.parametrize("form", FORMS)
def test_files_are_those_that_it_names_and_data_is_not_tagged_as_colour(tmp_path, form):
    tm.export(relief(), tmp_path / "m", to="materialx", form=form)
    root = ElementTree.parse(tmp_path / "m" / DOCUMENT).getroot()
    assert root.get("colorspace") == "lin_rec709"
    named = {one.get("value"): one.get("colorspace") for one in root.iter("input") if one.get("type") == "filename"}
    assert set(named) | {DOCUMENT, "loss.json"} == {path.name for path in (tmp_path / "m").iterdir()}
    coloured = {name for name, space in named.items() if space == "srgb_texture"}
    assert coloured == {name for name in named if "color" in name and name.endswith("png")}


MATERIALS = {
    "all parts": lambda: microfacet(*EVERY), "plain": microfacet, "relief": relief, "cut out": lambda: microfacet(opacity=rand(1, 2)),
    "distribution": lambda: distribution(4, 4, 1, ("normal", "specular_mask", "fresnel", "rotation")),
}


@pytest.fixture(scope="module")
def library():
    """MaterialX and its library of nodes."""
    mx = pytest.importorskip("MaterialX", reason="MaterialX is not installed: pip install materialx")
    found = mx.createDocument()
    mx.loadLibraries(mx.getDefaultDataLibraryFolders(), mx.getDefaultDataSearchPath(), found)
    return mx, found


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("name", MATERIALS)
def test_materialx_validates_and_generates_shaders(library, tmp_path, name, form):
    mx, library = library
    import MaterialX.PyMaterialXGenGlsl as glsl
    import MaterialX.PyMaterialXGenShader as gen

    tm.export(MATERIALS[name](), tmp_path / "m", to="materialx", form=form)
    document = mx.createDocument()
    mx.readFromXmlFile(document, str(tmp_path / "m" / DOCUMENT))
    document.setDataLibrary(library)
    valid, told = document.validate()
    assert valid, told
    generator = glsl.EsslShaderGenerator.create()
    context = gen.GenContext(generator)
    context.registerSourceCodeSearchPath(mx.getDefaultDataSearchPath())
    nodes = gen.findRenderableElements(document)
    assert [node.getName() for node in nodes] == ["material"]
    source = generator.generate("material", nodes[0], context).getSourceCode("pixel")
    assert ("open_pbr_surface" in source or "generalized_schlick" in source) and len(source) > 1000
