"""Images averaged down: means of what is known, and what counts as clipped or unknown."""

from __future__ import annotations

import numpy as np
import torch
from tests.support import assert_close, hemisphere

from torchmat.btf import Btf
from torchmat.btf.decode import Decoder
from torchmat.btf.store import CLIPPED, INVALID, VALID, summarise
from torchmat.fitting.fewer_texels import averaged

LIGHT = hemisphere(((0, 1), (40, 3)))


def with_flags(flags: np.ndarray) -> tuple[Btf, np.ndarray]:
    images = np.random.default_rng(0).uniform(0, 1, (4, 3, 4, 6)).astype(np.float32)
    light = torch.from_numpy(LIGHT).float()
    return Btf(summarise(images, flags), light, light, Decoder(images.dtype, "linear", 1.0), None, 0.25), images


def test_means_of_what_is_known(dtype):
    flags = np.full((4, 4, 6), VALID, np.uint8)
    flags[1, 0, 0] = flags[2, :2, :2] = INVALID
    flags[3, 3, 5] = CLIPPED
    btf, images = with_flags(flags)
    small = averaged(btf, torch.tensor([1, 2, 3]), (2, 3), dtype)
    assert (len(small), small.height, small.width, small.clipped_weight) == (3, 2, 3, 0.25)
    found = small.images(torch.arange(3), dtype)
    expected = images.reshape(4, 3, 2, 2, 3, 2).mean(axis=(3, 5))[1:]
    expected[0, :, 0, 0] = (images[1, :, :2, :2].sum(axis=(1, 2)) - images[1, :, 0, 0]) / 3
    expected[1, :, 0, 0] = 0
    assert_close(found, torch.from_numpy(expected).to(dtype), 1e-6)
    wanted = torch.ones(3, 1, 2, 3)
    wanted[1, 0, 0, 0], wanted[2, 0, 1, 2] = 0, 0.25
    assert torch.equal(small.weights(torch.arange(3)), wanted)


def test_what_is_known_of_less_than_half_is_unknown():
    flags = np.full((4, 4, 6), VALID, np.uint8)
    flags[0, 0, :2] = flags[1, :2, 0] = flags[1, 0, 1] = INVALID
    small = averaged(with_flags(flags)[0], torch.arange(2), (2, 3), torch.float32)
    assert small.valid(torch.arange(2))[:, 0, 0, 0].tolist() == [True, False]
