"""Planes in Deep Zoom tiles and textures in tiles with levels: sizes, overlap, levels and values, read back by hand."""

from __future__ import annotations

import math
import shutil
import xml.etree.ElementTree as tree

import numpy as np
import OpenImageIO as oiio
import pytest
import torch

import torchmat as tm
from torchmat import DataError, RangeError
from torchmat.images import read_image
from torchmat.material_io.rti.deep_zoom import OVERLAP, TILE, halved, level_count, levels, read_deep_zoom, write_deep_zoom
from torchmat.models import Ptm

HEIGHT, WIDTH = 300, 517


@pytest.fixture(scope="module")
def picture():
    return np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)


@pytest.fixture(scope="module")
def zoom(picture, tmp_path_factory):
    path = tmp_path_factory.mktemp("zoom") / "plane_0.dzi"
    return path, write_deep_zoom(path, picture, "png")


def asked_by_openlime(path):
    """Return the tiles that OpenLIME's layout "deepzoom" asks for, of a .dzi: its levels are counted from the one tile on."""
    root = tree.parse(path).getroot()
    size = root.find("{http://schemas.microsoft.com/deepzoom/2008}Size")
    width, height, tile = int(size.get("Width")), int(size.get("Height")), int(root.get("TileSize"))
    levels = math.ceil(math.log(max(width, height) / tile) / math.log(2)) + 1
    for level in reversed(range(levels)):
        for row in range(math.ceil(height / tile)):
            for column in range(math.ceil(width / tile)):
                yield level, path.with_name(f"{path.stem}_files") / str(level) / f"{column}_{row}.{root.get('Format')}"
        width, height = width // 2, height // 2


def test_levels_halve_to_one_tile(picture):
    assert [level_count(*size) for size in ((1, 1), (254, 254), (254, 255), (300, 517), (3000, 4000), (8128, 1))] == [1, 1, 2, 3, 5, 6]
    assert [level_count(*size, 1) for size in ((1, 1), (1, 2), (2, 3), (300, 517), (3000, 4000), (4096, 1))] == [1, 2, 3, 11, 13, 13]
    assert [level.shape[:2] for level in levels(picture)] == [(300, 517), (150, 259), (75, 130)]
    small = np.array([[[0], [10], [7]], [[20], [31], [8]]], np.uint8)
    assert halved(small)[:, :, 0].tolist() == [[15, 8]]  # 61 / 4 and, the last column twice, 30 / 4
    assert halved(small[:1])[:, :, 0].tolist() == [[5, 7]]


def test_openlime_finds_what_it_asks_for(picture, zoom):
    path, files = zoom
    asked = list(asked_by_openlime(path))
    assert {file for _, file in asked} <= set(files) and len(asked) == 6 + 2 + 1
    assert read_image(asked[0][1]).shape == (TILE + OVERLAP, TILE + OVERLAP, 3) and asked[0][0] == 2  # not a picture of a few pixels
    assert read_image(asked[-1][1]).shape == (75, 130, 3) and asked[-1][0] == 0


def test_levels_down_to_one_pixel_are_read_too(picture, zoom, tmp_path):
    path = zoom[0]
    shutil.copy(path, tmp_path)
    for level in range(3):
        shutil.copytree(path.with_name("plane_0_files") / str(level), tmp_path / "plane_0_files" / str(level + 8))
    for level in range(8):
        (tmp_path / "plane_0_files" / str(level)).mkdir()
    assert np.array_equal(read_deep_zoom(tmp_path / path.name), picture)


def test_tiles_have_their_place_size_and_overlap(picture, zoom):
    path, files = zoom
    assert path in files and all(file.is_file() for file in files)
    finest = path.with_name("plane_0_files") / "2"
    assert sorted(file.name for file in finest.iterdir()) == ["0_0.png", "0_1.png", "1_0.png", "1_1.png", "2_0.png", "2_1.png"]
    for column, row in ((0, 0), (1, 0), (2, 1)):
        top, left = max(0, row * TILE - OVERLAP), max(0, column * TILE - OVERLAP)
        bottom, right = min(HEIGHT, (row + 1) * TILE + OVERLAP), min(WIDTH, (column + 1) * TILE + OVERLAP)
        assert np.array_equal(read_image(finest / f"{column}_{row}.png"), picture[top:bottom, left:right])
    assert np.array_equal(read_image(path.with_name("plane_0_files") / "1" / "0_0.png"), halved(picture)[:, : TILE + OVERLAP])
    text = path.read_text()
    for part in ('TileSize="254"', 'Overlap="1"', 'Format="png"', f'Width="{WIDTH}"', f'Height="{HEIGHT}"', "schemas.microsoft.com/deepzoom/2008"):
        assert part in text
    assert np.array_equal(read_deep_zoom(path), picture)


@pytest.mark.parametrize(
    "text, word",
    [("<Image", "Deep Zoom description"), ("<Image xmlns='http://schemas.microsoft.com/deepzoom/2008'/>", "state size"), ("<!DOCTYPE x>", "state size")],
)
def test_a_damaged_description_is_named(tmp_path, text, word):
    path = tmp_path / "plane_0.dzi"
    path.write_text(text)
    with pytest.raises(DataError, match=f"plane_0.dzi: .*{word}"):
        read_deep_zoom(path)


def material(storage="half"):
    values = torch.rand(18, 40, 300, generator=torch.Generator().manual_seed(1)) - 0.3
    return Ptm({"polynomial": values}, space="srgb", storage=storage)


def test_relight_in_tiles_holds_what_it_holds_in_planes(tmp_path):
    whole, tiles = tmp_path / "whole", tmp_path / "tiles"
    tm.export(material(), whole, "relight", image="png", layout="image")
    losses = tm.export(material(), tiles, "relight", image="png", layout="deepzoom")
    assert (tiles / "plane_5.dzi").is_file() and not (tiles / "plane_0.png").exists() and "polynomial" not in losses.lost
    assert (whole / "info.json").read_text() == (tiles / "info.json").read_text()
    for name, value in tm.load_material(whole).maps.items():
        assert torch.equal(tm.load_material(tiles).maps[name], value)
    (tiles / "plane_2_files" / "1" / "1_0.png").unlink()
    with pytest.raises(DataError, match="1_0.png: the tile must exist"):
        tm.load_material(tiles)
    with pytest.raises(RangeError, match="layout"):
        tm.export(material(), tmp_path / "none", "relight", layout="tiles")


@pytest.mark.parametrize("storage, image, suffix", [("half", "auto", ".exr"), ("png8", "auto", ".tif"), ("png16", "exr", ".exr")])
def test_textures_are_tiled_with_all_levels(tmp_path, storage, image, suffix):
    folder = tmp_path / "m"
    tm.export(material(storage), folder, "tiled", image=image, tile=32)
    names = sorted(path.name for path in folder.glob(f"*{suffix}"))
    assert len(names) == 6
    source = oiio.ImageInput.open(str(folder / names[0]))
    level, sizes, found = 0, [], []
    while source.seek_subimage(0, level):
        spec = source.spec()
        assert (spec.tile_width, spec.tile_height) == (32, 32)
        sizes.append((spec.height, spec.width))
        found.append(source.read_image(0, level, 0, 3, oiio.FLOAT))
        level += 1
    source.close()
    assert sizes[:3] == [(40, 300), (20, 150), (10, 75)] and sizes[-1] == (1, 1)
    mean = found[0].reshape(20, 2, 150, 2, 3).mean(axis=(1, 3))
    assert np.abs(found[1] - mean).max() < 2 / 255
    form = {"half": "half", "png8": "tiff8", "png16": "half"}[storage]
    wanted = material().stored_as(form).as_exported().maps["polynomial"]
    assert torch.equal(tm.load_material(folder).maps["polynomial"], wanted)


def test_tiles_are_of_whole_blocks(tmp_path):
    with pytest.raises(RangeError, match="multiple of 16"):
        tm.export(material(), tmp_path / "m", "tiled", tile=20)
