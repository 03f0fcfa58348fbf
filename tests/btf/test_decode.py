"""Stored codes to linear light."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tests.btf.files import srgb_decoded
from tests.support import assert_close

from torchmat.btf.decode import Decoder, resolve_encoding


def decoded(codes: np.ndarray, encoding: str, exposure: float = 1.0, dtype=torch.float32) -> torch.Tensor:
    return Decoder(codes.dtype, encoding, exposure).into(codes, torch.empty(codes.shape, dtype=dtype))


def test_known_codes():
    values = decoded(np.array([0, 10, 128, 188, 255], dtype=np.uint8), "srgb")
    assert_close(values, [0.0, 0.00303527, 0.21586050, 0.50288646, 1.0], 1e-6)


@pytest.mark.parametrize("out", [torch.float32, torch.float64])
def test_all_8_bit_codes(out):
    codes = np.arange(256, dtype=np.uint8)
    expected = srgb_decoded(codes / 255)
    # The table is float32, so half an ulp, 6e-8 of each value, is the most that may be lost; measured 6.0e-8.
    error = np.abs(decoded(codes, "srgb", dtype=out).double().numpy() - expected) / np.maximum(expected, 1e-9)
    assert error.max() < 7e-8
    assert decoded(codes, "linear", dtype=out).tolist() == (codes / 255).astype(np.float32).tolist()


@pytest.mark.parametrize("shape", [(1,), (2,), (3, 1, 1), (3, 5, 7), (2, 3, 5, 7), (1, 3, 4, 4)])
def test_pairs_and_single_look_ups_agree(shape):
    codes = np.random.default_rng(0).integers(0, 256, shape).astype(np.uint8)
    expected = srgb_decoded(codes / 255)
    assert_close(decoded(codes, "srgb"), expected, 1e-6)
    assert torch.equal(decoded(codes, "srgb"), decoded(codes, "srgb", dtype=torch.float64).float())


def test_order_within_a_pair():
    assert decoded(np.array([0, 255, 255, 0], dtype=np.uint8), "linear").tolist() == [0, 1, 1, 0]


def test_into_a_part_of_a_larger_tensor():
    codes = np.arange(24, dtype=np.uint8).reshape(2, 3, 2, 2)
    whole = torch.full((3, 3, 2, 2), -1.0)
    Decoder(np.uint8, "linear", 1.0).into(codes, whole[:2])
    assert_close(whole[:2], codes / 255)
    assert bool((whole[2] == -1).all())
    across = torch.full((2, 3, 2, 4), -1.0)
    Decoder(np.uint8, "linear", 1.0).into(codes, across[..., ::2])
    assert_close(across[..., ::2], codes / 255)
    assert bool((across[..., 1::2] == -1).all())


def test_16_bit_codes():
    codes = np.array([0, 1, 2650, 2651, 32768, 65534, 65535], dtype=np.uint16)
    assert_close(decoded(codes, "srgb"), srgb_decoded(codes / 65535), 1e-7)
    assert_close(decoded(codes, "linear"), codes / 65535, 1e-7)


@pytest.mark.parametrize("stored", [np.float16, np.float32, np.float64])
def test_floating_point(stored):
    codes = np.array([-0.25, 0.0, 0.03, 0.5, 1.0, 40.0], dtype=stored)
    assert decoded(codes, "linear").tolist() == codes.astype(np.float32).tolist()
    assert_close(decoded(codes, "srgb"), srgb_decoded(codes), 1e-6)


def test_double_precision_is_kept():
    codes = np.array([1 / 3])
    assert decoded(codes, "linear", dtype=torch.float64).item() == 1 / 3


@pytest.mark.parametrize("codes", [np.array([51, 255], np.uint8), np.array([13107, 65535], np.uint16)])
def test_exposure_divides_codes(codes):
    assert_close(decoded(codes, "linear", 0.5), [0.4, 2.0])
    assert_close(decoded(codes, "srgb", 4.0), srgb_decoded([0.2, 1]) / 4, 1e-6)


def test_exposure_divides_values():
    assert decoded(np.array([0.5, 3], np.float32), "linear", 0.5).tolist() == [1, 6]


def test_a_full_code_is_clipped_and_a_float_never_is():
    assert Decoder(np.uint8, "srgb", 1).full_code == 255
    assert Decoder(np.uint16, "linear", 1).full_code == 65535
    assert Decoder(np.float16, "linear", 1).full_code is None


@pytest.mark.parametrize(
    "encoding, stored, expected",
    [("auto", "uint8", "srgb"), ("auto", "uint16", "srgb"), ("auto", "float16", "linear"),
     ("auto", "float32", "linear"), ("linear", "uint8", "linear"), ("srgb", "float32", "srgb")],
)
def test_encoding(encoding, stored, expected):
    assert resolve_encoding(encoding, np.dtype(stored)) == expected
