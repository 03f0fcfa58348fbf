"""Real captures and path-traced references, where this machine has them: figures found without the package."""

from __future__ import annotations

import csv
import io
import re
import zipfile

import numpy as np
import pytest
import torch
from tests.btf.files import directions_of, get_image, srgb_decoded
from tests.support import assert_close, shared_path

from torchmat import load_btf

BONN = re.compile(r"tl(\d+) pl(\d+) tv(\d+) pv(\d+)")


def assert_bonn_directions(btf, sample: int) -> None:
    light_polar, light_azimuth, view_polar, view_azimuth = map(int, BONN.search(btf.source.files[sample]).groups())
    assert_close(btf.light[sample], directions_of(light_polar, light_azimuth), 1e-6)
    assert_close(btf.view[sample], directions_of(view_polar, view_azimuth), 1e-6)


def test_bonn_wallpaper():
    folder = shared_path("real/ubo2003_wallpaper")
    btf = load_btf(folder)
    assert (btf.source.kind, len(btf), len(btf.lights), len(btf.views)) == ("ubo2003", 81, 81, 1)
    assert (btf.height, btf.width, btf.stored_dtype, btf.encoding) == (256, 256, "uint8", "srgb")
    assert btf.clipped_share == btf.invalid_share == 0
    assert btf.value_range == pytest.approx((0, float(srgb_decoded(248 / 255))))  # 248 is the largest code of all files
    assert btf.source.files[40] == "03240 tl060 pl054 tv000 pv000.jpg"
    assert_close(btf.image(40)[:, 100, 200], srgb_decoded(np.array([93, 75, 55]) / 255), 1e-6)
    assert sum(direction[1].abs() < 1e-6 < direction[0] for direction in btf.lights) == 5  # 15 to 75 degrees at pl000
    for sample in (0, 17, 40, 80):
        assert_bonn_directions(btf, sample)
        codes = get_image(folder / btf.source.files[sample])
        assert_close(btf.image(sample), srgb_decoded(codes.transpose(2, 0, 1) / 255), 1e-6)


def test_rti_capture():
    folder = shared_path("real/loewenkopf_rti")
    btf = load_btf(folder)
    assert (btf.source.kind, len(btf), len(btf.lights), len(btf.views)) == ("rti", 240, 240, 1)
    assert (btf.height, btf.width) == (43, 64)
    assert btf.clipped_share == pytest.approx(18 / (240 * 43 * 64))  # 18 texels with a 255, counted in the files
    assert btf.value_range == (0, 1)
    assert_close(btf.light[0], [-0.0019356994, -0.14720464, 0.98910415], 1e-6)
    assert_close(btf.light[239], [0.5131325, -0.8559397, 0.06373645], 1e-6)
    lowest = torch.rad2deg(torch.acos(btf.light[:, 2].double().min())).item()
    assert lowest == pytest.approx(88.7, abs=0.05)
    assert btf.source.files[239] == "jpg/Loewenkopf_klein_0240.jpg"
    codes = get_image(folder / "jpg" / "Loewenkopf_klein_0240.jpg")
    assert codes[20, 30].tolist() == [1, 1, 1]
    assert_close(btf.image(239), srgb_decoded(codes.transpose(2, 0, 1) / 255), 1e-6)


def test_path_traced_leather(tmp_path):
    path = shared_path("reference/leather.zip")
    btf = load_btf(path)
    assert (btf.source.kind, len(btf), len(btf.lights), len(btf.views)) == ("manifest", 2401, 49, 49)
    assert (btf.height, btf.width, btf.stored_dtype, btf.encoding) == (64, 64, "float16", "linear")
    assert btf.value_range == pytest.approx((-1.11e-5, 3.947), rel=2e-3)
    assert btf.clip_level == float("inf")
    with zipfile.ZipFile(path) as archive:
        rows = list(csv.DictReader(io.TextIOWrapper(archive.open("manifest.csv"), "utf-8")))
        assert btf.source.files == tuple(row["file"] for row in rows)
        for sample in (0, 1000, 2400):
            row = rows[sample]
            for which, directions in (("light", btf.light), ("view", btf.view)):
                angles = (float(row[f"{which}_polar_deg"]), float(row[f"{which}_azimuth_deg"]))
                assert_close(directions[sample], directions_of(*angles), 1e-6)
            codes = get_image(archive.extract(row["file"], tmp_path / "extracted"))
            assert torch.equal(btf.image(sample), torch.from_numpy(codes.astype(np.float32)).permute(2, 0, 1))
    assert_close(btf.image(1000)[:, 10, 20], [0.2118, 0.11145, 0.05554], 1e-3)


def test_weave_of_6561_images(tmp_path):
    path = shared_path("reference/weave_ubo2003.zip")
    btf = load_btf(path)
    assert (btf.source.kind, len(btf), len(btf.lights), len(btf.views)) == ("ubo2003", 6561, 81, 81)
    assert torch.equal(torch.bincount(btf.light_index * 81 + btf.view_index), torch.ones(6561, dtype=torch.long))
    assert btf.value_range == (0, 1)
    assert btf.clipped_share == pytest.approx(66650 / (6561 * 64 * 64))  # texels with a 255, counted in the files
    assert btf.source.files[3000] == "weave_ubo2003/tv060_pv000/00004 tl015 pl120 tv060 pv000.jpg"
    assert_close(btf.image(3000)[:, 10, 20], srgb_decoded(np.array([110, 84, 97]) / 255), 1e-6)
    with zipfile.ZipFile(path) as archive:
        for sample in (0, 3000, 6560):
            assert_bonn_directions(btf, sample)
            codes = get_image(archive.extract(btf.source.files[sample], tmp_path / "extracted"))
            assert_close(btf.image(sample), srgb_decoded(codes.transpose(2, 0, 1) / 255), 1e-6)
    again = load_btf(path)
    assert again.source.from_cache
    assert torch.equal(again.images([0, 6560]), btf.images([0, 6560]))
