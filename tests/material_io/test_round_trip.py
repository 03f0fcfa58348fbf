"""The material folder: what is written comes back to the bit, and a painted texture arrives."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch
from tests.models.examples import CASES, directions, make, per_image
from tests.support import assert_close

from torchmat import DataError, RangeError, load_material, save_material
from torchmat.images import read_image, write_image
from torchmat.models import MATERIALS
from torchmat.models.storage import STORAGES

LIGHT, VIEW = (per_image(directions(6, torch.float32, seed)) for seed in (1, 2))


def material_of(name, options, storage="half", size=(5, 7)):
    return make(name, options, *size, dtype=torch.float32, storage=storage, tiles=False)


@pytest.mark.parametrize("storage", STORAGES)
@pytest.mark.parametrize(("name", "options"), CASES)
def test_what_is_loaded_is_what_export_promised(name, options, storage, tmp_path):
    material = material_of(name, options, storage)
    promised = material.as_exported()
    loaded = load_material(save_material(material, tmp_path / "out"))
    assert type(loaded) is MATERIALS[name]
    assert loaded.options == material.options and loaded.storage == storage and loaded.tiles is False
    assert set(loaded.maps) == set(promised.maps)
    for key, value in promised.maps.items():
        assert loaded.maps[key].dtype == torch.float32
        assert torch.equal(loaded.maps[key], value), key
    with torch.no_grad():
        assert torch.equal(loaded.shade(LIGHT, VIEW), promised.shade(LIGHT, VIEW))


@pytest.mark.parametrize(("name", "options"), CASES)
def test_a_second_round_trip_changes_nothing_in_float(name, options, tmp_path):
    material = material_of(name, options, "float")
    loaded = load_material(save_material(material, tmp_path / "out"))
    for key, value in material.maps.items():
        assert torch.equal(loaded.maps[key], value), key


@pytest.mark.parametrize("storage", STORAGES)
def test_codes_lose_at_most_half_a_step(storage, tmp_path):
    material = material_of("ptm", {}, storage)
    loaded = load_material(save_material(material, tmp_path / "out"))
    value = material.maps["polynomial"].detach()
    span = (value.amax(dim=(1, 2)) - value.amin(dim=(1, 2)))[:, None, None]
    if STORAGES[storage].natural:  # as far below 0 as above, one range for the channels of a texture
        span = 2 * value.abs().amax(dim=(1, 2)).unflatten(0, (-1, 3)).amax(dim=1).repeat_interleave(3)[:, None, None]
    levels = STORAGES[storage].levels
    bound = 0.501 * span / levels if levels else value.abs() * 2.0 ** (-11 if storage == "half" else -24)
    assert bool(((loaded.maps["polynomial"].detach() - value).abs() <= bound + 1e-7).all())


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (9, 1), (3, 129)])
def test_odd_sizes(size, tmp_path):
    material = material_of("hsh", {"terms": 4}, "png16", size)
    assert load_material(save_material(material, tmp_path / "out")).size == size


def test_the_manifest_says_what_is_there(tmp_path):
    material = material_of("phong_srf", {"residual": "half", "base": "phong"}, "png8")
    folder = save_material(material, tmp_path / "out", {"seed": 3, "source": "Stoff grün"})
    manifest = json.loads((folder / "manifest.json").read_text("utf-8"))
    assert (manifest["format"], manifest["version"], manifest["model"]) == ("torchmat-material", 1, "phong_srf")
    assert manifest["options"] == {"residual": "half", "base": "phong"} and manifest["storage"] == "png8"
    assert (manifest["height"], manifest["width"]) == (5, 7)
    assert manifest["provenance"] == {"seed": 3, "source": "Stoff grün"}
    assert manifest["constants"]["lobe"] == material.maps["lobe"].tolist()
    assert manifest["bytes_per_texel"] == 9
    files = {path.name for path in folder.iterdir()} - {"manifest.json"}
    assert files == {"residual_hx.png", "residual_hy.png", "residual_hz.png"}
    for entry in manifest["textures"]:
        assert entry["file"] in files and (entry["height"], entry["width"], entry["channels"]) == (5, 7, 3)
        assert entry["type"] == "uint8" and len(entry["low"]) == len(entry["high"]) == 3
        assert read_image(folder / entry["file"]).dtype == np.uint8
    assert {"frame", "value", "codes"} <= set(manifest["conventions"])


def test_the_bytes_per_texel_are_those_of_the_pixels_written(tmp_path):
    for name, options in (("ptm", {}), ("lambert", {}), ("local_pca", {"clusters": 3, "components": 2})):
        for storage in STORAGES:
            material = material_of(name, options, storage)
            folder = save_material(material, tmp_path / f"{name} {storage}")
            entries = json.loads((folder / "manifest.json").read_text("utf-8"))["textures"]
            written = sum(read_image(folder / entry["file"]).nbytes for entry in entries if entry["per_texel"])
            assert written == material.bytes_per_texel * material.texels


def painted(folder, file, change):
    pixels = change(read_image(folder / file).copy())
    write_image(folder / file, pixels)


def test_a_painted_value_arrives(tmp_path):
    folder = save_material(material_of("texture", {}, "png8"), tmp_path / "out")
    before = load_material(folder).maps["albedo"].detach()
    entry = json.loads((folder / "manifest.json").read_text("utf-8"))["textures"][0]

    def change(pixels):
        pixels[2, 3] = (255, 0, 128)
        return pixels

    painted(folder, "albedo.png", change)
    after = load_material(folder).maps["albedo"].detach()
    code = 128 / 255
    grey = ((code + 0.055) / 1.055) ** 2.4  # IEC 61966-2-1
    expected = torch.tensor([entry["high"][0], 0.0, entry["high"][2] * grey])
    assert_close(after[:, 2, 3], expected, 1e-6)
    after[:, 2, 3] = before[:, 2, 3]
    assert torch.equal(after, before)


def test_a_16_bit_picture_may_replace_an_8_bit_one(tmp_path):
    folder = save_material(material_of("lambert", {}, "png8"), tmp_path / "out")
    before = load_material(folder)
    painted(folder, "normal.png", lambda pixels: pixels.astype(np.uint16) * 257)
    assert torch.equal(load_material(folder).maps["normal"], before.maps["normal"])


def with_alpha(pixels, value):
    full = np.iinfo(pixels.dtype).max if pixels.dtype.kind == "u" else 1
    return np.concatenate((pixels, np.full_like(pixels[:, :, :1], full * value)), axis=2)


@pytest.mark.parametrize("storage", ["png8", "png16", "tiff8", "half"])
def test_an_opaque_alpha_is_dropped_and_a_clear_one_refused(storage, tmp_path):
    folder = save_material(material_of("texture", {}, storage), tmp_path / "out")
    before = load_material(folder)
    file = f"albedo{STORAGES[storage].suffix}"
    painted(folder, file, lambda pixels: with_alpha(pixels, 1))
    assert torch.equal(load_material(folder).maps["albedo"], before.maps["albedo"])
    painted(folder, file, lambda pixels: with_alpha(pixels[:, :, :3], 0))
    with pytest.raises(DataError, match=rf"{file}: alpha must be opaque; 35 of 35 texels are not.*Flatten"):
        load_material(folder)


def test_a_byte_order_mark_from_an_editor_does_no_harm(tmp_path):
    folder = save_material(material_of("texture", {}), tmp_path / "out")
    path = folder / "manifest.json"
    path.write_text(path.read_text("utf-8").replace("\n", "\r\n"), encoding="utf-8-sig", newline="")
    assert load_material(folder).name == "texture"


@pytest.mark.parametrize("name", ["with spaces", "grün-мох-苔", "a [v2]*", "dot.ted"])
def test_names(name, tmp_path):
    material = material_of("texture", {}, "png8")
    for _ in range(2):
        loaded = load_material(save_material(material, tmp_path / name))
    assert torch.equal(loaded.maps["albedo"], material.as_exported().maps["albedo"])
    assert len(list(tmp_path.iterdir())) == 1


def test_a_map_outside_its_range_is_refused_and_nothing_written(tmp_path):
    material = material_of("lambert", {}, "png8")
    material.maps["normal"].data[0, 1, 1] = 1.5
    with pytest.raises(RangeError, match=r"normal must lie in \[-1.0, 1.0\]; 1 of 105 values are not, the first is 1.5"):
        save_material(material, tmp_path / "out")
    with pytest.raises(RangeError, match="normal"):
        material.as_exported()
    assert not list(tmp_path.iterdir())


def test_what_a_half_cannot_hold_is_refused(tmp_path):
    material = material_of("ptm", {}, "half")
    material.maps["polynomial"].data[0, 0, 0] = 7e4
    with pytest.raises(RangeError, match=r"polynomial must fit .*70000.*float"):
        save_material(material, tmp_path / "out")
    assert not list(tmp_path.iterdir())
    loaded = load_material(save_material(material.stored_as("float"), tmp_path / "out"))
    assert float(loaded.maps["polynomial"].detach().max()) == 7e4
