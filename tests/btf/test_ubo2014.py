"""UBO2014: what a file holds against plain loops, only what is asked for, and files that are refused by name."""

from __future__ import annotations

import shutil
import struct
import subprocess
import sys

import numpy as np
import pytest
import torch
from tests.btf.dfmf_files import DOUBLE, HALF, SINGLE, grid, plain, put_dfmf, put_large, put_small, some_images
from tests.fitting.reference_scene import relief_scene
from tests.support import assert_close

from torchmat import DataError, load_btf
from torchmat.btf import pixels, store
from torchmat.cli import main
from torchmat.fitting import recover_geometry

LIGHT, VIEW = grid(5, 3)


@pytest.fixture(autouse=True)
def no_cache(monkeypatch, tmp_path_factory):
    monkeypatch.setenv("TORCHMAT_CACHE", str(tmp_path_factory.mktemp("cache")))


def images_of(btf) -> torch.Tensor:
    return btf.images(range(len(btf)), torch.float64)


def vectors(angles: np.ndarray) -> torch.Tensor:
    polar, azimuth = angles.reshape(-1, 2).astype(np.float32).astype(float).T
    return torch.tensor(np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], axis=1))


@pytest.mark.parametrize("settings", [
    {"model": 0, "scalar": DOUBLE}, {"model": 0, "scalar": HALF, "components": 3}, {"model": 11, "scalar": SINGLE},
    {"model": 11, "scalar": HALF}, {"model": 12, "scalar": SINGLE}, {"model": 12, "by_images": True}, {"model": 11, "by_images": True, "components": 4},
    {"version": 1, "cosine": False}, {"version": 2}, {"version": 3},
], ids=str)
def test_it_holds_what_plain_loops_say(tmp_path, settings):
    path = put_small(tmp_path / "a.btf", **settings)
    btf = load_btf(path)
    wanted = torch.from_numpy(plain(path.read_bytes())).permute(0, 3, 1, 2)
    if not settings.get("cosine", True):
        wanted = wanted * torch.cos(torch.tensor(np.broadcast_to(LIGHT, (3, 5, 2))[..., 0].reshape(-1)))[:, None, None, None]
    assert_close(images_of(btf), wanted, 2e-5)
    assert (btf.source.kind, len(btf), btf.height, btf.width) == ("ubo2014", 15, 4, 6)


@pytest.mark.parametrize("model", [0, 11, 12])
def test_what_was_written_comes_back_in_its_place(tmp_path, model):
    btf = load_btf(put_small(tmp_path / "a.btf", model=model))
    # Green of YUV by the description's own rounded numbers.
    assert_close(images_of(btf), torch.from_numpy(some_images()).permute(0, 3, 1, 2), 3e-4 if model == 11 else 1e-6)
    assert_close(btf.light.double(), vectors(np.broadcast_to(LIGHT, (3, 5, 2))), 1e-6)
    assert_close(btf.view.double(), vectors(np.repeat(VIEW[:, None], 5, axis=1)), 1e-6)


def test_without_the_cosine_a_light_on_the_horizon_gives_nothing(tmp_path):
    light = np.array(LIGHT)
    light[:, 0, 0] = np.pi / 2
    images = images_of(load_btf(put_dfmf(tmp_path / "a.btf", some_images(), light, VIEW, put_settings(cosine=False))))
    assert float(images[::5].abs().max()) < 1e-6 and float(images[1::5].min()) > 0


def put_settings(**settings):
    from tests.btf.dfmf_files import Settings

    return Settings(**settings)


def test_a_crop_decodes_no_other_texels(tmp_path):
    path = put_small(tmp_path / "a.btf", model=11)
    whole, part = load_btf(path), load_btf(path, crop=(1, 2, 2, 3))
    assert_close(images_of(part), images_of(whole.window(1, 2, 2, 3)), 1e-6)  # products of other sizes round otherwise
    # The factors of a texel outside of the crop may be anything.
    data = bytearray(path.read_bytes())
    data[-8:] = struct.pack("<d", np.nan)
    path.write_bytes(data)
    assert torch.equal(images_of(load_btf(path, crop=(1, 2, 2, 3))), images_of(part))
    with pytest.raises(DataError, match=r"a.btf: view .* light .*: the image must be finite; 1 texels are NaN or Inf, first at row 3, column 5"):
        load_btf(path)
    assert float(images_of(load_btf(path, invalid="mask"))[0, :, 3, 5].abs().max()) == 0


def test_it_is_told_by_its_content_and_says_what_it_took_for_what(tmp_path):
    path = put_small(tmp_path / "wool ü.bin", cosine=False, components=3, scale=(1.5, 1.0, 2.0), rotations=4)
    notes = "\n".join(load_btf(path).source.notes)
    assert "3, 3, 3 components" in notes and "multiplied by the cosine" in notes
    assert "its scale of RGB, 1.5, 1, 2, is taken as applied" in notes and "4 rotations of local frames are not followed" in notes


def test_info_describes_it(tmp_path, capsys):
    assert main(["info", str(put_small(tmp_path / "wool ü.btf"))]) == 0
    said = capsys.readouterr().out
    assert "ubo2014" in said and "4 x 6 texels" in said and "15 of 15" in said


@pytest.mark.parametrize(("settings", "said"), [
    ({"model": 3}, "the colour model must be 0, 11 or 12; it is 3"),
    ({"channels": 2}, "the channels must be three; they are 2: R, G"),
    ({"signature": b"!FMF12FCER"}, r"the BTF of Bonn must be a DFMF \(UBO2014\); it is a full matrix factorisation \(FMF\).*manifest.csv"),
    ({"signature": b"!PVF06FCR\0"}, "it is a factorisation by view"),
])
def test_what_is_not_read_is_refused_by_name(tmp_path, settings, said):
    with pytest.raises(DataError, match=f"a.btf.*{said}"):
        load_btf(put_small(tmp_path / "a.btf", **settings))


def changed(path, place: int, kind: str, value) -> None:
    data = bytearray(path.read_bytes())
    struct.pack_into(kind, data, place, value)
    path.write_bytes(data)


# From the end of the header on, of a file of version 4: views, then for each polar, azimuth, lights and 5 lights.
_HEAD = len(b"!DFMF08FCR") + 4 + 4 + 240 + 16 + 4 + 4 + 6 + 4 + 3 * 5
_SIZE = _HEAD + 4 + 3 * (12 + 40)


@pytest.mark.parametrize(("place", "kind", "value", "said"), [
    (10, "<I", 17, "the header's size must be what it holds; it says 17 bytes"),
    (14, "<I", 2, "the header's size must be what it holds"),
    (_HEAD, "<I", 0, "the number of views must be a number from 1"),
    (_HEAD, "<I", 2**31, "the number of views must be a number from 1"),
    (_HEAD + 12, "<I", 2**30, "the lights of a view must be as many"),
    (_HEAD + 64, "<I", 4, "the lights of a view must be as many as those of every other; view 1 has 4 and the first 5"),
    (_HEAD + 8, "<f", float("nan"), "the view direction must be a unit vector"),
    (_HEAD + 4, "<f", 1.6, "the view direction must lie above the surface"),
    (_SIZE, "<I", 7, "rows and columns of channel R must be 15 samples and 28 texels; they are 15 and 24"),
    (_SIZE, "<I", 0, "the width must be a number from 1"),
    (_SIZE + 8, "<I", 10**6, "the rotations must lie within the file; 36000000 bytes are wanted"),
    (_SIZE + 12 + 36 + 56, "<B", 3, "channel R must hold numbers of 2, 4 or 8 bytes; it says 3"),
    (_SIZE + 12 + 36 + 57, "<I", 2**29, "must lie within the file"),
])
def test_a_damaged_head_says_what_in_it_is_wrong(tmp_path, place, kind, value, said):
    path = put_small(tmp_path / "a.btf")
    changed(path, place, kind, value)
    with pytest.raises(DataError, match=rf"a\.btf.*{said}"):
        load_btf(path)


def test_a_truncated_file_is_refused_wherever_it_ends(tmp_path):
    data = put_small(tmp_path / "whole.btf").read_bytes()
    cut = tmp_path / "cut.btf"
    for length in (*range(10, _SIZE + 160, 13), len(data) - 1):
        cut.write_bytes(data[:length])
        with pytest.raises(DataError, match="cut.btf.*must (lie within the file|be what it holds)"):
            load_btf(cut)


def test_directions_that_repeat_are_refused(tmp_path):
    light = np.array(LIGHT)
    light[:, 1] = light[:, 0]
    with pytest.raises(DataError, match="a.btf.*direction"):
        load_btf(put_dfmf(tmp_path / "a.btf", some_images(), light, VIEW))


def test_names_and_folders_that_are_hard(tmp_path):
    folder = tmp_path / "two words" / "Wolle grün-мох-苔 [a]*?"
    path = put_small(folder / "x y.btf")
    folder.chmod(0o500)
    try:
        assert len(load_btf(path, kind="ubo2014")) == 15
    finally:
        folder.chmod(0o700)
    with pytest.raises(DataError, match="be a file for kind 'ubo2014'"):
        load_btf(folder, kind="ubo2014")
    shutil.copy(path, tmp_path / "a.btf")
    (tmp_path / "b.btf").write_bytes(b"neither")
    with pytest.raises(DataError, match="b.btf: .* it is a BTF in one file"):
        load_btf(tmp_path / "b.btf")
    with pytest.raises(DataError, match="must begin with !DFMF08FCR; it begins with b'neither'"):
        load_btf(tmp_path / "b.btf", kind="ubo2014")


def angles_of(directions: np.ndarray) -> np.ndarray:
    return np.stack([np.arccos(directions[:, 2].clip(-1, 1)), np.arctan2(directions[:, 1], directions[:, 0])], axis=1)


def recovered_from(path, images, scene):
    views = len(np.unique(scene.view.round(6), axis=0))
    light, view = angles_of(scene.light).reshape(views, -1, 2), angles_of(scene.view).reshape(views, -1, 2)[:, 0]
    btf = load_btf(put_dfmf(path, images.transpose(0, 2, 3, 1), light, view, put_settings(scalar=SINGLE)), crop=None)
    return recover_geometry(btf, tiles=True)


def test_parallax_agrees_with_photometric_stereo_in_this_direction_of_rows_alone(tmp_path):
    scene = relief_scene(depth=0.1)
    right = recovered_from(tmp_path / "a.btf", scene.images, scene)
    wrong = recovered_from(tmp_path / "b.btf", scene.images[:, :, ::-1], scene)
    truth, found = scene.height.ravel(), right.relief.height[0].double().numpy().ravel()
    assert np.corrcoef(found, truth)[0, 1] > 0.98
    assert right.figures()["disagreement"] < 0.5 * right.figures()["disagreement_flat"]
    assert wrong.figures()["disagreement"] > 0.8 * wrong.figures()["disagreement_flat"]


def test_what_is_decoded_leaves_memory_as_it_is_written(tmp_path, monkeypatch):
    path = put_large(tmp_path / "a.btf", 32, 32, 60, 25, 3)
    whole = load_btf(path, cache=False)
    freed, let_go = [], pixels.release

    def release(array, samples):
        let_go(array, samples)
        if array.ndim == 4:  # the codes; flags are let go beside them
            freed.append(samples)

    monkeypatch.setattr(store, "RELEASE_BYTES", 0)
    monkeypatch.setattr(pixels, "release", release)
    again = load_btf(path, cache=False)
    assert sorted(sample for samples in freed for sample in samples) == list(range(1500)) and len(freed) > 1
    assert torch.equal(again.images(range(1500)), whole.images(range(1500)))


_TILE = """
import resource, sys
import torchmat as tm
btf = tm.load_btf(sys.argv[1], crop=(200, 120, 32, 32), cache=False, progress=False)
assert (len(btf), btf.height, btf.width) == (22801, 32, 32)
print(float(btf.image(7000).sum()), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024)
"""


def test_a_tile_of_a_file_that_would_fill_44_gb_takes_little_memory(tmp_path):
    path = put_large(tmp_path / "a.btf", 400, 400, 151, 151, 8)
    done = subprocess.run([sys.executable, "-c", _TILE, str(path)], capture_output=True, text=True, check=True)
    total, peak = done.stdout.split()
    assert float(total) > 0 and int(peak) < 1000  # measured 330
