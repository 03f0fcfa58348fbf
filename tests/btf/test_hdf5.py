"""NeuralBTF's HDF5: read slice by slice, near-field captures and everything else refused by name."""

from __future__ import annotations

import builtins
import re

import numpy as np
import pytest
import torch
from tests.support import all_pairs, hemisphere, plausible_images

from torchmat import DataError, load_btf
from torchmat.btf import hdf5 as module
from torchmat.cli import main

h5py = pytest.importorskip("h5py", reason="h5py is not installed: pip install 'torchmat[hdf5]'")

LIGHT, VIEW = all_pairs(hemisphere(((0, 1), (40, 4))), hemisphere(((0, 1), (50, 3))))
IMAGES = plausible_images(LIGHT, VIEW, 5, 4).transpose(0, 2, 3, 1).astype(np.float32)


@pytest.fixture(autouse=True)
def no_cache(monkeypatch, tmp_path_factory):
    monkeypatch.setenv("TORCHMAT_CACHE", str(tmp_path_factory.mktemp("cache")))


def put(path, light=LIGHT[:, :2], view=VIEW[:, :2], images=IMAGES, names=None, **how):
    path.parent.mkdir(parents=True, exist_ok=True)
    with h5py.File(path, "w") as file:
        for name, value in zip(names or ("ground_light", "ground_camera_dir", "ground_color"), (light, view, images), strict=True):
            value = np.asarray(value)
            file.create_dataset(name, data=value if value.dtype.kind != "f" or value is images else value.astype(np.float32),
                                **(how if value is images else {}))
    return path


def images_of(btf):
    return btf.images(range(len(btf))).numpy().transpose(0, 2, 3, 1)


@pytest.mark.parametrize("how", [
    {}, {"chunks": (3, 2, 4, 3)}, {"chunks": (5, 5, 1, 3), "compression": "gzip"}, {"dtype": ">f4"}, {"dtype": "<f2"}, {"dtype": "<f8"},
], ids=str)
def test_values_directions_and_crops(tmp_path, how):
    dtype = how.pop("dtype", "<f4")
    path = put(tmp_path / "a.hdf5", images=IMAGES.astype(dtype), **how)
    btf = load_btf(path)
    wanted = IMAGES.astype(dtype).astype(np.float32)
    assert np.array_equal(images_of(btf), wanted) and btf.source.kind == "neuralbtf"
    assert np.abs(btf.light.numpy() - LIGHT).max() < 1e-6 and np.abs(btf.view.numpy() - VIEW).max() < 1e-6
    assert np.array_equal(images_of(load_btf(path, crop=(1, 2, 3, 2))), wanted[:, 1:4, 2:4])


def test_what_lies_in_one_piece_is_mapped(tmp_path):
    with module._opened(module.File(put(tmp_path / "a.h5"))) as file:
        assert isinstance(module._sliceable(module.File(tmp_path / "a.h5"), file, file["ground_color"]), np.memmap)
    with module._opened(module.File(put(tmp_path / "b.h5", chunks=(1, 5, 4, 3)))) as file:
        assert isinstance(module._sliceable(module.File(tmp_path / "b.h5"), file, file["ground_color"]), h5py.Dataset)


def test_info_describes_it(tmp_path, capsys):
    assert main(["info", str(put(tmp_path / "Wolle grün мох.h5"))]) == 0
    said = capsys.readouterr().out
    assert "neuralbtf" in said and "5 x 4 texels" in said and "20 of 20" in said


NEAR = np.zeros((20, 5, 4, 2))


@pytest.mark.parametrize(("changes", "said"), [
    ({"view": NEAR}, r"each image's view must be one direction, \(N, 2\); ground_camera_dir is \(20, 5, 4, 2\), a view for each texel: a near-field capture"),
    ({"light": NEAR}, "a light for each texel: a near-field capture. Rectify it"),
    ({"light": LIGHT}, r"ground_light must be \(N, 2\) floating-point numbers; it is \(20, 3\) of float32"),
    ({"light": np.zeros((0, 2)), "view": np.zeros((0, 2)), "images": IMAGES[:0]}, r"it is \(0, 2\)"),
    ({"light": LIGHT[:-1, :2]}, "must be of as many images; there are 19 of ground_light, 20 of ground_camera_dir, 20 of ground_color"),
    ({"view": 1.5 * VIEW[:, :2]}, "ground_camera_dir must lie within the unit circle; 15 of 20 are not"),
    ({"light": np.full((20, 2), np.nan)}, "ground_light must lie within the unit circle; 20 of 20 are not"),
    ({"images": (IMAGES * 255).astype(np.uint8)}, "linear floating-point numbers; it is .* of uint8"),
    ({"images": IMAGES[..., :2]}, r"ground_color must be \(N, H, W, 3\)"),
    ({"names": ("light", "view", "ground_color")}, "ground_light, ground_camera_dir is not there; it holds 'ground_color', 'light', 'view'"),
])
def test_what_cannot_be_read_as_it_was_meant_is_refused(tmp_path, changes, said):
    with pytest.raises(DataError, match=f"a.h5: NeuralBTF.*{said}"):
        load_btf(put(tmp_path / "a.h5", **changes))


def test_values_that_are_not_finite(tmp_path):
    images = IMAGES.copy()
    images[7, 2, 1, 0] = np.nan
    with pytest.raises(DataError, match="a.h5: image 7: the image must be finite; 1 texels are NaN or Inf, first at row 2, column 1"):
        load_btf(put(tmp_path / "a.h5", images=images))
    assert len(load_btf(tmp_path / "a.h5", invalid="mask")) == 20


def test_repeated_directions(tmp_path):
    light = LIGHT[:, :2].copy()
    light[1], view = light[0], VIEW[:, :2].copy()
    with pytest.raises(DataError, match="a.h5.*image 1"):
        load_btf(put(tmp_path / "a.h5", light=light, view=view))
    assert len(load_btf(tmp_path / "a.h5", duplicates="keep")) == 20


def test_a_truncated_file(tmp_path):
    data = put(tmp_path / "whole.h5").read_bytes()
    for length in (9, 100, len(data) // 2, len(data) - 1):
        (tmp_path / "cut.h5").write_bytes(data[:length])
        with pytest.raises(DataError, match="cut.h5"):
            load_btf(tmp_path / "cut.h5")


def test_links_and_storage_outside_of_the_file_are_not_followed(tmp_path):
    other = put(tmp_path / "other.h5")
    with h5py.File(put(tmp_path / "link.h5"), "a") as file:
        del file["ground_color"]
        file["ground_color"] = h5py.ExternalLink(str(other), "/ground_color")
    with pytest.raises(DataError, match="link.h5: .*ground_color is not there"):
        load_btf(tmp_path / "link.h5")
    (tmp_path / "secret").write_bytes(IMAGES.tobytes())
    with h5py.File(put(tmp_path / "out.h5"), "a") as file:
        del file["ground_color"]
        external = [(str(tmp_path / "secret"), 0, h5py.h5f.UNLIMITED)]
        file.create_dataset("ground_color", IMAGES.shape, np.float32, external=external)
    with pytest.raises(DataError, match="out.h5: .*ground_color must lie in the file itself"):
        load_btf(tmp_path / "out.h5")


def test_pieces_that_would_unpack_to_gigabytes(tmp_path):
    with h5py.File(put(tmp_path / "a.h5"), "a") as file:
        del file["ground_color"]
        file.create_dataset("ground_color", (20, 20000, 20000, 3), np.float32, chunks=(1, 20000, 20000, 1))
    with pytest.raises(DataError, match="a.h5: .*the chunks of ground_color must be of at most 1 GiB"):
        load_btf(tmp_path / "a.h5", crop=(0, 0, 1, 1))


def test_without_h5py_it_says_what_to_install(tmp_path, monkeypatch):
    path, real = put(tmp_path / "a.h5"), builtins.__import__
    monkeypatch.setattr(builtins, "__import__", lambda name, *rest: (_ for _ in ()).throw(ImportError(name)) if name == "h5py" else real(name, *rest))
    with pytest.raises(DataError, match=re.escape("a.h5: an HDF5 file must have h5py to be read with; h5py is not installed. pip install 'torchmat[hdf5]'")):
        load_btf(path)


def test_other_files_are_not_taken(tmp_path):
    (tmp_path / "b.h5").write_bytes(b"neither")
    with pytest.raises(DataError, match="b.h5: .* it is an HDF5 container"):
        load_btf(tmp_path / "b.h5")
    assert torch.is_tensor(load_btf(put(tmp_path / "c.bin"), kind="neuralbtf").light)
