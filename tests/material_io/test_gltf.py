"""GLBs: what comes back of a material, what Khronos's validator says of them, and what no GLB may do to a reader."""

from __future__ import annotations

import functools
import json
import shutil
import struct
import subprocess
from pathlib import Path

import numpy as np
import pytest
import torch
from tests.material_io.forms import microfacet, rand
from tests.models.examples import EXAMPLE_OPTIONS, make

import torchmat as tm
from torchmat import DataError, RangeError
from torchmat.errors import Notice
from torchmat.material_io.as_microfacet import as_microfacet, shading_error
from torchmat.material_io.glb import Buffer, read_glb, write_glb
from torchmat.material_io.gltf_material import material_of
from torchmat.material_io.pictures import png_bytes
from torchmat.models.renderers import as_gltf
from torchmat.rendering.mesh import load_mesh
from torchmat.rendering.shapes import make_mesh

PARTS = ([], ["normal"], ["anisotropy"], ["f90"], ["coat", "layered"], ["sheen"], ["normal", "anisotropy", "f90", "coat", "sheen"])


@pytest.mark.parametrize("parts", PARTS, ids="+".join)
def test_what_the_form_holds_comes_back(tmp_path, parts):
    material = microfacet(*parts)
    if "f90" in parts:  # below F0 it is not held
        material = material.with_maps(specular_f0=0.3 * material.maps["specular_f0"])
    losses = tm.export(material, tmp_path / "m.glb")
    read = tm.load_material(tmp_path / "m.glb")
    held = [part for part in parts if part != "layered"]
    assert read.options["parts"] == [part for part in ("normal", "anisotropy", "f90", "coat", "sheen") if part in held]
    plain = material if "layered" not in parts else microfacet(*held)
    assert shading_error(plain, read) < 1e-6
    if "layered" not in parts:
        assert losses.errors["native"] == shading_error(material, as_microfacet(read))
    assert losses.lost == ({"layered": "renderers have their own way"} if "layered" in parts else {})


def test_of_f90_below_f0_the_latter_is_kept(tmp_path):
    material = microfacet("f90", f90=torch.full((1, 8, 12), 0.05))
    losses = tm.export(material, tmp_path / "m.glb")
    read = tm.load_material(tmp_path / "m.glb")
    assert float((read.maps["specular_f0"] - material.maps["specular_f0"]).detach().abs().max()) < 1e-4
    assert "f90" in (*losses.approximated, *losses.lost) and 1e-6 < losses.errors["native"] < 0.2


def test_8_bits_are_a_choice_that_is_measured(tmp_path):
    material = microfacet("normal", "anisotropy")
    fine, coarse = (tm.export(material, tmp_path / f"{depth}.glb", depth=depth) for depth in (16, 8))
    assert fine.errors["native"] < coarse.errors["native"] < 1e-3
    assert (tmp_path / "8.glb").stat().st_size < (tmp_path / "16.glb").stat().st_size


def test_height_opacity_and_tiling_come_back(tmp_path):
    material = microfacet("normal").on_relief(0.02 * rand(1, 3), 0.1 * rand(3, 4)).repeating(False)
    material = material._like({**material.maps, "opacity": (rand(1, 9) > 0.5).float()})
    losses = tm.export(material, tmp_path / "m.glb")
    read = tm.load_material(tmp_path / "m.glb")
    assert not read.tiles and losses.lost == {"ambient": "light from texel to texel has no place"}
    for name, most in (("height", 1e-6), ("opacity", 0), ("diffuse", 5e-5)):
        assert float((read.maps[name] - material.maps[name]).detach().abs().max()) <= most
    one, other = (found.surface().maps["normal"].detach() for found in (material, read))
    assert float((one - other).abs().max()) < 1e-4


def test_numbers_of_the_tree_are_those_of_the_extensions(tmp_path):
    material = microfacet("normal", "anisotropy")
    tm.export(material, tmp_path / "m.glb")
    glb = read_glb(tmp_path / "m.glb")
    described = glb.tree["materials"][0]
    wanted = as_gltf(material)
    factor = torch.tensor(described["extensions"]["KHR_materials_specular"]["specularColorFactor"])
    assert torch.allclose(factor, wanted.specular_colour.amax(dim=(1, 2)))
    assert described["extensions"]["KHR_materials_ior"] == {"ior": 1.5}
    assert described["pbrMetallicRoughness"]["metallicFactor"] == 0
    assert glb.tree["extensionsUsed"] == sorted(described["extensions"]) and "extensionsRequired" not in glb.tree


@pytest.mark.parametrize("name", ["quad", "cube", "torus"])
def test_the_mesh_comes_back_with_its_tangents(tmp_path, name):
    mesh = make_mesh(name, **({"segments": 12} if name == "torus" else {}))
    tm.export(microfacet(), tmp_path / "m.glb", mesh=mesh)
    read = load_mesh(tmp_path / "m.glb")
    assert torch.equal(read.position[read.faces], mesh.position[mesh.faces])
    assert torch.allclose(read.uv[read.faces], mesh.uv[mesh.faces], atol=1e-6)
    glb = read_glb(tmp_path / "m.glb")
    number = glb.tree["meshes"][0]["primitives"][0]["attributes"]["TANGENT"]
    data = np.frombuffer(glb.view_bytes(glb.tree["accessors"][number]["bufferView"]), np.float32).reshape(-1, 4)
    assert np.abs(data[:, :3] - mesh.tangent.numpy()).max() < 1e-6 and np.array_equal(data[:, 3], mesh.handedness.numpy())


def test_a_mesh_must_be_one(tmp_path):
    with pytest.raises(RangeError, match="mesh must be 'quad' or a mesh; it is 'teapot'. Give torchmat.rendering.load_mesh"):
        tm.export(microfacet(), tmp_path / "m.glb", mesh="teapot")
    assert not list(tmp_path.iterdir())


@functools.cache
def validator() -> list[str] | None:
    """Return how Khronos's validator is run, None where it is not installed."""
    node, npm = shutil.which("node"), shutil.which("npm")
    if node is None or npm is None:
        return None
    folder = subprocess.run([npm, "root", "-g"], capture_output=True, text=True, check=False).stdout.strip()
    return [node, folder] if (Path(folder) / "gltf-validator").is_dir() else None


def issues(paths: list[Path]) -> list[dict]:
    how = validator()
    if how is None:
        pytest.skip("gltf-validator is not installed: npm install -g gltf-validator")
    script = Path(__file__).parent / "gltf_validator.js"
    done = subprocess.run([how[0], str(script), *map(str, paths)], capture_output=True, text=True, check=True, env={"NODE_PATH": how[1]})
    return [json.loads(line) for line in done.stdout.splitlines()]


def test_khronos_finds_nothing_wrong_with_any_model_on_any_mesh(tmp_path):
    materials = {
        name: make(name, options[-1], 4, 5, torch.float32) for name, options in EXAMPLE_OPTIONS.items() if name not in ("pca", "local_pca")
    }
    materials |= {"cut out": microfacet(opacity=rand(1, 8)), "relief": microfacet("normal").on_relief(0.01 * rand(1, 3)), "parts": microfacet(*PARTS[-1])}
    meshes = {"quad": "quad", "cube": make_mesh("cube"), "teapot": make_mesh("teapot", segments=4), "torus": make_mesh("torus", segments=9)}
    forms = {name: as_microfacet(material) for name, material in materials.items() if not material.has_relief}
    paths = []
    for name, material in materials.items():
        for mesh, shape in meshes.items():
            paths.append(tmp_path / f"{name}_{mesh}.glb")
            tm.save_material(forms.get(name, material), paths[-1]) if mesh == "quad" else tm.export(forms.get(name, material), paths[-1], mesh=shape)
    found = issues(paths)
    assert len(found) == len(paths)
    for one in found:
        assert one["numErrors"] == one["numWarnings"] == 0, (one["path"], one["messages"][:3])


# Readers of what others wrote, and of what nobody should have.


def glb_of(path: Path, material: dict, pictures: tuple[np.ndarray, ...] = (), **more) -> Path:
    buffer = Buffer()
    images = [{"bufferView": buffer.add_bytes(png_bytes(codes)), "mimeType": "image/png"} for codes in pictures]
    tree = {"asset": {"version": "2.0"}, "materials": [material], "images": images,
            "textures": [{"source": number} for number in range(len(images))], **more}
    write_glb(path, tree, buffer)
    return path


def test_defaults_and_metal_of_others(tmp_path):
    gold = glb_of(tmp_path / "gold.glb", {"pbrMetallicRoughness": {"baseColorFactor": [1.0, 0.8, 0.4, 1.0], "roughnessFactor": 0.3}})
    read = material_of(gold)
    assert read.size == (1, 1) and float(read.maps["diffuse"].detach().max()) == 0
    assert torch.allclose(read.maps["specular_f0"].flatten(), torch.tensor([1.0, 0.8, 0.4])) and read.options["parts"] == []
    plastic = material_of(glb_of(tmp_path / "p.glb", {"pbrMetallicRoughness": {"metallicFactor": 0.0}, "extensions": {
        "KHR_materials_ior": {"ior": 2.0}, "KHR_materials_anisotropy": {"anisotropyStrength": 0.5, "anisotropyRotation": 1.0}}}))
    assert float(plastic.maps["specular_f0"].detach().mean()) == pytest.approx(1 / 9)
    assert plastic.maps["rotation"].detach().flatten().tolist() == pytest.approx([np.cos(1), np.sin(1)])
    assert plastic.maps["roughness"].detach().flatten().tolist() == pytest.approx([1, 1])


def test_textures_of_two_sizes_and_what_is_left_out(tmp_path):
    small, large = np.full((2, 2, 3), 128, np.uint8), np.random.default_rng(0).integers(0, 255, (4, 4, 3), np.uint8)
    path = glb_of(tmp_path / "m.glb", {
        "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "metallicRoughnessTexture": {"index": 1}, "metallicFactor": 0},
        "emissiveTexture": {"index": 0}, "extensions": {"KHR_materials_iridescence": {}},
    }, (large, small))
    with pytest.warns(Notice, match="emissiveTexture, KHR_materials_iridescence left out"):
        read = material_of(path)
    assert read.size == (4, 4) and float(read.maps["roughness"].detach().mean()) == pytest.approx(128 / 255)


@pytest.mark.parametrize(("material", "words"), [
    ({"pbrMetallicRoughness": 3}, "pbrMetallicRoughness must be an object; it is a int"),
    ({"pbrMetallicRoughness": {"roughnessFactor": "x"}}, "roughnessFactor must be a number in"),
    ({"pbrMetallicRoughness": {"baseColorTexture": {"index": 4}}}, "textures 4 must be one of 1; it is not there"),
    ({"pbrMetallicRoughness": {"baseColorTexture": {"index": 0, "texCoord": 1}}}, "use the first texture coordinates"),
    ({"extensions": {"KHR_materials_ior": {"ior": 0.5}}}, "ior must be 0 or at least 1"),
    ({"extensions": {"KHR_materials_specular": {"specularColorFactor": [1, 2]}}}, "specularColorFactor must be 3 numbers"),
    ({"normalTexture": {"index": 0, "scale": float("nan")}}, "scale must be a number"),
])
def test_a_material_that_is_none_is_refused_by_name(tmp_path, material, words):
    path = glb_of(tmp_path / "m.glb", {"name": "m", **material}, (np.zeros((2, 2, 3), np.uint8),))
    with pytest.raises(DataError, match=words) as error:
        tm.load_material(path)
    assert str(path) in str(error.value)


def test_a_picture_that_lies_elsewhere_or_promises_too_much(tmp_path):
    used = {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}
    path = glb_of(tmp_path / "m.glb", used, images=[{"uri": "../../etc/passwd"}], textures=[{"source": 0}])
    with pytest.raises(DataError, match="a PNG or JPEG of the GLB's own buffer; it lies elsewhere"):
        material_of(path)
    head = b"\x89PNG\r\n\x1a\n" + struct.pack(">I4sIIBBBBB", 13, b"IHDR", 60000, 60000, 16, 6, 0, 0, 0) + bytes(8)
    buffer = Buffer()
    view = buffer.add_bytes(head)
    write_glb(path, {"asset": {"version": "2.0"}, "materials": [{"name": "m", **used}], "textures": [{"source": 0}],
                     "images": [{"bufferView": view, "mimeType": "image/png"}]}, buffer)
    with pytest.raises(DataError, match="its head promises 60000 x 60000"):
        material_of(path)


@pytest.mark.parametrize(("change", "words"), [
    (lambda data: b"", "start as one does"), (lambda data: b"glTF" + data[4:9], "start as one does"),
    (lambda data: data[:100], "be a whole glTF 2.0; it has 100 of"), (lambda data: data[:4] + b"\1\0\0\0" + data[8:], "it is of version 1"),
    (lambda data: data[:12] + b"\xff\xff\0\0" + data[16:], "chunks of the GLB must lie inside|be JSON|hold glTF"),
    (lambda data: data[:20] + b"[" + data[21:], "hold glTF's JSON"),
])
def test_a_damaged_container_is_refused(tmp_path, change, words):
    tm.export(microfacet(), tmp_path / "m.glb")
    data = (tmp_path / "m.glb").read_bytes()
    (tmp_path / "x.glb").write_bytes(change(data))
    with pytest.raises(DataError, match=words) as error:
        tm.load_material(tmp_path / "x.glb")
    assert "x.glb" in str(error.value)


def test_a_glb_without_a_material(tmp_path):
    buffer = Buffer()
    buffer.add_bytes(b"1234")
    write_glb(tmp_path / "m.glb", {"asset": {"version": "2.0"}}, buffer)
    with pytest.raises(DataError, match="the GLB must hold a material; it holds none. Load it as a mesh"):
        tm.load_material(tmp_path / "m.glb")
