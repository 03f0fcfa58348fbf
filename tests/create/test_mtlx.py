"""MaterialX documents beside textures: what they say goes before names, and nothing that they say leads astray."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tests.create.test_from_textures import write
from tests.material_io.forms import microfacet

import torchmat as tm
from torchmat.create import microfacet_from_textures
from torchmat.create.mtlx import Named, document_of, files_of_mtlx
from torchmat.create.textures import find_textures, is_texture_set, read_textures
from torchmat.errors import DataError

# As ambientCG writes them: a surface at the top, pictures beside it, and a normalmap between.
PLAIN = """<?xml version="1.0"?>
<materialx version="1.38">
  <standard_surface name="s" type="surfaceshader">
    <input name="base_color" type="color3" nodename="c"/>
    <input name="specular_roughness" type="float" nodename="r"/>
    <input name="metalness" type="float" nodename="m"/>
    <input name="normal" type="vector3" nodename="bump"/>
    <input name="coat_color" type="color3" nodename="k"/>
  </standard_surface>
  <tiledimage name="c" type="color3"><input name="file" type="filename" value="one.png" colorspace="srgb_texture"/></tiledimage>
  <image name="orm" type="color3"><input name="file" type="filename" value="two.png"/></image>
  <extract name="r" type="float"><input name="in" type="color3" nodename="orm"/><input name="index" type="integer" value="1"/></extract>
  <separate3 name="parts" type="multioutput"><input name="in" type="color3" nodename="orm"/></separate3>
  <dot name="m" type="float"><input name="in" type="float" nodename="parts" output="outb"/></dot>
  <normalmap name="bump" type="vector3"><input name="in" type="vector3" nodename="n"/></normalmap>
  <image name="n" type="vector3"><input name="file" type="filename" value="three.png"/></image>
  <image name="k" type="color3"><input name="file" type="filename" value="four.png"/></image>
  <displacement name="d" type="displacementshader"><input name="displacement" type="float" nodename="h"/></displacement>
  <image name="h" type="float"><input name="file" type="filename" value="five.png"/></image>
</materialx>
"""


@pytest.fixture
def folder(tmp_path):
    for name in ("one", "two", "three", "four", "five"):
        planes = torch.rand(3, 4, 5) if name != "three" else torch.tensor([0.5, 0.5, 1])[:, None, None].expand(3, 4, 5)
        write(tmp_path / f"{name}.png", planes, np.uint8)
    (tmp_path / "wall.mtlx").write_text(PLAIN)
    return tmp_path


def test_files_are_what_the_surface_makes_of_them(folder):
    assert files_of_mtlx(folder / "wall.mtlx").kinds == {
        "color": Named(folder / "one.png"), "roughness": Named(folder / "two.png", 1), "metalness": Named(folder / "two.png", 2),
        "normalgl": Named(folder / "three.png"), "displacement": Named(folder / "five.png"),
    }
    found = find_textures(folder)
    assert is_texture_set(folder) and dict(found.rows())["roughness"] == "two.png, green"
    assert found.left_out == {"four.png": "what the document makes of it: torchmat has no place for it"}
    assert set(read_textures(found)) == {"color", "roughness", "metalness", "normalgl", "displacement"}
    assert microfacet_from_textures(folder, height_scale=0).options["parts"] == ["normal"]


def test_a_document_goes_before_names(folder):
    write(folder / "x_Color.png", torch.zeros(3, 4, 5), np.uint8)
    found = find_textures(folder)
    assert found.files["color"].path.name == "one.png" and found.left_out["x_Color.png"] == "color: wall.mtlx names another"


def test_graphs_prefixes_and_interfaces(folder):
    (folder / "maps").mkdir()
    write(folder / "maps" / "x.png", torch.rand(3, 4, 5), np.uint8)
    (folder / "wall.mtlx").write_text("""<materialx version="1.39" fileprefix="maps/">
      <nodegraph name="g"><input name="f" type="filename" value="x.png"/>
        <image name="i" type="color3"><input name="file" type="filename" interfacename="f"/></image>
        <output name="out" type="color3" nodename="i"/></nodegraph>
      <open_pbr_surface name="s" type="surfaceshader"><input name="base_color" type="color3" nodegraph="g" output="out"/></open_pbr_surface>
    </materialx>""")
    assert files_of_mtlx(folder / "wall.mtlx").kinds == {"color": Named(folder / "maps" / "x.png")}


def test_what_two_files_feed_is_left_to_the_names(folder):
    text = PLAIN.replace('nodename="c"/>', 'nodename="both"/>').replace("<normalmap", """<multiply name="both" type="color3">
      <input name="in1" type="color3" nodename="c"/><input name="in2" type="color3" nodename="n"/></multiply><normalmap""")
    (folder / "wall.mtlx").write_text(text)
    assert "color" not in files_of_mtlx(folder / "wall.mtlx").kinds


@pytest.mark.parametrize("form", ["portable", "closest"])
def test_the_export_of_torchmat_is_read(tmp_path, form):
    material = microfacet("normal", "anisotropy").on_relief(torch.rand(1, 8, 12) * 0.01)
    tm.export(material, tmp_path / "m", to="materialx", form=form)
    if form == "closest":  # a graph of lobes has no such inputs
        assert files_of_mtlx(tmp_path / "m" / "material.mtlx").kinds.keys() == {"displacement"}
        return
    kinds = files_of_mtlx(tmp_path / "m" / "material.mtlx").kinds
    assert {kind: one.path.name for kind, one in kinds.items()} == {
        "color": "base_color.png", "roughness": "specular_roughness.png", "normalgl": "normal.png", "displacement": "height.png",
    }
    read = microfacet_from_textures(tmp_path / "m", height_scale=0, tiles=True)
    assert float((read.maps["diffuse"] - material.maps["diffuse"]).detach().abs().max()) < 1e-4


@pytest.mark.parametrize(("text", "words"), [
    ("", "be XML"), ("<materialx>", "be XML"), ("<x/>", "have the root materialx; its root is 'x'"),
    ('<!DOCTYPE m [<!ENTITY a "b">]><materialx/>', "be plain XML"), ("<materialx>" + "<a>" * 99 + "</a>" * 99 + "</materialx>", "at most 32 deep"),
    (PLAIN.replace("one.png", "absent.png"), "the file 'absent.png' must lie in the document's folder; it is not there"),
    (PLAIN.replace("one.png", "../../../etc/passwd"), "it leads elsewhere"), (PLAIN.replace("one.png", ""), "it has no name"),
    (PLAIN.replace('"srgb_texture"', '"lin_rec709"'), "the colour space of one.png must be sRGB in whole numbers"),
    (PLAIN.replace('nodename="c"', 'nodegraph="g" output="x"') + "", "."),
])
def test_a_damaged_document_is_refused_by_name(folder, text, words):
    (folder / "wall.mtlx").write_text(text)
    if words == ".":
        assert "color" not in files_of_mtlx(folder / "wall.mtlx").kinds  # there is no such graph
        return
    with pytest.raises(DataError, match=words) as error:
        find_textures(folder)
    assert "wall.mtlx" in str(error.value)


def test_circles_end(folder):
    (folder / "wall.mtlx").write_text(PLAIN.replace('<normalmap name="bump" type="vector3"><input name="in" type="vector3" nodename="n"/>',
                                                    '<normalmap name="bump" type="vector3"><input name="in" type="vector3" nodename="bump"/>'))
    assert "normalgl" not in files_of_mtlx(folder / "wall.mtlx").kinds


def test_two_documents_leave_it_to_the_names(folder):
    (folder / "other.mtlx").write_text(PLAIN)
    assert document_of(folder) is None
    with pytest.raises(DataError, match="tell what they are"):
        find_textures(folder)
