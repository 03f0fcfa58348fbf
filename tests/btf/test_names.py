"""Directions in file names: Bonn 2003, UTIA and ATRIUM; which kind a folder is of."""

from __future__ import annotations

import pytest
import torch
from tests.btf.files import ANGLES, directions_of, either_way, get_image, put_image, put_manifest, random_codes, srgb_decoded
from tests.support import assert_close

from torchmat import DataError, load_btf


def put_named(folder, pattern: str, dtype: str = "uint8"):
    for seed, angles in enumerate(ANGLES):
        put_image(folder / pattern.format(seed, *angles), random_codes(seed, dtype=dtype))
    return folder


@either_way
@pytest.mark.parametrize(
    "pattern, kind, dtype",
    [
        ("{:05d} tl{:03d} pl{:03d} tv{:03d} pv{:03d}.png", "ubo2003", "uint8"),
        ("tv{3:03d} pv{4:03d}/{0:05d} TL{1:03d} PL{2:03d} TV{3:03d} PV{4:03d}.PNG", "ubo2003", "uint8"),
        ("tl{1:03d}_pl{2:03d}_tv{3:03d}_pv{4:03d}.png", "utia", "uint16"),
        ("fabric01_tl{1:03d}_pl{2:03d}_tv{3:03d}_pv{4:03d}.exr", "utia", "float16"),
    ],
)
def test_names(tmp_path, pack, pattern, kind, dtype):
    btf = load_btf(pack(put_named(tmp_path / "cloth", pattern, dtype)))
    assert (btf.source.kind, len(btf), btf.stored_dtype) == (kind, 4, dtype)
    order = sorted(range(4), key=lambda n: pattern.format(n, *ANGLES[n]))
    for sample, number in enumerate(order):
        light_polar, light_azimuth, view_polar, view_azimuth = ANGLES[number]
        assert_close(btf.light[sample], directions_of(light_polar, light_azimuth), 1e-6)
        assert_close(btf.view[sample], directions_of(view_polar, view_azimuth), 1e-6)
        codes = random_codes(number, dtype=dtype)
        values = codes if dtype == "float16" else srgb_decoded(codes / (255 if dtype == "uint8" else 65535))
        assert_close(btf.image(sample), torch.from_numpy(values.astype("float64")).permute(2, 0, 1), 1e-6)


def test_jpeg(tmp_path):
    path = put_image(tmp_path / "cloth" / "00000 tl000 pl000 tv000 pv000.jpg", random_codes(0, (16, 8, 3)))
    btf = load_btf(tmp_path / "cloth")
    assert_close(btf.image(0).permute(1, 2, 0), srgb_decoded(get_image(path) / 255), 1e-6)


def test_files_that_are_no_images_do_not_matter(tmp_path):
    folder = put_named(tmp_path / "cloth", "{} tl{:03d} pl{:03d} tv{:03d} pv{:03d}.png")
    (folder / "readme.txt").write_text("measured 2003")
    (folder / ".hidden tl000.png").write_text("no image")
    (folder / "__MACOSX").mkdir()
    (folder / "__MACOSX" / "0 tl000 pl000 tv000 pv000.png").write_text("no image")
    (folder / ".thumbs").mkdir()
    (folder / ".thumbs" / "small.png").write_text("no image")
    assert len(load_btf(folder)) == 4


def test_a_manifest_comes_before_names(tmp_path):
    names = [f"tl{number:03d}_pl000_tv000_pv000.png" for number in range(4)]
    for name in names:
        put_image(tmp_path / "d" / name, random_codes(0))
    put_manifest(tmp_path / "d", names)
    assert load_btf(tmp_path / "d").source.kind == "manifest"
    assert load_btf(tmp_path / "d", kind="utia").light[3].tolist() == pytest.approx(directions_of(3, 0))
    assert load_btf(tmp_path / "d", "ubo2003").source.kind == "ubo2003"


def test_a_light_on_the_horizon_is_legal(tmp_path):
    put_image(tmp_path / "d" / "tl090_pl360_tv089_pv000.png", random_codes(0))
    assert load_btf(tmp_path / "d").light[0].tolist() == pytest.approx([1, 0, 0], abs=1e-7)


@pytest.mark.parametrize(
    "name, text",
    [
        ("tl000_pl000_tv000.png", "1 of 2 image files do not, first 'tl000_pl000_tv000.png'. Rename those files"),
        ("preview.jpg", "first 'preview.jpg'. Rename those files or move them out"),
        ("tl000_pl000_tv000_pv0000.png", "first 'tl000_pl000_tv000_pv0000.png'"),
        ("tl091_pl000_tv000_pv000.png", "tv000_pv000.png: polar angles must be 0 to 90 degrees; light is at 91"),
        ("tl000_pl000_tv090_pv000.png", "tl000_pl000_tv090_pv000.png: polar angles.*the view must lie above"),
        ("tl010_pl361_tv000_pv000.png", "tl010_pl361_tv000_pv000.png: azimuths must be 0 to 360.*light is at 361"),
        ("copy_tl030_pl000_tv000_pv000.png", "d: tl030.*differ from every other's; it has those of copy_tl030"),
    ],
)
def test_refused(tmp_path, name, text):
    put_image(tmp_path / "d" / "tl030_pl000_tv000_pv000.png", random_codes(0))
    (tmp_path / "d" / name).write_text("never read")
    with pytest.raises(DataError, match=text):
        load_btf(tmp_path / "d", "utia")


def test_both_may_be_kept_when_measured_twice(tmp_path):
    for seed, name in enumerate(("a_tl030_pl000_tv000_pv000.png", "b_tl030_pl000_tv000_pv000.png")):
        put_image(tmp_path / "d" / name, random_codes(seed))
    with pytest.raises(DataError, match="b_tl030.*those of a_tl030.*duplicates='keep'"):
        load_btf(tmp_path / "d")
    btf = load_btf(tmp_path / "d", duplicates="keep")
    assert (len(btf), len(btf.lights)) == (2, 1)
    assert not torch.equal(btf.image(0), btf.image(1))


@pytest.mark.parametrize("kind", ["ubo2003", "utia", "manifest", "rti", None])
def test_an_empty_folder(tmp_path, kind):
    (tmp_path / "empty").mkdir()
    with pytest.raises(DataError, match=r"empty: .* must .*; .*\. [A-Z]"):
        load_btf(tmp_path / "empty", kind)


def test_images_without_directions(tmp_path):
    put_image(tmp_path / "d" / "a.png", random_codes(0))
    with pytest.raises(DataError, match="there are 1 files, 1 of them images. Add a manifest.csv with the"):
        load_btf(tmp_path / "d")
