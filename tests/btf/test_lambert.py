"""What Lambert's law says of a capture: right lights and wrong ones, the encoding, and intensities that nobody wrote down."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tests.btf.files import put_image
from tests.support import assert_close

from torchmat import Btf, RangeError, load_btf
from torchmat.btf.lambert import lambert_of, one_view, with_estimated_intensities
from torchmat.geometry import photometric_stereo
from torchmat.geometry.lambert import estimate_intensities, lambert_residual

COUNT, SIZE = 14, 24
_AZIMUTH = 2.4 * np.arange(COUNT)
_POLAR = np.deg2rad(np.linspace(15, 62, COUNT))
LIGHT = np.stack((np.sin(_POLAR) * np.cos(_AZIMUTH), np.sin(_POLAR) * np.sin(_AZIMUTH), np.cos(_POLAR)), axis=1)
LAMPS = (0.25 + 1.5 * np.random.default_rng(4).random((COUNT, 1))) * (0.8 + 0.4 * np.random.default_rng(5).random((COUNT, 3)))


def dome() -> np.ndarray:
    """Return images [n, 3, H, W] of a coloured spherical cap with cast-free shadows, float64, below 1."""
    y, x = np.meshgrid(np.linspace(0.8, -0.8, SIZE), np.linspace(-0.8, 0.8, SIZE), indexing="ij")
    normal = np.stack((x, y, np.sqrt(np.maximum(1.6 - x * x - y * y, 0.1))))
    normal /= np.linalg.norm(normal, axis=0)
    albedo = 0.25 + 0.2 * np.random.default_rng(1).random((3, SIZE, SIZE))
    shading = np.maximum(np.einsum("nk,khw->nhw", LIGHT, normal), 0)
    return albedo * shading[:, None]


def tensors(images=None, light=LIGHT):
    return torch.from_numpy(dome() if images is None else images), torch.from_numpy(np.ascontiguousarray(light))


def capture(images=None, light=LIGHT):
    images, light = tensors(images, light)
    return Btf.from_tensors(images, light, torch.tensor([[0.0, 0.0, 1.0]]).repeat(len(light), 1))


def test_the_residual_by_hand():
    """One texel facing up, albedo 1, and one photograph of three off by 0.3: the median gap over photographs is 0 ..."""
    light = torch.tensor([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8], [0.0, 0.6, 0.8]])
    images = light[:, 2, None, None, None].expand(3, 3, 1, 1).clone()
    found = photometric_stereo(images, light)
    assert lambert_residual(images, light, found) < 1e-5
    off = images + torch.tensor([0.3, 0.3, 0.0])[:, None, None, None]
    # ... and of two that are off by 0.3, 0.3 in parts of the texel's mean, (2.6 + 0.6) / 3.
    assert lambert_residual(off, light, found) == pytest.approx(0.3 / (3.2 / 3), abs=1e-4)


def test_dark_texels_do_not_count():
    images, light = tensors()
    found = photometric_stereo(images, light)
    images[..., : SIZE // 3] = 0.001 * torch.rand(COUNT, 3, SIZE, SIZE // 3, dtype=torch.float64)
    assert lambert_residual(images, light, found) < 1e-3


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_lights_in_text_order_are_told_from_the_right_ones(noise):
    images = dome() * (1 + noise * np.random.default_rng(2).standard_normal((COUNT, 3, SIZE, SIZE)))
    right, text = lambert_of(capture(images)), sorted(range(COUNT), key=str)
    wrong = lambert_of(capture(images, LIGHT[text]))
    assert right.residual < 0.02 and right.warnings() == [] and "good" in right.sentence()
    assert wrong.residual > 0.1 and wrong.shuffled > 0.1
    assert any("the lights hardly explain the photographs" in warning for warning in wrong.warnings())


def test_intensities_are_recovered():
    images, light = tensors(dome() * LAMPS[:, :, None, None])
    found = estimate_intensities(images, light)
    assert_close(found, LAMPS / LAMPS.mean(axis=0), 1e-3)


def test_intensities_are_recovered_from_noise_and_highlights():
    random = np.random.default_rng(3)
    images = dome() * LAMPS[:, :, None, None] * (1 + 0.01 * random.standard_normal((COUNT, 3, SIZE, SIZE)))
    images += 0.8 * (random.random((COUNT, 1, SIZE, SIZE)) > 0.97)
    found = estimate_intensities(*tensors(images)).numpy()
    assert np.abs(found / (LAMPS / LAMPS.mean(axis=0)) - 1).max() < 0.03


def test_estimated_intensities_bring_the_normals_back():
    images = dome() * LAMPS[:, :, None, None]
    truth = photometric_stereo(*tensors()).normal
    plain = capture(images)
    normals = [photometric_stereo(btf.images(range(COUNT)), btf.light).normal for btf in (plain, with_estimated_intensities(plain, True))]
    worst = [float(torch.rad2deg(torch.acos((n * truth).sum(dim=0).clamp(max=1))).median()) for n in normals]
    assert worst[0] > 5 and worst[1] < 0.1


def test_it_is_said_whether_intensities_are_estimated():
    before, after = lambert_of(capture(dome() * LAMPS[:, :, None, None])), with_estimated_intensities(capture(), True)
    assert any("seem not to be equally bright" in text and "--intensities estimate" in text for text in before.warnings())
    assert after.intensity is None and "are taken to be equally bright" in after.source.notes[-1]
    forced = with_estimated_intensities(capture(dome() * LAMPS[:, :, None, None]))
    assert forced.intensity is not None and "intensities of the lights are estimated" in forced.source.notes[-1]
    assert lambert_of(forced).residual < 0.02


def put_codes(folder, codes):
    for number, image in enumerate(codes):
        put_image(folder / f"{number}.tif", image.transpose(1, 2, 0))
    np.savetxt(folder / "light_directions.txt", LIGHT[: len(codes)])
    return folder


def srgb_encoded(linear):
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 0) ** (1 / 2.4) - 0.055)


@pytest.mark.parametrize("dtype", ["uint8", "uint16"])
def test_a_wrong_encoding_is_told_by_the_residual_both_ways(tmp_path, dtype):
    levels = np.iinfo(dtype).max
    linear = np.rint(dome() * levels).astype(dtype)
    srgb = np.rint(srgb_encoded(dome()) * levels).astype(dtype)
    for name, codes, other in (("linear", linear, "srgb"), ("srgb", srgb, "linear")):
        folder = put_codes(tmp_path / name, codes)
        right, wrong = (lambert_of(load_btf(folder, encoding=encoding)) for encoding in (name, other))
        assert right.residual < 0.02 and right.warnings() == []
        (warning,) = wrong.warnings()
        assert f"if they are {name}, say --encoding {name}" in warning
        assert wrong.others[name] < 0.6 * wrong.residual


def test_a_wrong_encoding_of_shallow_relief_is_told_although_little_is_left(tmp_path):
    """Lights from 15 to 41 degrees on a surface that is nearly flat: read as sRGB, the curve is nearly a factor."""
    y, x = np.meshgrid(np.linspace(0.8, -0.8, SIZE), np.linspace(-0.8, 0.8, SIZE), indexing="ij")
    normal = np.stack((0.2 * np.sin(4 * x), 0.2 * np.sin(3 * y), np.ones_like(x)))
    shading = np.einsum("nk,khw->nhw", LIGHT[:8], normal / np.linalg.norm(normal, axis=0))
    linear = np.rint((0.3 + 0.4 * np.random.default_rng(2).random((3, SIZE, SIZE))) * shading[:, None] * 65535).astype(np.uint16)
    folder = put_codes(tmp_path / "d", linear)
    wrong, right = (lambert_of(load_btf(folder, encoding=encoding)) for encoding in ("srgb", "linear"))
    assert 0.01 < wrong.residual < 0.05 and right.warnings() == []
    assert any("if they are linear, say --encoding linear" in warning for warning in wrong.warnings())


def test_what_says_nothing():
    images, light = tensors()
    plane = light * torch.tensor([1.0, 0.0, 1.0])
    plane = plane / plane.norm(dim=1, keepdim=True)
    views = torch.tensor([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8]])[torch.arange(COUNT) % 2]
    for btf in (Btf.from_tensors(images, light, views), capture(light=plane.numpy()), capture(dome()[:3], LIGHT[:3])):
        assert not one_view(btf) and lambert_of(btf) is None
        with pytest.raises(RangeError, match="be of one view under 4 lights or more"):
            with_estimated_intensities(btf)
