"""Relief from photographs or from one picture, to textures, through the command line."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch
from tests.support import hemisphere, shared_path

from torchmat.btf.light_table import read_lights
from torchmat.btf.photographs import read_photographs
from torchmat.cli import main
from torchmat.errors import DataError, RangeError, ShapeError
from torchmat.geometry import Relief, relief_from_photographs, relief_from_picture
from torchmat.images import read_image, write_image
from torchmat.material_io.relief_folder import save_relief

LIGHTS = hemisphere(((0, 1), (30, 6), (55, 8)))


def dome(size: int = 32) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return Lambert photographs [n, 3, H, W] of a smooth bump, its height in texture widths (mean 0) and normals."""
    axis = (np.arange(size) + 0.5) / size - 0.5
    up, across = np.meshgrid(-axis, axis, indexing="ij")
    height = 0.1 * np.exp(-(across**2 + up**2) / 0.05)
    slope = height / 0.05 * -2
    normal = np.stack((-slope * across, -slope * up, np.ones_like(height)))
    normal /= np.linalg.norm(normal, axis=0)
    images = 0.7 * np.maximum(0, np.einsum("nk,khw->nhw", LIGHTS, normal))[:, None].repeat(3, axis=1)
    return images, height - height.mean(), normal


@pytest.mark.parametrize(("integration", "most"), [("poisson", 0.02), ("fourier", 0.02)])
def test_a_dome_comes_back(integration, most):
    images, height, normal = dome()
    found = relief_from_photographs(torch.from_numpy(images), torch.from_numpy(LIGHTS), integration=integration)
    # The bump is sampled at 32 texels, which blunts its slopes: measured 0.9 % of its range.
    assert float((found.height[0] - torch.from_numpy(height)).abs().max()) < most * np.ptp(height)
    assert float((found.normal - torch.from_numpy(normal)).abs().max()) < 1e-3


def test_a_dark_background_of_noise_does_not_bend_the_dome():
    images, height, _ = dome()
    random = np.random.default_rng(0)
    seen = height > height.min() + 0.01 * np.ptp(height)
    noisy = np.where(seen, images, random.uniform(0, 0.01, images.shape))
    found = relief_from_photographs(torch.from_numpy(noisy), torch.from_numpy(LIGHTS)).height[0].numpy()
    difference = (found - height)[seen]
    assert np.abs(difference - difference.mean()).max() < 0.1 * np.ptp(height)


def test_one_picture_gives_its_luminance_as_height():
    picture = torch.zeros(3, 4, 4)
    picture[1, 1, 2] = 1.0
    relief = relief_from_picture(picture, height_scale=0.1)
    assert float(relief.height[0, 1, 2] - relief.height[0, 0, 0]) == pytest.approx(0.07152, rel=1e-5)
    assert abs(float(relief.height.mean())) < 1e-8
    assert relief.albedo is None and relief.confidence is None


def test_wrong_input_is_refused():
    with pytest.raises(RangeError, match="integration"):
        relief_from_photographs(torch.ones(5, 3, 4, 4), torch.from_numpy(LIGHTS[:5]).float(), integration="magic")
    with pytest.raises(ShapeError, match="picture"):
        relief_from_picture(torch.zeros(1, 4, 4))
    for scale in (0.0, 10.0):
        with pytest.raises(RangeError, match="texture widths"):
            relief_from_picture(torch.zeros(3, 4, 4), height_scale=scale)


def relief() -> Relief:
    images, _, _ = dome(16)
    return relief_from_photographs(torch.from_numpy(images).float(), torch.from_numpy(LIGHTS).float())


def test_textures_hold_the_relief_within_their_quantum(tmp_path):
    wanted = relief()
    folder = save_relief(wanted, tmp_path / "a relief ü")
    described = json.loads((folder / "relief.json").read_text())
    low, high = described["height_low"], described["height_high"]
    height = read_image(folder / "height.png")[..., 0] / 65535 * (high - low) + low
    assert np.abs(height - wanted.height[0].numpy()).max() <= 0.51 * (high - low) / 65535 + 1e-8
    opengl = read_image(folder / "normal_gl.png") / 65535 * 2 - 1
    directx = read_image(folder / "normal_dx.png") / 65535 * 2 - 1
    assert np.abs(opengl.transpose(2, 0, 1) - wanted.normal.numpy()).max() < 2e-5
    assert np.abs(opengl[..., 1] + directx[..., 1]).max() < 4e-5
    assert np.array_equal(opengl[..., 0], directx[..., 0])


def test_float_textures_are_exact_and_replace_an_earlier_relief(tmp_path):
    wanted = relief()
    save_relief(wanted, tmp_path / "r", "16")
    folder = save_relief(wanted, tmp_path / "r", "float")
    assert np.array_equal(read_image(folder / "height.exr")[..., 0], wanted.height[0].numpy())
    assert not (folder / "height.png").exists()


def test_a_folder_with_other_files_is_refused(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(DataError, match=r"notes\.txt"):
        save_relief(relief(), tmp_path)
    with pytest.raises(RangeError, match="depth"):
        save_relief(relief(), tmp_path / "r", "8")


def write_photographs(folder, images) -> None:
    folder.mkdir()
    for number, image in enumerate(images):
        write_image(folder / f"photo {number:02d}.exr", image.transpose(1, 2, 0).astype(np.float32))


@pytest.mark.parametrize("columns", [False, True])
def test_command_with_a_table_of_lights(tmp_path, capsys, columns):
    images, height, _ = dome(16)
    write_photographs(tmp_path / "photos", images)
    np.savetxt(tmp_path / "lights.txt", LIGHTS.T if columns else LIGHTS)
    out = tmp_path / "out"
    code = main(["geometry", str(tmp_path / "photos"), "--lights", str(tmp_path / "lights.txt"), "--out", str(out), "--depth", "float"])
    assert code == 0
    assert "normal_dx.exr" in capsys.readouterr().out
    found = read_image(out / "height.exr")[..., 0]
    assert np.corrcoef(found.ravel(), height.ravel())[0, 1] > 0.999
    assert read_image(out / "relief.png").shape[0] > 100


def test_command_with_one_picture(tmp_path):
    write_image(tmp_path / "grey.png", np.arange(64, dtype=np.uint8).reshape(8, 8) * 4)
    assert main(["geometry", str(tmp_path / "grey.png"), "--out", str(tmp_path / "out")]) == 0
    assert (tmp_path / "out" / "height.png").exists() and not (tmp_path / "out" / "confidence.png").exists()


def test_command_says_what_is_missing(tmp_path, capsys):
    images, _, _ = dome(8)
    write_photographs(tmp_path / "photos", images[:4])
    assert main(["geometry", str(tmp_path / "photos"), "--ball", str(tmp_path / "photos"), "--out", str(tmp_path / "o")]) == 2
    assert "--circle" in capsys.readouterr().err
    np.savetxt(tmp_path / "lights.txt", LIGHTS[:3])
    assert main(["geometry", str(tmp_path / "photos"), "--lights", str(tmp_path / "lights.txt"), "--out", str(tmp_path / "o")]) == 2
    assert "lights.txt" in capsys.readouterr().err
    assert not (tmp_path / "o").exists()


def test_photographs_of_different_sizes_name_the_file(tmp_path):
    write_image(tmp_path / "a.png", np.zeros((4, 4, 3), np.uint8))
    write_image(tmp_path / "b.png", np.zeros((4, 5, 3), np.uint8))
    with pytest.raises(ShapeError, match=r"b\.png"):
        read_photographs(tmp_path)
    with pytest.raises(DataError, match="folder"):
        read_photographs(tmp_path / "nowhere")


def test_a_picture_of_many_channels_is_refused_not_cut(tmp_path):
    write_image(tmp_path / "spectral.exr", np.zeros((4, 4, 6), np.float32))
    with pytest.raises(DataError, match=r"spectral\.exr: the channels must be Y, or R, G, B.*'channel5'"):
        read_photographs(tmp_path)


@pytest.mark.parametrize("text", ["1 2\n3 4\n", "a b c\n", "0 0 0\n0 0 1\n", "nan 0 1\n0 0 1\n", ""])
def test_a_table_that_gives_no_lights_is_refused(tmp_path, text):
    (tmp_path / "l.txt").write_text(text)
    with pytest.raises(DataError, match=r"l\.txt"):
        read_lights(tmp_path / "l.txt", 2)


def test_a_real_capture_stands_out_from_its_ground(tmp_path):
    """The lion's head: 240 photographs; the head rises above the ground around it."""
    source = shared_path("real/loewenkopf_rti")
    assert main(["geometry", str(source), "--out", str(tmp_path / "out"), "--depth", "float"]) == 0
    height = read_image(tmp_path / "out" / "height.exr")[..., 0]
    border = np.concatenate((height[0], height[-1], height[:, 0], height[:, -1]))
    assert height[15:28, 20:45].mean() - np.median(border) > 0.08
