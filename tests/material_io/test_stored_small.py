"""The material folder of maps that are stored small: version, textures, numbers, and what may be painted."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch
from tests.models.examples import CASES, make

from torchmat import DataError, load_material, save_material
from torchmat.errors import Notice
from torchmat.images import read_image, write_image
from torchmat.material_io import pack, unpack
from torchmat.models import Texture
from torchmat.models.storage import StoredAs


def material_of(name, options, storage="png8", tiles=True):
    return make(name, options, 6, 8, dtype=torch.float32, storage=storage, tiles=tiles)


def texture(storage="png8"):
    random = torch.Generator().manual_seed(1)
    return Texture({"albedo": 0.1 + 0.8 * torch.rand(3, 8, 8, generator=random)}, storage=storage)


def manifest_of(folder):
    return json.loads((folder / "manifest.json").read_text("utf-8"))


@pytest.mark.parametrize("storage", ["half", "png8", "tiff16"])
@pytest.mark.parametrize(("name", "options"), CASES)
def test_what_is_loaded_is_what_export_promised(name, options, storage, tmp_path):
    material = material_of(name, options, storage, tiles=storage != "half")
    ways = [StoredAs((3, 4)), StoredAs((1, 1)), StoredAs((2, 8), "png16"), StoredAs(None, "png8")]
    specs = [spec for spec in material.specs() if spec.per_texel and not spec.constant]
    small = material.stored_at({spec.name: ways[place % 4] for place, spec in enumerate(specs)})
    folder = save_material(small, tmp_path / "out")
    promised, loaded = small.as_exported(), load_material(folder)
    assert loaded.stored == small.stored and loaded.options == small.options and loaded.size == small.size
    for key, value in promised.maps.items():
        assert torch.equal(loaded.maps[key], value), key
    assert (loaded.bytes_per_texel, loaded.shared_bytes) == (small.bytes_per_texel, small.shared_bytes)
    entries = manifest_of(folder)["textures"]
    written = sum(read_image(folder / entry["file"]).nbytes for entry in entries if entry["per_texel"])
    assert written == pytest.approx(small.bytes_per_texel * small.texels)
    assert {path.name for path in folder.iterdir()} == {"manifest.json", *(entry["file"] for entry in entries)}


def test_the_version_says_whether_a_reader_must_know_of_sizes(tmp_path):
    plain, deep, small = (
        texture().stored_at({"albedo": stored}) for stored in (None, StoredAs(storage="png16"), StoredAs((2, 2)))
    )
    for number, (material, version) in enumerate(((plain, 1), (deep, 1), (small, 2))):
        folder = save_material(material, tmp_path / str(number))
        assert manifest_of(folder)["version"] == version
        assert load_material(folder).stored == material.stored
    assert "stored" not in manifest_of(tmp_path / "0")


def test_a_constant_map_is_numbers_that_can_be_edited(tmp_path):
    folder = save_material(texture().stored_at({"albedo": StoredAs((1, 1))}), tmp_path / "out")
    assert [path.name for path in folder.iterdir()] == ["manifest.json"]
    manifest = manifest_of(folder)
    mean = texture().maps["albedo"].mean(dim=(1, 2))
    assert manifest["constants"]["albedo"] == pytest.approx(mean.tolist(), rel=1e-6)
    manifest["constants"]["albedo"] = [0.25, 0.5, 1.0]
    (folder / "manifest.json").write_text(json.dumps(manifest), "utf-8")
    loaded = load_material(folder)
    assert loaded.size == (8, 8)
    assert torch.equal(loaded.maps["albedo"], torch.tensor([0.25, 0.5, 1.0])[:, None, None].expand(3, 8, 8))


@pytest.mark.parametrize("values", [[0.5], [0.5, 0.5, -1.0], [0.5, 0.5, "red"], 3])
def test_numbers_that_cannot_be(values, tmp_path):
    folder = save_material(texture().stored_at({"albedo": StoredAs((1, 1))}), tmp_path / "out")
    manifest = manifest_of(folder)
    manifest["constants"]["albedo"] = values
    (folder / "manifest.json").write_text(json.dumps(manifest), "utf-8")
    with pytest.raises(DataError, match=r"manifest\.json"):
        load_material(folder)


def test_a_small_texture_may_be_painted_in_its_size(tmp_path):
    folder = save_material(texture().stored_at({"albedo": StoredAs((4, 4))}), tmp_path / "out")
    write_image(folder / "albedo.png", np.full((4, 4, 3), 255, np.uint8))
    loaded = load_material(folder)
    assert loaded.stored == {"albedo": StoredAs((4, 4))}
    high = torch.tensor(manifest_of(folder)["textures"][0]["high"])[:, None, None]
    assert torch.equal(loaded.maps["albedo"], high.expand(3, 8, 8).float())


def test_a_small_texture_may_be_painted_in_full_size_and_keeps_it(tmp_path):
    folder = save_material(texture().stored_at({"albedo": StoredAs((4, 4), "png8")}), tmp_path / "out")
    pixels = np.random.default_rng(0).integers(0, 256, (8, 8, 3)).astype(np.uint8)
    write_image(folder / "albedo.png", pixels)
    loaded = load_material(folder)
    assert loaded.stored == {"albedo": StoredAs(None, "png8")}
    again = load_material(save_material(loaded, tmp_path / "again"))
    assert manifest_of(tmp_path / "again")["version"] == 1
    assert np.array_equal(np.unique(pixels), np.unique(read_image(folder / "albedo.png")))
    assert float((again.maps["albedo"] - loaded.maps["albedo"]).detach().abs().max()) < 0.01


def test_one_layer_painted_in_full_size(tmp_path):
    material = material_of("ptm", {}).stored_at({"polynomial": StoredAs((3, 4))})
    folder = save_material(material, tmp_path / "out")
    write_image(folder / "polynomial_lx.png", np.zeros((6, 8, 3), np.uint8))
    loaded = load_material(folder)
    assert loaded.stored == {}
    assert torch.equal(loaded.maps["polynomial"][15:], material.as_exported().maps["polynomial"][15:])


@pytest.mark.parametrize("size", [(5, 5), (16, 16), (8, 4)])
def test_other_sizes_are_brought_to_the_full_one(size, tmp_path):
    folder = save_material(texture().stored_at({"albedo": StoredAs((4, 4))}), tmp_path / "out")
    write_image(folder / "albedo.png", np.full((*size, 3), 255, np.uint8))
    with pytest.warns(Notice, match=rf"albedo\.png: it is {size[0]} x {size[1]}, and was resampled to 8 x 8"):
        loaded = load_material(folder)
    assert loaded.stored == {} and loaded.maps["albedo"].shape == (3, 8, 8)
    high = manifest_of(folder)["textures"][0]["high"][0]
    assert float((loaded.maps["albedo"].detach() - high).abs().max()) < 1e-6


@pytest.mark.parametrize("change", [
    {"albedo": {"size": [9, 9], "storage": None}}, {"albedo": {"size": None, "storage": "jpeg"}}, {"albedo": 3},
    {"albino": {"size": [2, 2], "storage": None}}, {"albedo": {"size": ["a", 2], "storage": None}}, 5,
])
def test_a_tampered_entry_is_refused(change, tmp_path):
    folder = save_material(texture().stored_at({"albedo": StoredAs((4, 4))}), tmp_path / "out")
    manifest = manifest_of(folder)
    manifest["stored"] = change
    (folder / "manifest.json").write_text(json.dumps(manifest), "utf-8")
    with pytest.raises(DataError, match=str(folder)):
        load_material(folder)


def test_packing_takes_the_maps_in_full_size(tmp_path):
    material = material_of("distribution", {"lobes": 1, "parts": ["specular_mask", "fresnel"]})
    small = material.stored_at({"diffuse": StoredAs((3, 4)), "fresnel": StoredAs((1, 1))})
    for one, name in ((material, "a"), (small, "b")):
        pack(one, tmp_path / name)
    plain, packed = unpack(tmp_path / "a"), unpack(tmp_path / "b")
    assert packed.stored == {}
    assert all(torch.equal(value, packed.maps[key]) for key, value in plain.maps.items())
