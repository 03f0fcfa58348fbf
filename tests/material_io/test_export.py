"""Exports: what is said to be exact is, what is lost is named, and an exporter from outside is one file."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from tests.models.distributions import distribution
from tests.models.examples import make

import torchmat as tm
from torchmat import DataError, Exporter, Losses, RangeError
from torchmat.images import write_image
from torchmat.material_io import EXPORTERS, check_target, register_exporter, unpack, unregister_exporter
from torchmat.models import Texture


def shading_map(**options):
    return make("shading_map", {"slices": 4, "brdf": "phong", **options}, 2, 3, torch.float32)


def texture(value=0.25):
    return Texture({"albedo": torch.full((3, 2, 2), value)}, storage="half")


def losses_of(path):
    return json.loads(path.read_text("utf-8"))


def test_the_table_has_the_forms_that_come_with_the_package():
    files = {"3pm": ".3pm", "gltf": ".glb", "ptm": ".ptm", "rti": ".rti", "html": ".html"}
    folders = ("folder", "packed", "materialx", "mitsuba", "blender", "orm", "relight", "openlime", "ktx2", "tiled")
    assert {name: one.suffix for name, one in EXPORTERS.items()} == {**files, **dict.fromkeys(folders)}
    assert EXPORTERS["packed"].options == {"depth": 8} and EXPORTERS["folder"].options == {"storage": None}
    assert all(one.description for one in EXPORTERS.values())


def test_a_folder_is_the_material_with_its_losses_inside(tmp_path):
    losses = tm.export(texture(), tmp_path / "m", to="folder", provenance={"made": "by hand"})
    assert losses == Losses(exact=("albedo",))  # 0.25 is a half
    assert str(losses) == "exact: albedo; approximated: nothing; lost: nothing"
    table = losses_of(tmp_path / "m" / "loss.json")
    assert table["files"] == ["albedo.exr", "manifest.json", "loss.json"]
    assert (table["exporter"], table["model"], table["exact"], table["lost"]) == ("folder", "texture", ["albedo"], {})
    assert table["provenance"] == {"made": "by hand"} and table["options"] == {"storage": None}
    assert torch.equal(tm.load_material(tmp_path / "m").maps["albedo"], texture().maps["albedo"])
    assert json.loads((tmp_path / "m" / "manifest.json").read_text())["provenance"] == {"made": "by hand"}


def test_what_is_approximated_says_by_how_much(tmp_path):
    material = Texture({"albedo": torch.tensor([[0.0, 0.1], [0.3, 1.0]]).expand(3, 2, 2).contiguous()})
    losses = tm.export(material, tmp_path / "m", "folder", storage="png16")
    off = float((tm.load_material(tmp_path / "m").maps["albedo"] - material.maps["albedo"]).detach().abs().max())
    assert losses.approximated == {"albedo": f"off by at most {off:.3g}, values up to 1"} and off > 0
    assert losses.exact == ()


def test_own_files_are_replaced_by_either_way_and_those_of_others_are_not(tmp_path):
    tm.export(texture(), tmp_path / "m", "folder")
    tm.save_material(texture(0.5), tmp_path / "m")
    assert not (tmp_path / "m" / "loss.json").exists()
    tm.export(texture(), tmp_path / "m", "folder")
    with pytest.raises(DataError, match="be empty or an earlier export to 'packed' and nothing else"):
        tm.export(distribution(), tmp_path / "m", "packed")
    (tmp_path / "m" / "diary.txt").write_text("mine")
    with pytest.raises(DataError, match="first 'diary.txt'"):
        tm.export(texture(), tmp_path / "m", "folder")
    assert (tmp_path / "m" / "diary.txt").read_text() == "mine"


def test_a_3pm_says_what_it_cannot_hold(tmp_path):
    losses = tm.export(shading_map(), tmp_path / "wool.3pm")
    assert set(losses.approximated) == {"slices"} and set(losses.lost) == {"brdf", "lobe", "brightest"}
    assert losses.lost["brdf"] == "it is 'phong', and the file is read as 'lambert'"
    assert losses_of(tmp_path / "wool.3pm.loss.json")["files"] == ["wool.3pm"]
    read = tm.load_material(tmp_path / "wool.3pm")
    assert tm.export(read, tmp_path / "copy.3pm") == Losses(exact=("slices", "lobe", "brightest"))
    assert (tmp_path / "copy.3pm").read_bytes() == (tmp_path / "wool.3pm").read_bytes()
    tm.export(shading_map(), tmp_path / "wool.3pm")  # an export is replaced
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "copy.3pm", "copy.3pm.loss.json", "wool.3pm", "wool.3pm.loss.json",
    ]


def test_a_file_of_the_users_is_not_replaced(tmp_path):
    (tmp_path / "wool.3pm").write_bytes(b"mine")
    with pytest.raises(DataError, match="wool.3pm: the target must be new or an earlier export; no wool.3pm.loss.json says"):
        tm.export(shading_map(), tmp_path / "wool.3pm")
    (tmp_path / "wool.3pm.loss.json").write_text("[1]")
    with pytest.raises(DataError, match="must be new or an earlier export"):
        tm.export(shading_map(), tmp_path / "wool.3pm")
    assert (tmp_path / "wool.3pm").read_bytes() == b"mine"


@pytest.mark.parametrize("depth", [8, 16])
def test_packed_textures_and_their_losses(tmp_path, depth):
    material = distribution(5, 4, 2, ("normal", "rotation"), relief=True)
    losses = tm.export(material, tmp_path / "p", to="packed", depth=depth)
    found = unpack(tmp_path / "p")
    assert losses.lost == {} and set(losses.exact) | set(losses.approximated) == set(material.maps)
    off = float((found.maps["diffuse"].double() - material.maps["diffuse"].double()).detach().abs().max())
    assert losses.approximated["diffuse"].startswith(f"off by at most {off:.3g},")
    assert losses_of(tmp_path / "p" / "loss.json")["options"] == {"depth": depth}
    tm.pack(material, tmp_path / "p")  # which may replace it
    assert not (tmp_path / "p" / "loss.json").exists()


def test_names_options_and_suffixes_are_checked(tmp_path):
    with pytest.raises(RangeError, match="to must be one of .folder., .3pm., .packed., .*; it is .pakced.. Did you"):
        tm.export(texture(), tmp_path / "m", to="pakced")
    with pytest.raises(RangeError, match="to must name an exporter; .*ends in no suffix of one. Name one of: folder, 3pm"):
        tm.export(texture(), tmp_path / "m.xyz")
    with pytest.raises(RangeError, match="export to packed: key 'dept' must be one of: depth; .*Did you mean 'depth'"):
        tm.export(distribution(), tmp_path / "m", to="packed", dept=8)
    with pytest.raises(RangeError, match="the name must end in .3pm for '3pm'; it is 'm'. For example m.3pm"):
        tm.export(shading_map(), tmp_path / "m", to="3pm")
    with pytest.raises(RangeError, match="m.3pm: the target must be a folder for 'folder'; its name ends in .3pm"):
        tm.export(shading_map(), tmp_path / "m.3pm", to="folder")
    with pytest.raises(RangeError, match="m.3pm: the material must be a shading_map for a .3pm file; it is texture"):
        tm.export(texture(), tmp_path / "m.3pm")
    assert not list(tmp_path.iterdir())


# An exporter from outside, in each of the two shapes.


def write_means(material, path, *, digits=3):
    """Write the mean of every texture as text: an exporter of one file."""
    lines = [
        f"{one.name},{one.colour_space},{one.range[0]},{one.range[1]},{round(float(one.values.mean()), digits)}"
        for one in material.textures()
    ]
    lines += [f"{spec.name},numbers,{values.tolist()}" for spec, values in material.numbers()]
    path.write_text("\n".join(lines))
    return Losses(approximated={one.spec.name: "its mean" for one in material.textures()})


def write_tiffs(material, path, *, provenance=None):
    """Write every texture as 16-bit codes: an exporter of a folder."""
    for one in material.textures():
        write_image(path / f"{one.name}.tif", one.codes("tiff16").pixels)
    return Losses(approximated={one.spec.name: "16 bits" for one in material.textures()})


@pytest.fixture
def outside():
    register_exporter(Exporter("means", "the mean of every texture", write_means, ".means"))
    register_exporter(Exporter("tiffs", "16-bit pictures", write_tiffs))
    yield
    for name in ("means", "tiffs"):
        unregister_exporter(name)


def test_an_exporter_from_outside_writes_one_file(outside, tmp_path):
    losses = tm.export(texture(), tmp_path / "a.means", digits=1)
    assert (tmp_path / "a.means").read_text() == "albedo,linear,0.0,None,0.2"
    assert str(losses) == "exact: nothing; approximated: albedo; lost: nothing"
    assert losses_of(tmp_path / "a.means.loss.json")["options"] == {"digits": 1}
    tm.save_material(texture(), tmp_path / "b.MEANS")  # by its suffix, and nothing beside it
    assert (tmp_path / "b.MEANS").read_text() == "albedo,linear,0.0,None,0.25"
    assert not (tmp_path / "b.MEANS.loss.json").exists()
    with pytest.raises(DataError, match="c.means: the target must be a folder; its name ends in .means"):
        check_target(tmp_path / "c.means")  # what a fit asks before it begins


def test_an_exporter_from_outside_writes_a_folder_and_replaces_its_own_alone(outside, tmp_path):
    material = distribution(3, 4, 2, ("normal",))
    tm.export(material, tmp_path / "t", to="tiffs")
    first = {path.name for path in (tmp_path / "t").iterdir()}
    assert first == {f"{one.name}.tif" for one in material.textures()} | {"loss.json"}
    tm.export(texture(), tmp_path / "t", to="tiffs")
    assert {path.name for path in (tmp_path / "t").iterdir()} == {"albedo.tif", "loss.json"}
    (tmp_path / "t" / "notes.txt").write_text("mine")
    with pytest.raises(DataError, match="an earlier export to 'tiffs' and nothing else; 1 of 3 files .* 'notes.txt'"):
        tm.export(texture(), tmp_path / "t", to="tiffs")


def _fails(material, path, **options):
    if path.is_dir():
        (path / "half").write_text("half")
    raise RangeError(f"{path}: the material must be another; it is not.")


@pytest.mark.parametrize("write, suffix, words", [
    (_fails, ".x", "x: the material must be another"),
    (_fails, None, "x: the material must be another"),
    (lambda material, path: path.write_text("x"), ".x", "what `write` returns must be Losses; it is int"),
    (lambda material, path: Losses(), ".x", "`write` must write the file; there is none"),
])
def test_what_goes_wrong_in_an_exporter_leaves_what_was_there(tmp_path, write, suffix, words):
    def good(material, path):
        (path if suffix else path / "a.txt").write_text("old")
        return Losses()

    target = tmp_path / f"x{suffix or ''}"
    for one in (good, write):
        register_exporter(Exporter("x", "", one, suffix))
        try:
            if one is good:
                tm.export(texture(), target, "x")
            else:
                with pytest.raises(RangeError, match=words) as error:
                    tm.export(texture(), target, "x")
                assert "building" not in str(error.value)
        finally:
            unregister_exporter("x")
    assert (target if suffix else target / "a.txt").read_text() == "old"
    assert not [path for path in tmp_path.rglob("*") if "building" in path.name or path.name == "half"]


def test_registering_is_checked(outside):
    with pytest.raises(RangeError, match="the exporter's name must be new; 'means' is taken"):
        register_exporter(Exporter("means", "", write_means))
    with pytest.raises(RangeError, match="the suffix must be new; .3pm is that of '3pm'"):
        register_exporter(Exporter("volume", "", write_means, ".3pm"))
    with pytest.raises(RangeError, match="exporter must be an Exporter; it is function"):
        register_exporter(write_means)
    with pytest.raises(RangeError, match="Exporter bare: write must be a function; it is None"):
        Exporter("bare", "")
    with pytest.raises(RangeError, match="suffix must be a point and small letters; it is 'glb'"):
        Exporter("bare", "", write_means, "glb")
    with pytest.raises(RangeError, match="name must be a word; it is 'A b'"):
        Exporter("A b", "", write_means)
    with pytest.raises(RangeError, match="name must be one of .*; it is 'mean'"):
        unregister_exporter("mean")


def test_textures_say_what_they_mean():
    material = distribution(3, 4, 2, ("normal", "specular_mask"))
    textures = {one.name: one for one in material.textures()}
    assert (textures["diffuse"].colour_space, textures["normal"].colour_space) == ("linear", "data")
    assert textures["diffuse"].range == (0.0, None) and textures["diffuse"].meaning
    assert textures["diffuse"].values.shape == (3, 3, 4)
    codes = textures["diffuse"].codes("png8")
    assert codes.pixels.dtype == np.uint8 and codes.transfer == "srgb"
    assert textures["diffuse"].codes().pixels.dtype == np.float16  # its own storage


def test_the_example_of_the_page_runs_as_it_stands(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    page = (Path(tm.__file__).parent / "material_io" / "FORMAT.md").read_text("utf-8")
    try:
        exec(page.split("```python\n")[1].split("```")[0], {"material": texture()})  # noqa: S102
    finally:
        unregister_exporter("tiffs")
    assert capsys.readouterr().out == "exact: nothing; approximated: albedo; lost: nothing\n"
    assert {path.name for path in Path("wool_tiffs").iterdir()} == {"albedo.tif", "loss.json"}


@pytest.mark.parametrize("name", EXPORTERS)
def test_the_page_lists_each_exporter_and_its_options(name):
    page = (Path(tm.__file__).parent / "material_io" / "FORMAT.md").read_text("utf-8")
    row = next(line for line in page.splitlines() if line.startswith(f"| `{name}` |"))
    assert all(f"`{option}`" in row for option in EXPORTERS[name].options)
