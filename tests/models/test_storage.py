"""Codes of textures: ranges, quanta, exact ends."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tests.models.examples import assert_same
from tests.reference import colour as oracle

from torchmat.errors import RangeError
from torchmat.models.storage import STORAGES, MapSpec, check_map, decode, encode

PLAIN = MapSpec("residual", "anything", layer_channels=1)
COLOUR = MapSpec("albedo", "colour", low=0.0, colour=True)
NORMAL = MapSpec("normal", "normal", low=-1.0, high=1.0, fixed_range=True)
INTEGERS = [name for name, storage in STORAGES.items() if storage.levels]
# Codes that span the values that occur; those that are made to be painted span what a map can be (test_painted).
TIGHT = [name for name, storage in STORAGES.items() if not storage.natural]


def _column(*values, channels=1) -> torch.Tensor:
    return torch.tensor(values).reshape(1, 1, -1).expand(channels, 1, -1).contiguous()


def test_storages():
    assert {name: (s.suffix, s.bytes, s.levels) for name, s in STORAGES.items()} == {
        "half": (".exr", 2, None), "float": (".exr", 4, None), "png8": (".png", 1, 255), "png16": (".png", 2, 65535),
        "tiff8": (".tif", 1, 255), "tiff16": (".tif", 2, 65535),
        "paint8": (".png", 1, 255), "paint16": (".png", 2, 65535),
    }


@pytest.mark.parametrize("storage", INTEGERS)
def test_integer_codes_span_the_values(storage):
    levels = STORAGES[storage].levels
    codes = encode(PLAIN, _column(-2.0, 0.0, 2.0), storage)
    assert codes.pixels.shape == (1, 3, 1)
    assert codes.pixels.dtype == np.dtype(STORAGES[storage].dtype)
    assert (codes.low, codes.high, codes.transfer) == ((-2.0,), (2.0,), "linear")
    assert codes.pixels[0, :, 0].tolist() == [0, round(levels / 2), levels]
    found = decode(codes)
    assert (float(found[0, 0, 0]), float(found[0, 0, 2])) == (-2.0, 2.0)


@pytest.mark.parametrize("storage", [name for name in INTEGERS if name in TIGHT])
def test_integer_codes_stay_within_half_a_step(storage):
    value = torch.rand(3, 40, 50) * torch.tensor([1.0, 100.0, 1e-3])[:, None, None] - 0.3
    error = (decode(encode(MapSpec("m", ""), value, storage)) - value).abs().amax(dim=(1, 2))
    span = value.amax(dim=(1, 2)) - value.amin(dim=(1, 2))
    bound = span / STORAGES[storage].levels / 2 + 6e-8 * value.abs().amax(dim=(1, 2))
    assert bool((error <= bound).all())
    assert bool((error > 0.4 * span / STORAGES[storage].levels)[:2].all())  # and no better: the whole quantum is used


@pytest.mark.parametrize("storage", INTEGERS)
def test_a_declared_range_is_spanned_exactly(storage):
    codes = encode(NORMAL, _column(0.25, 0.5, channels=3), storage)
    assert (codes.low, codes.high) == ((-1.0,) * 3, (1.0,) * 3)
    assert codes.pixels[0, 0, 0] == round(0.625 * STORAGES[storage].levels)
    assert decode(encode(NORMAL, _column(-1.0, 1.0, channels=3), storage))[0].tolist() == [[-1.0, 1.0]]


@pytest.mark.parametrize("storage", TIGHT)
@pytest.mark.parametrize("value", [0.0, 0.25, 1.0, 1000.0])
@pytest.mark.parametrize("spec", [PLAIN, COLOUR], ids=["plain", "colour"])
def test_constant_maps_come_back_exactly(storage, value, spec):
    planes = _column(value, value, channels=spec.channels)
    assert torch.equal(decode(encode(spec, planes, storage)), planes)


def test_eight_bit_colour_is_srgb_encoded_with_exact_ends():
    codes = encode(COLOUR, _column(0.0, 0.25, 0.5, channels=3), "png8")
    assert (codes.transfer, codes.low, codes.high) == ("srgb", (0.0,) * 3, (0.5,) * 3)
    assert codes.pixels[0, :, 0].tolist() == [0, round(255 * oracle.encode(0.5)), 255]
    found = decode(codes)
    assert (float(found[0, 0, 0]), float(found[0, 0, 2])) == (0.0, 0.5)
    assert float(found[0, 0, 1]) == pytest.approx(0.5 * oracle.decode(round(255 * oracle.encode(0.5)) / 255), rel=1e-6)
    assert encode(COLOUR, _column(0.0, 0.5, channels=3), "png16").transfer == "linear"


def test_colour_keeps_one_scale_so_that_hues_survive():
    planes = torch.tensor([[[0.5, 0.1]], [[0.25, 0.1]], [[0.125, 0.1]]])
    codes = encode(COLOUR, planes, "png8")
    assert codes.high == (0.5,) * 3


def test_half_is_numpys_half_and_float_is_exact():
    value = torch.randn(1, 9, 9) * 100
    halves = torch.from_numpy(value.numpy().astype(np.float16).astype(np.float32))
    assert torch.equal(decode(encode(PLAIN, value, "half")), halves)
    assert torch.equal(decode(encode(PLAIN, value, "float")), value)


def test_half_overflow_is_an_error():
    assert float(decode(encode(PLAIN, _column(65504.0), "half"))) == 65504
    for value in (65505.0, -1e6):
        with pytest.raises(RangeError, match=r"residual must fit float16; its largest .*Store this map as float"):
            encode(PLAIN, _column(value), "half")
    assert float(decode(encode(PLAIN, _column(1e30), "float"))) == pytest.approx(1e30)
    with pytest.raises(RangeError, match=r"residual must fit float32; .* Divide it by a constant"):
        encode(PLAIN, _column(1e30).double() * 1e30, "float")


@pytest.mark.parametrize("storage", STORAGES)
@pytest.mark.parametrize("most, dtype", [(255, np.uint8), (256, np.uint16), (65535, np.uint16)])
def test_indices_are_stored_exactly_whatever_the_storage(storage, most, dtype):
    spec = MapSpec("index", "", layer_channels=1, low=0.0, high=float(most), index=True)
    value = torch.tensor([0.0, 1.0, most - 1, most]).reshape(1, 2, 2)
    codes = encode(spec, value, storage)
    assert codes.pixels.dtype == dtype
    assert torch.equal(decode(codes), value)
    with pytest.raises(RangeError, match="index must hold whole numbers"):
        encode(spec, value + torch.tensor([0, 0, -0.25, 0]).reshape(1, 2, 2), storage)


@pytest.mark.parametrize("storage", STORAGES)
def test_outside_the_declared_range_is_an_error_not_a_clip(storage):
    for spec, bad in ((COLOUR, -1e-6), (NORMAL, 1.001), (NORMAL, -1.001)):
        planes = _column(0.5, bad, channels=3)
        with pytest.raises(RangeError, match=rf"export: {spec.name} must lie in .*3 of 6 values are not.*never clipped"):
            encode(spec, planes, storage)
    with pytest.raises(RangeError, match="residual must be finite"):
        encode(PLAIN, _column(float("nan")), storage)


def test_range_messages_name_the_bounds():
    with pytest.raises(RangeError, match=r"albedo must lie in \[0\.0, inf\]; 1 of 3 values are not, the first is -2\."):
        check_map("here", COLOUR, torch.tensor([1.0, 0.0, -2.0]).reshape(3, 1, 1))
    ceiling = MapSpec("m", "", high=0.0)
    with pytest.raises(RangeError, match=r"m must lie in \[-inf, 0\.0\]; 1 of 3"):
        check_map("here", ceiling, torch.tensor([-1.0, 0.0, 2.0]).reshape(3, 1, 1))


def test_unknown_storage():
    with pytest.raises(RangeError, match=r"storage must be one of .*Did you mean 'half'\?"):
        encode(PLAIN, _column(0.0), "halff")


@pytest.mark.parametrize("storage", STORAGES)
def test_extreme_but_allowed_values(storage):
    value = _column(0.0, 1e-8, 1e-4, 1.0, 1e4)
    found = decode(encode(PLAIN, value, storage))
    assert bool(torch.isfinite(found).all())
    span = 2e4 if STORAGES[storage].natural else 1e4  # as far below 0 as above
    bound = {"half": 1e4 * 2**-11, "float": 1e-3}.get(storage, span / (STORAGES[storage].levels or 1) / 2 * 1.001)
    assert_same(found, value, bound / 1e4)


def test_names_of_layers():
    spec = MapSpec("residual", "", layers=("hx", "hy"), layer_channels=3)
    assert spec.textures == ("residual_hx", "residual_hy")
    assert spec.channels == 6
    assert PLAIN.textures == ("residual",)
