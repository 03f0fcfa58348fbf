"""KTX 2.0: read back by a parser written from the specification, bit for bit, with all mips."""

from __future__ import annotations

import json
import struct

import numpy as np
import pytest
import torch
from tests.models.distributions import distribution
from tests.models.examples import make

import torchmat as tm
from torchmat import RangeError

FIELDS = ("format", "type_size", "width", "height", "depth", "layers", "faces", "levels", "compression")


def parsed(path):
    """Return the head, the keys, and the levels [layers, h, w, 4], the largest first, of a file of half floats."""
    data = path.read_bytes()
    assert data[:12] == bytes((0xAB, 0x4B, 0x54, 0x58, 0x20, 0x32, 0x30, 0xBB, 0x0D, 0x0A, 0x1A, 0x0A))
    head = dict(zip(FIELDS, struct.unpack("<9I", data[12:48]), strict=True))
    at, size, keys_at, keys_size, global_at, global_size = struct.unpack("<4I2Q", data[48:80])
    assert (head["format"], head["type_size"], head["depth"], head["faces"], head["compression"]) == (97, 2, 0, 1, 0)
    assert (global_at, global_size) == (0, 0)
    _check_description(data[at : at + size])
    levels, ends = [], []
    for level in range(head["levels"]):
        place, length, unpacked = struct.unpack("<3Q", data[80 + 24 * level : 104 + 24 * level])
        height, width = max(1, head["height"] >> level), max(1, head["width"] >> level)
        assert length == unpacked == max(1, head["layers"]) * height * width * 8 and place % 8 == 0
        levels.append(np.frombuffer(data[place : place + length], "<f2").reshape(-1, height, width, 4))
        ends.append((place, place + length))
    assert ends[0][1] == len(data) and ends == sorted(ends, reverse=True)  # the smallest stands first
    return head, _keys(data[keys_at : keys_at + keys_size]), levels


def _check_description(data):
    total, kind, version, size, model, _, transfer, flags = struct.unpack("<IIHHBBBB", data[:16])
    assert (total, kind, version, size, model, transfer, flags) == (len(data), 0, 2, len(data) - 4, 1, 1, 0)
    assert data[16:28] == bytes((0, 0, 0, 0, 8, 0, 0, 0, 0, 0, 0, 0))
    for number, channel in enumerate((0, 1, 2, 15)):
        offset, bits, what, place, low, high = struct.unpack("<HBBIII", data[28 + 16 * number : 44 + 16 * number])
        assert (offset, bits, what, place) == (16 * number, 15, 0xC0 + channel, 0)
        assert struct.unpack("<2f", struct.pack("<2I", low, high)) == (-1, 1)


def _keys(data):
    found, place = {}, 0
    while place < len(data):
        (length,) = struct.unpack("<I", data[place : place + 4])
        key, value = data[place + 4 : place + 4 + length].split(b"\0")[:2]
        found[key.decode()] = value.decode()
        place += 4 + length + -length % 4
    assert list(found) == sorted(found)
    return found


def test_layers_and_mips_come_back_bit_for_bit(tmp_path):
    material = make("ptm", {"space": "srgb"}, 5, 8, torch.float32)
    losses = tm.export(material, tmp_path / "m", "ktx2")
    head, keys, levels = parsed(tmp_path / "m" / "polynomial.ktx2")
    assert (head["width"], head["height"], head["layers"], head["levels"]) == (8, 5, 6, 4)
    assert keys["torchmat:layers"].split(",")[0] == "polynomial_lx_lx" and keys["KTXorientation"] == "rd"
    values = material.maps["polynomial"].detach().unflatten(0, (6, 3)).permute(0, 2, 3, 1)
    assert np.array_equal(levels[0][..., :3], values.half().numpy()) and (levels[0][..., 3] == 1).all()
    assert [level.shape[1:3] for level in levels] == [(5, 8), (2, 4), (1, 2), (1, 1)]
    mean = values[:, :, :2].mean(dim=(1, 2))  # 5 rows become 2 of three rows each, which share the middle one
    assert np.allclose(levels[1][:, 0, 0, :3], values[:, :3, :2].mean(dim=(1, 2)), atol=1e-3) and mean.shape == (6, 3)
    assert set(losses.approximated) == {"polynomial"} and losses.lost == {}


def test_every_map_and_number_has_its_place(tmp_path):
    material = distribution(4, 4, 2, ("normal", "rotation"), relief=True)
    losses = tm.export(material, tmp_path / "m", "ktx2")
    table = json.loads((tmp_path / "m" / "maps.json").read_text())
    described = {entry["map"]: entry for entry in table["maps"]}
    assert set(described) | set(table["constants"]) == set(material.maps.keys()) and losses.lost == {}
    for name, entry in described.items():
        head, _, levels = parsed(tmp_path / "m" / entry["file"])
        assert head["levels"] == entry["levels"] and max(1, head["layers"]) == max(len(entry["layers"]), len(levels[0]))
        shared = entry["channels"] <= 4
        assert not shared or np.array_equal(
            levels[0][..., : entry["channels"]],
            material.maps[name].detach().unflatten(0, (-1, entry["channels"])).permute(0, 2, 3, 1).half().numpy(),
        )


def test_what_no_half_holds_is_refused(tmp_path):
    material = tm.models.Texture({"albedo": torch.full((3, 2, 2), 1e6)})
    with pytest.raises(RangeError, match="export to ktx2: albedo must fit half floats; its largest magnitude is 1e"):
        tm.export(material, tmp_path / "m", "ktx2")
    assert not list(tmp_path.iterdir())
