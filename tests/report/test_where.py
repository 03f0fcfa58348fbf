"""Where a material is wrong: the map of its error, and the picture."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from tests.models.distributions import distribution
from tests.models.examples import make
from tests.support import all_pairs, assert_close, hemisphere, plausible_images

from torchmat import Btf, RangeError, ShapeError, evaluate
from torchmat.btf.decode import Decoder
from torchmat.btf.store import CLIPPED, summarise
from torchmat.images import read_image
from torchmat.report.where import difference_map, difference_picture

LIGHT, VIEW = all_pairs(hemisphere(((10, 3), (60, 4))), hemisphere(((0, 1), (50, 3))))
EVERY = torch.arange(len(LIGHT))


def btf_of(height, width, weight=None, images=None):
    images = plausible_images(LIGHT, VIEW, height, width).astype(np.float32) if images is None else images
    return Btf.from_tensors(images, LIGHT, VIEW, weight)


def srgb(value):
    value = min(max(value, 0.0), 1.0)
    return 12.92 * value if value <= 0.0031308 else 1.055 * value ** (1 / 2.4) - 0.055


def matte(*albedo):
    return distribution(1, len(albedo), 0, ()).with_maps(diffuse=torch.tensor(albedo).expand(3, 1, len(albedo)))


def test_one_sample_by_hand():
    z = float(LIGHT[0, 2])
    images = np.zeros((len(LIGHT), 3, 1, 2), np.float32)
    images[:, 0, 0, 1] = 0.2
    found = difference_map(matte(0.0, 0.5), btf_of(1, 2, images=images), torch.tensor([0]))
    red, other = srgb(0.5 * z) - srgb(0.2), srgb(0.5 * z)
    assert found.shape == (1, 1, 2)
    assert_close(found, torch.tensor([[[0.0, math.sqrt((red**2 + 2 * other**2) / 3)]]]))


def test_its_mean_square_is_the_psnr():
    btf, material = btf_of(5, 4), distribution(5, 4, 2)
    found = difference_map(material, btf, EVERY)
    psnr = evaluate(material, btf, EVERY).report["psnr_db"]
    assert abs(-10 * math.log10(float(found.double().square().mean())) - psnr) < 1e-4


def test_texels_that_are_wrong_stand_out():
    material = distribution(5, 4, 0, ())
    with torch.no_grad():
        images = material.shade(*(torch.from_numpy(rows).float()[:, :, None, None] for rows in (LIGHT, VIEW)))
    spoilt = material.maps["diffuse"].detach().clone()
    spoilt[:, 3, 1] *= 0.5
    found = difference_map(material.with_maps(diffuse=spoilt), btf_of(5, 4, images=images), EVERY)[0]
    assert float(found[3, 1]) > 0.05
    found[3, 1] = 0
    assert float(found.max()) < 1e-6


def test_invalid_samples_do_not_count():
    material, images = distribution(3, 4), plausible_images(LIGHT, VIEW, 3, 4).astype(np.float32)
    weight = np.ones((len(LIGHT), 3, 4))
    weight[5:, 0, 0] = 0
    weight[:, 1, 1] = 0
    images[weight[:, None].repeat(3, axis=1) == 0] = np.nan
    found = difference_map(material, btf_of(3, 4, weight, images), EVERY)[0]
    first = difference_map(material, btf_of(3, 4), torch.arange(5))[0]
    assert_close(found[0, 0], first[0, 0])
    assert bool(found[1, 1].isnan()) and int(found.isnan().sum()) == 1


def test_above_a_clipped_sample_nothing_is_wrong():
    images = np.full((len(LIGHT), 3, 1, 2), 1.0, np.float32)
    flags = np.full((len(LIGHT), 1, 2), CLIPPED, np.uint8)
    light, view = torch.from_numpy(LIGHT).float(), torch.from_numpy(VIEW).float()
    dim = Btf(summarise(images, flags), light, view, Decoder(images.dtype, "linear", 2.0))
    assert dim.clip_level < 0.5
    found = difference_map(matte(2.0, 0.0), dim, torch.tensor([0]))
    assert float(found[0, 0, 0]) == 0  # brighter than what clipped
    assert_close(found[0, 0, 1], torch.tensor(srgb(float(dim.image(0)[0, 0, 0]))))


@pytest.mark.parametrize("size", [(1, 1), (1, 5), (7, 3)])
def test_pictures_of_any_size(size, tmp_path):
    path = difference_picture(distribution(*size), btf_of(*size), EVERY, tmp_path / "pictures" / "where.png")
    assert path.is_file() and read_image(path).std() > 0


def test_a_material_without_diffuse_is_drawn_too(tmp_path):
    weight = np.ones((len(LIGHT), 3, 4))
    weight[:, 1, 1] = 0
    path = difference_picture(make("ptm", {}, 3, 4, torch.float32), btf_of(3, 4, weight), EVERY[::2], tmp_path / "where.png")
    assert path.is_file()


def test_wrong_inputs_are_refused():
    btf, material = btf_of(3, 4), distribution(3, 4)
    with pytest.raises(ShapeError, match="be 3 x 4 as the images; it is 4 x 3"):
        difference_map(distribution(4, 3), btf, EVERY)
    mask = torch.ones(len(EVERY), dtype=torch.bool)
    for wrong in (EVERY[:0], EVERY + 1, EVERY - 1, EVERY.float(), mask, EVERY[None]):
        with pytest.raises(RangeError, match=r"indices must be sample numbers \[n\] from 0 to 27"):
            difference_map(material, btf, wrong)
