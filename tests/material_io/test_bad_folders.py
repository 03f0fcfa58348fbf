"""Folders that are no material, no longer one, or somebody else's."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest
import torch
from tests.models.examples import make

from torchmat import DataError, load_material, save_material
from torchmat.images import read_image, write_image
from torchmat.material_io import folder as folder_module


def material_of(storage="png8", seed=0):
    return make("lambert", {}, 4, 6, dtype=torch.float32, seed=seed, storage=storage)


@pytest.fixture
def folder(tmp_path):
    return save_material(material_of(), tmp_path / "mat")


def snapshot(folder):
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def edit(folder, change):
    path = folder / "manifest.json"
    manifest = json.loads(path.read_text("utf-8"))
    changed = change(manifest)
    path.write_text(json.dumps(manifest if changed is None else changed), encoding="utf-8")


def refused(folder, said):
    with pytest.raises(DataError, match=said):
        load_material(folder)


# Textures


def test_a_missing_texture(folder):
    (folder / "normal.png").unlink()
    refused(folder, r"normal\.png: the texture must exist; it is not there\. Restore")


@pytest.mark.parametrize("channels", [1, 2])
def test_a_texture_that_lost_channels(folder, channels):
    write_image(folder / "normal.png", np.zeros((4, 6, channels), np.uint8))
    refused(folder, r"normal\.png")


@pytest.mark.parametrize("keep", [0, 10, 60])
def test_a_texture_cut_short(folder, keep):
    path = folder / "normal.png"
    path.write_bytes(path.read_bytes()[:keep])
    refused(folder, r"normal\.png: the image must be readable")


def test_a_text_called_png(folder):
    (folder / "normal.png").write_text("hello", encoding="utf-8")
    refused(folder, r"normal\.png: the image must be readable")


def test_float_pixels_where_codes_belong(folder):
    shutil.copy(folder / "normal.png", folder / "keep.png")
    write_image(folder / "normal.exr", np.zeros((4, 6, 3), np.float32))
    edit(folder, lambda manifest: manifest["textures"][1].update(file="normal.exr"))
    refused(folder, r"normal\.exr: the texture must hold 8- or 16-bit codes; it is float32")


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_nan_in_a_float_texture(tmp_path, bad):
    folder = save_material(material_of("float"), tmp_path / "mat")
    pixels = read_image(folder / "albedo.exr")
    pixels[1, 2, 0] = bad
    write_image(folder / "albedo.exr", pixels)
    refused(folder, r"albedo\.exr: the texture must be finite; 1 of 72 values .* first at index \(0, 1, 2\)")


def test_a_float_texture_painted_out_of_its_range(tmp_path):
    folder = save_material(material_of("float"), tmp_path / "mat")
    pixels = read_image(folder / "albedo.exr")
    pixels[1, 2, 0] = -0.5
    write_image(folder / "albedo.exr", pixels)
    refused(folder, r"albedo\.exr: .*albedo must lie in \[0\.0, inf\]; 1 of 72 values")


def test_an_index_beyond_the_clusters(tmp_path):
    material = make("local_pca", {"clusters": 3, "components": 2}, 4, 6, dtype=torch.float32)
    folder = save_material(material, tmp_path / "mat")
    write_image(folder / "cluster.png", np.full((4, 6, 1), 3, np.uint8))
    refused(folder, r"cluster\.png: .*cluster must lie in \[0\.0, 2\.0\]")


# The manifest


def test_no_manifest(tmp_path):
    refused(tmp_path, r"manifest\.json: the manifest must exist; it is not there\. Give the folder that")
    refused(tmp_path / "nowhere", r"manifest\.json: the manifest must exist")


@pytest.mark.parametrize("content", [b"", b"{", b"[1]", b"3", b"\xff\xfe", b"{}", b'"text"', b"null"])
def test_a_manifest_that_is_none(folder, content):
    (folder / "manifest.json").write_bytes(content)
    refused(folder, r"manifest\.json: the manifest must be a torchmat material")


TAMPERED = {
    "version": (lambda m: m.update(version=4), r"version must be 1, 2 or 3; it is 4\. Update torchmat"),
    "version text": (lambda m: m.update(version="1"), "version must be 1"),
    "format": (lambda m: m.update(format="gltf"), "format must be 'torchmat-material'"),
    "model": (lambda m: m.update(model="lambret"), "Did you mean 'lambert'"),
    "model kind": (lambda m: m.update(model=["lambert"]), "manifest"),
    "no textures": (lambda m: m.pop("textures"), "textures"),
    "textures kind": (lambda m: m.update(textures="normal.png"), "manifest"),
    "no map": (lambda m: m["textures"][0].pop("map"), "map"),
    "no file": (lambda m: m["textures"][0].pop("file"), "file"),
    "lost texture": (lambda m: m["textures"].pop(), "normal is missing"),
    "texture twice": (lambda m: m["textures"].append(m["textures"][0]), "albedo"),
    "unknown map": (lambda m: m["textures"][0].update(map="albino"), "Did you mean 'albedo'"),
    "storage": (lambda m: m.update(storage="jpeg"), "storage"),
    "options": (lambda m: m.update(options={"terms": 9}), "terms"),
    "options kind": (lambda m: m.update(options=3), "manifest"),
    "transfer": (lambda m: m["textures"][1].update(transfer="gamma"), "transfer"),
    "low short": (lambda m: m["textures"][1].update(low=[0.0]), "low"),
    "low gone": (lambda m: m["textures"][1].pop("low"), "low"),
    "high gone": (lambda m: m["textures"][1].pop("high"), "high"),
    "low text": (lambda m: m["textures"][1].update(low=["a", "b", "c"]), "manifest"),
    "low nan": (lambda m: m["textures"][1].update(low=[float("nan")] * 3), "finite"),
    "high beyond": (lambda m: m["textures"][1].update(high=[7.0] * 3), r"normal must lie in"),
    "channels": (lambda m: m["textures"][1].update(channels=4), r"normal\.png"),
    "height": (lambda m: m["textures"][1].update(height=5), r"manifest\.json: the entry of normal\.png must be 4 x 6"),
    "tiles": (lambda m: m.pop("tiles"), "tiles"),
    "constant": (lambda m: m.update(constants={"albedo": [1.0]}), "albedo"),
}


@pytest.mark.parametrize("case", TAMPERED)
def test_a_tampered_manifest_is_refused(folder, case):
    change, said = TAMPERED[case]
    edit(folder, lambda manifest: (change(manifest), None)[1])
    with pytest.raises(DataError, match=said) as error:
        load_material(folder)
    assert str(folder) in str(error.value)


@pytest.mark.parametrize("file", ["../secret.png", "/etc/passwd", "sub/normal.png", "..", ".", "", "a\0b.png"])
def test_a_file_that_leads_elsewhere_is_refused(folder, file):
    write_image(folder.parent / "secret.png", np.zeros((4, 6, 3), np.uint8))
    (folder / "sub").mkdir()
    shutil.copy(folder / "normal.png", folder / "sub" / "normal.png")
    edit(folder, lambda manifest: manifest["textures"][1].update(file=file))
    refused(folder, "must (be a plain name|exist)")


# Targets


def test_a_material_there_is_replaced(folder):
    save_material(material_of("half"), folder, companions=lambda new: (new / "report.json").write_text("{}") and None)
    save_material(material_of("half", seed=5), folder)
    assert torch.equal(load_material(folder).maps["normal"], material_of("half", seed=5).as_exported().maps["normal"])
    assert {path.name for path in folder.iterdir()} == {"manifest.json", "albedo.exr", "normal.exr"}


def test_an_empty_folder_is_taken(tmp_path):
    (tmp_path / "mat").mkdir()
    assert load_material(save_material(material_of(), tmp_path / "mat")).name == "lambert"


@pytest.mark.parametrize("name", ["notes.txt", "normal_old.png", ".hidden", "thesis"])
def test_a_material_with_a_file_of_the_users_is_left_alone(folder, name):
    (folder / name).write_text("mine", encoding="utf-8")
    before = snapshot(folder)
    with pytest.raises(DataError, match="a material folder and nothing else") as error:
        save_material(material_of(seed=1), folder)
    assert name in str(error.value) and snapshot(folder) == before
    assert len(list(folder.parent.iterdir())) == 1


@pytest.mark.parametrize("manifest", [
    "mine", "{}", "[]", '{"format": "other", "textures": []}', '{"format": "torchmat-material"}',
    '{"format": "torchmat-material", "textures": [3]}',
])
def test_a_folder_with_another_manifest_is_left_alone(tmp_path, manifest):
    (tmp_path / "mat").mkdir()
    (tmp_path / "mat" / "manifest.json").write_text(manifest, encoding="utf-8")
    with pytest.raises(DataError, match="must be empty or a material folder"):
        save_material(material_of(), tmp_path / "mat")
    assert (tmp_path / "mat" / "manifest.json").read_text("utf-8") == manifest


def test_a_target_that_is_a_file(tmp_path):
    (tmp_path / "mat").write_text("mine", encoding="utf-8")
    with pytest.raises(DataError, match=r"mat: the target must be a folder; it is a file"):
        save_material(material_of(), tmp_path / "mat")
    assert (tmp_path / "mat").read_text("utf-8") == "mine"


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), DataError("normal.png: full")], ids=["os", "data"])
@pytest.mark.parametrize("call", [1, 2])
def test_a_failing_write_leaves_the_old_and_no_rest(folder, monkeypatch, call, error):
    before, calls = snapshot(folder), []

    def failing(path, pixels):
        calls.append(path)
        if len(calls) == call:
            raise error
        write_image(path, pixels)

    monkeypatch.setattr(folder_module, "write_image", failing)
    with pytest.raises(DataError):
        save_material(material_of(seed=1), folder)
    assert len(calls) == call and snapshot(folder) == before and len(list(folder.parent.iterdir())) == 1


def test_failing_companions_leave_the_old_and_no_rest(folder):
    before = snapshot(folder)

    def companions(building):
        (building / "report.json").write_text("{}", encoding="utf-8")
        raise RuntimeError("plot failed")

    with pytest.raises(RuntimeError, match="plot failed"):
        save_material(material_of(seed=1), folder, companions=companions)
    assert snapshot(folder) == before and len(list(folder.parent.iterdir())) == 1
