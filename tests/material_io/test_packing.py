"""Packed textures: what is in which channel, the round trip within the declared quantum, folders that are refused."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
import torch
from tests.models.distributions import ALL_PARTS, distribution, shaded
from tests.models.examples import make
from tests.support import assert_close

from torchmat import DataError, RangeError, safe
from torchmat.images import read_image, write_image
from torchmat.material_io.packing import pack, packed, unpack

KINDS = {
    "everything": dict(lobes=4, parts=ALL_PARTS, relief=True),
    "flat": dict(lobes=2, parts=ALL_PARTS),
    "relief without normals": dict(lobes=1, parts=("specular_mask",), relief=True, tiles=False),
    "coloured mask": dict(lobes=1, parts=("specular_mask", "fresnel"), mask_channels=3),
    "coloured mask alone": dict(lobes=1, parts=("specular_mask",), mask_channels=3),
    "rotation alone": dict(lobes=1, parts=("rotation",)),
    "diffuse alone": dict(lobes=0, parts=()),
}
SIZES = [(1, 1), (1, 9), (5, 3), (8, 8)]


def angle_between(first, second):
    """Return degrees [H, W] between vectors [3, H, W]."""
    first, second = (safe.normalise(vector.detach().double()) for vector in (first, second))
    return torch.rad2deg(2 * torch.asin(((first - second).norm(dim=0) / 2).clamp(max=1)))


@pytest.mark.parametrize("depth", [8, 16])
@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("kind", KINDS)
def test_what_is_unpacked_is_what_packed_promised(kind, size, depth, tmp_path):
    material = distribution(*size, **KINDS[kind])
    promised, loaded = packed(material, depth), unpack(pack(material, tmp_path / "out", depth))
    assert loaded.options == promised.options and loaded.storage == material.storage and loaded.tiles == material.tiles
    assert set(loaded.maps) == set(promised.maps)
    assert all(torch.equal(loaded.maps[name], promised.maps[name]) for name in promised.maps)
    assert torch.equal(shaded(loaded), shaded(promised))


@pytest.mark.parametrize("depth", [8, 16])
@pytest.mark.parametrize("kind", KINDS)
def test_every_map_comes_back_within_its_quantum(kind, depth):
    material, levels = distribution(5, 7, **KINDS[kind]), 2**depth - 1
    found = packed(material, depth)
    for name in ("height", "specular_mask", "fresnel", "index", "tilt", "diffuse", "ambient"):
        if name not in material.maps:
            continue
        old, new = material.maps[name].detach(), found.maps[name].detach()
        colour = depth == 8 and len(old) == 3  # sRGB codes run from 0
        span = 1.0 if name in ("index", "tilt") else float(old.max() - (0 if colour else old.min()))
        # at its bright end the sRGB curve is 2.3 times as steep as a straight line
        steps = (65535 if name == "tilt" else levels) / (2.3 if colour else 1.0)
        assert float((new - old).abs().max()) <= 0.51 * span / steps + 1e-7, name
    if "specular" in material.maps:
        assert_close(found.maps["specular"], material.maps["specular"], 2.0**-11)
    if "rotation" in material.maps:
        turned = (found.maps["rotation"] - material.maps["rotation"]).detach().norm(dim=0)
        assert float(turned.max()) <= 1.01 * math.pi / levels + 1e-6
    whole = material.surface().maps, found.surface().maps
    if "normal" in whole[0]:
        # half a step of 2 / levels in each of three components
        bound = math.degrees(math.sqrt(3) / levels)
        assert float(angle_between(whole[0]["normal"], whole[1]["normal"]).max()) <= 1.05 * bound + 1e-3


def test_the_error_of_packing_falls_with_the_depth():
    material = distribution(6, 6, **KINDS["everything"])
    errors = [float((shaded(packed(material, depth)) - shaded(material)).abs().max()) for depth in (8, 16)]
    assert errors[1] < errors[0] / 10


def test_channels_by_hand(tmp_path):
    material = distribution(1, 2, 4, ("normal", "specular_mask", "fresnel", "rotation"), relief=True)
    flat = torch.tensor([0.0, 0.0, 1.0])[:, None, None].expand(3, 1, 2)
    turns = torch.tensor([[[0.0, -1.0]], [[1.0, 0.0]]])  # 90 and 180 degrees
    material = material.with_maps(
        normal=flat, rotation=turns, height=torch.tensor([[[0.01, 0.01]]]), fresnel=torch.tensor([[[0.0, 0.5]]]),
        specular_mask=torch.tensor([[[2.0, 4.0]]]),
    )
    folder = pack(material, tmp_path / "out")
    relief = read_image(folder / "normal_height.png")
    assert relief.shape == (1, 2, 4) and relief.dtype == np.uint8
    assert relief[0, 0].tolist() == [128, 128, 255, 0]  # alpha 0, and colours not multiplied by it
    lookup = read_image(folder / "rotation_mask_fresnel.png")
    assert lookup[0].tolist() == [[64, 0, 0], [128, 255, 255]]
    strip = read_image(folder / "specular_maps.exr")
    assert strip.shape == (24, 6, 3) and strip.dtype == np.float16
    second = material.maps["specular"][3:6].detach()
    assert np.array_equal(strip[6:12], second.permute(1, 2, 0).numpy().astype(np.float16))
    first, further = (read_image(folder / f"index_{number}.png") for number in (1, 2))
    assert first.shape == further.shape == (1, 2, 3) and not further[:, :, 1:].any()
    described = json.loads((folder / "packed.json").read_text("utf-8"))
    entries = {entry["file"]: entry for entry in described["textures"]}
    names = [(channel["channel"], channel["map"]) for channel in entries["rotation_mask_fresnel.png"]["channels"]]
    assert names == [("R", "rotation"), ("G", "specular_mask"), ("B", "fresnel")]
    mask = entries["rotation_mask_fresnel.png"]["channels"][1]
    assert (mask["low"], mask["high"], mask["transfer"]) == (2.0, 4.0, "linear")
    assert entries["diffuse.png"]["channels"][0]["transfer"] == "srgb"
    assert [channel["component"] for channel in entries["index_2.png"]["channels"]] == ["4", "", ""]


def test_absent_parts_cost_no_texture(tmp_path):
    folder = pack(distribution(3, 4, **KINDS["diffuse alone"]), tmp_path / "out")
    assert {path.name for path in folder.iterdir()} == {"packed.json", "diffuse.png"}
    folder = pack(distribution(3, 4, 1, ("tilt",)), tmp_path / "out")  # replaces the other
    assert {path.name for path in folder.iterdir()} == {"packed.json", "diffuse.png", "tilt.png", "specular_maps.exr"}
    assert read_image(folder / "tilt.png").shape == (1, 91, 1)


@pytest.mark.parametrize("depth", [8, 16])
def test_height_0_in_alpha_keeps_the_normal(depth, tmp_path):
    material = distribution(4, 4, 1, ("normal",), relief=True)
    lowest = int(material.maps["height"].argmin())
    loaded = unpack(pack(material, tmp_path / "out", depth))
    found, truth = (one.surface().maps["normal"].detach().flatten(1)[:, lowest] for one in (loaded, material))
    assert float((found - truth).norm()) < 2 / (2**depth - 1)


def test_a_foreign_folder_is_refused_and_left_alone(tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "diary.txt").write_text("mine")
    with pytest.raises(DataError, match="a packed material and nothing else; 1 of 1 files"):
        pack(distribution(), tmp_path / "out")
    assert (tmp_path / "out" / "diary.txt").read_text() == "mine"


def test_what_cannot_be_packed_leaves_the_old_folder(tmp_path):
    material = distribution(3, 4)
    folder = pack(material, tmp_path / "out")
    before = (folder / "diffuse.png").read_bytes()
    with pytest.raises(RangeError, match="specular must fit float16"):
        pack(material.with_maps(specular=torch.full((3, 6, 6), 1e6)), folder)
    assert (folder / "diffuse.png").read_bytes() == before
    assert not [path for path in tmp_path.iterdir() if "building" in path.name]
    with pytest.raises(RangeError, match="be a distribution material; it is ptm"):
        pack(make("ptm", {}, 2, 2), folder)
    with pytest.raises(RangeError, match="depth must be one of 8, 16"):
        pack(material, folder, 12)


def edit_description(folder, change):
    described = json.loads((folder / "packed.json").read_text("utf-8"))
    change(described)
    (folder / "packed.json").write_text(json.dumps(described), "utf-8")


def described(change):
    return lambda folder: edit_description(folder, change)


def first_channel(**values):
    return described(lambda d: d["textures"][0]["channels"][0].update(values))


def picture(name, *shape, kind=np.uint8, value=0):
    return lambda folder: write_image(folder / name, np.full(shape, value, kind))


def cut(folder):
    (folder / "diffuse.png").write_bytes((folder / "diffuse.png").read_bytes()[:60])


DAMAGES = {
    "no description": (lambda folder: (folder / "packed.json").unlink(), "packed.json: the description must exist"),
    "no texture": (lambda folder: (folder / "diffuse.png").unlink(), "diffuse.png: the texture must exist"),
    "not JSON": (lambda folder: (folder / "packed.json").write_text("{"), "be a packed material"),
    "not a table": (lambda folder: (folder / "packed.json").write_text("[]"), "be a packed material"),
    "other version": (described(lambda d: d.update(version=2)), "version must be 1; it is 2"),
    "other format": (described(lambda d: d.update(format="x")), "format must be"),
    "other model": (described(lambda d: d.update(model="ptm")), "model must be 'distribution'"),
    "unknown option": (described(lambda d: d["options"].update(lobs=1)), "Did you mean 'lobes'"),
    "options gone": (described(lambda d: d.pop("options")), "describe a packed material"),
    "a path": (described(lambda d: d["textures"][0].update(file="../x.png")), "a plain name"),
    "low gone": (described(lambda d: d["textures"][0]["channels"][0].pop("low")), "it has 2 low and 3 high"),
    "transfer": (first_channel(transfer="gamma"), "transfer of diffuse.png must be one of"),
    "two transfers": (first_channel(transfer="linear"), "have one transfer"),
    "unknown key": (first_channel(lo=0.0), "key 'lo'"),
    "a texture less": (described(lambda d: d["textures"].pop(0)), "diffuse is missing"),
    "size": (picture("diffuse.png", 3, 5, 3), "be 3 x 4 x 3 of uint8; it is 3 x 5 x 3"),
    "depth": (picture("diffuse.png", 3, 4, 3, kind=np.uint16), "of uint8; it is 3 x 4 x 3 of uint16"),
    "NaN": (picture("specular_maps.exr", 6, 6, 3, kind=np.float16, value=np.nan), "maps.exr: the texture must be finite"),
    "half a file": (cut, "diffuse.png: the image"),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_folders_are_named(damage, tmp_path):
    folder = pack(distribution(3, 4), tmp_path / "out")
    harm, text = DAMAGES[damage]
    harm(folder)
    with pytest.raises(DataError, match=text):
        unpack(folder)


def test_a_painted_texture_arrives(tmp_path):
    folder = pack(distribution(3, 4), tmp_path / "out")
    pixels = read_image(folder / "diffuse.png")
    pixels[:] = 0
    write_image(folder / "diffuse.png", pixels)
    assert not unpack(folder).maps["diffuse"].any()
