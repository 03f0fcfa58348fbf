"""sRGB, Lab and CIEDE2000."""

from __future__ import annotations

import pytest
import torch
from tests.reference import colour as oracle
from tests.support import assert_close

from torchmat import colour

# Sharma, Wu, Dalal 2005, table 1: L, a, b of both colours and the difference, printed to 4 decimals.
SHARMA = [
    (50.0000, 2.6772, -79.7751, 50.0000, 0.0000, -82.7485, 2.0425),
    (50.0000, 3.1571, -77.2803, 50.0000, 0.0000, -82.7485, 2.8615),
    (50.0000, 2.8361, -74.0200, 50.0000, 0.0000, -82.7485, 3.4412),
    (50.0000, -1.3802, -84.2814, 50.0000, 0.0000, -82.7485, 1.0000),
    (50.0000, -1.1848, -84.8006, 50.0000, 0.0000, -82.7485, 1.0000),
    (50.0000, -0.9009, -85.5211, 50.0000, 0.0000, -82.7485, 1.0000),
    (50.0000, 0.0000, 0.0000, 50.0000, -1.0000, 2.0000, 2.3669),
    (50.0000, -1.0000, 2.0000, 50.0000, 0.0000, 0.0000, 2.3669),
    (50.0000, 2.4900, -0.0010, 50.0000, -2.4900, 0.0009, 7.1792),
    (50.0000, 2.4900, -0.0010, 50.0000, -2.4900, 0.0010, 7.1792),
    (50.0000, 2.4900, -0.0010, 50.0000, -2.4900, 0.0011, 7.2195),
    (50.0000, 2.4900, -0.0010, 50.0000, -2.4900, 0.0012, 7.2195),
    (50.0000, -0.0010, 2.4900, 50.0000, 0.0009, -2.4900, 4.8045),
    (50.0000, -0.0010, 2.4900, 50.0000, 0.0010, -2.4900, 4.8045),
    (50.0000, -0.0010, 2.4900, 50.0000, 0.0011, -2.4900, 4.7461),
    (50.0000, 2.5000, 0.0000, 50.0000, 0.0000, -2.5000, 4.3065),
    (50.0000, 2.5000, 0.0000, 73.0000, 25.0000, -18.0000, 27.1492),
    (50.0000, 2.5000, 0.0000, 61.0000, -5.0000, 29.0000, 22.8977),
    (50.0000, 2.5000, 0.0000, 56.0000, -27.0000, -3.0000, 31.9030),
    (50.0000, 2.5000, 0.0000, 58.0000, 24.0000, 15.0000, 19.4535),
    (50.0000, 2.5000, 0.0000, 50.0000, 3.1736, 0.5854, 1.0000),
    (50.0000, 2.5000, 0.0000, 50.0000, 3.2972, 0.0000, 1.0000),
    (50.0000, 2.5000, 0.0000, 50.0000, 1.8634, 0.5757, 1.0000),
    (50.0000, 2.5000, 0.0000, 50.0000, 3.2592, 0.3350, 1.0000),
    (60.2574, -34.0099, 36.2677, 60.4626, -34.1751, 39.4387, 1.2644),
    (63.0109, -31.0961, -5.8663, 62.8187, -29.7946, -4.0864, 1.2630),
    (61.2901, 3.7196, -5.3901, 61.4292, 2.2480, -4.9620, 1.8731),
    (35.0831, -44.1164, 3.7933, 35.0232, -40.0716, 1.5901, 1.8645),
    (22.7233, 20.0904, -46.6940, 23.0331, 14.9730, -42.5619, 2.0373),
    (36.4612, 47.8580, 18.3852, 36.2715, 50.5065, 21.2231, 1.4146),
    (90.8027, -2.0831, 1.4410, 91.1528, -1.6435, 0.0447, 1.4441),
    (90.9257, -0.5406, -0.9208, 88.6381, -0.8985, -0.7239, 1.5381),
    (6.7747, -0.2908, -2.4247, 5.8714, -0.0985, -2.2286, 0.6377),
    (2.0776, 0.0795, -1.1350, 0.9033, -0.0636, -0.5514, 0.9082),
]


def _plane(*values, dtype=torch.float64) -> torch.Tensor:
    return torch.tensor(values, dtype=dtype).reshape(3, 1, 1)


def test_the_article_has_34_pairs():
    assert len(SHARMA) == 34


@pytest.mark.parametrize("row", SHARMA, ids=range(1, 35))
def test_ciede2000_meets_sharma_wu_dalal(row):
    first, second = _plane(*row[:3]), _plane(*row[3:6])
    for one, other in ((first, second), (second, first)):
        assert abs(float(colour.ciede2000(one, other)) - row[6]) < 1e-4


def test_ciede2000_of_all_pairs_at_once_and_in_float32():
    table = torch.tensor(SHARMA, dtype=torch.float32)
    found = colour.ciede2000(table[:, :3].reshape(34, 3, 1, 1), table[:, 3:6].reshape(34, 3, 1, 1))
    assert found.shape == (34, 1, 1)
    assert float((found[:, 0, 0] - table[:, 6]).abs().max()) < 1e-4  # measured 5e-5, the rounding of the table


def test_ciede2000_of_equal_and_grey_colours(dtype):
    image = torch.rand(3, 4, 4, dtype=dtype) * 80
    assert float(colour.ciede2000(image, image).abs().max()) == 0
    grey = _plane(50, 0, 0, dtype=dtype)
    # Greys differ by lightness alone: |dL| / (1 + 0.015 (L - 50)^2 / sqrt(20 + (L - 50)^2)) at the mean L of 55.
    weight = 1 + 0.015 * 25 / 45**0.5
    assert_close(colour.ciede2000(grey, _plane(60, 0, 0, dtype=dtype)), torch.full((1, 1), 10 / weight, dtype=dtype))
    black, white = _plane(0, 0, 0, dtype=dtype), _plane(100, 0, 0, dtype=dtype)
    assert_close(colour.ciede2000(black, white), torch.full((1, 1), 100.0, dtype=dtype))


def test_srgb_formula(dtype):
    linear = torch.tensor([0, 1e-6, 0.001, 0.003, 0.0032, 0.01, 0.18, 0.5, 0.99, 1, 4.0], dtype=dtype)
    image = linear.expand(3, 1, -1)
    encoded = torch.tensor([oracle.encode(v) for v in linear.tolist()], dtype=dtype).expand(3, 1, -1)
    assert_close(colour.linear_to_srgb(image), encoded)
    assert_close(colour.srgb_to_linear(encoded), image)
    decoded = torch.tensor([oracle.decode(v) for v in linear.tolist()], dtype=dtype).expand(3, 1, -1)
    assert_close(colour.srgb_to_linear(image), decoded)


def test_srgb_known_values(dtype):
    # The two printed values of IEC 61966-2-1's ends, and middle grey.
    found = colour.linear_to_srgb(torch.tensor([0, 1, 0.2140411], dtype=dtype).reshape(3, 1, 1))
    assert_close(found[:, 0, 0], torch.tensor([0, 1, 0.5], dtype=dtype), 1e-6)


def test_display_clamps(dtype):
    image = torch.tensor([-1, 0.5, 3], dtype=dtype).reshape(3, 1, 1)
    assert_close(colour.display(image)[:, 0, 0], torch.tensor([0, oracle.encode(0.5), 1], dtype=dtype))


def test_all_eight_bit_codes_survive():
    codes = torch.arange(256).expand(3, 1, 256)
    linear = colour.srgb_to_linear(codes.float() / 255)
    assert torch.equal((colour.linear_to_srgb(linear) * 255).round().long(), codes)


def test_lab_matches_the_definition(dtype):
    linear = torch.tensor([[0, 0, 0], [1, 1, 1], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0.2, 0.5, 0.1], [0.004, 0.002, 0.001]])
    shown = torch.tensor([[oracle.encode(v) for v in row] for row in linear.double().tolist()], dtype=dtype)
    found = colour.srgb_to_lab(shown.T[:, None])[:, 0].T
    expected = torch.tensor([oracle.lab(*row) for row in linear.double().tolist()], dtype=dtype)
    # kornia rounds the matrix and the constants of the cube root: measured 0.0046 of a unit of Lab.
    assert float((found - expected).abs().max()) < 0.01


@pytest.mark.parametrize("scale", [1e-30, 1e-6, 1.0, 100.0, 1e4])
def test_ciede2000_is_the_same_with_and_without_gradients(scale, dtype):
    random = torch.Generator().manual_seed(0)
    first = scale * (torch.rand(3, 40, 50, dtype=dtype, generator=random) - 0.4)
    first[:, 0] = 0.0
    first[1:, 1] = -0.0
    second = first + 0.1 * scale * torch.rand(first.shape, dtype=dtype, generator=random)
    second[1:, 2] = 0.0
    plain, recorded = colour.ciede2000(first, second), colour.ciede2000(first.clone().requires_grad_(), second)
    assert recorded.requires_grad and not plain.requires_grad
    least = 1e-3 * scale  # below it two rounded colours are one
    error = (plain - recorded.detach()).abs() / recorded.detach().clamp(min=least)
    assert float(error.max()) < (1e-3 if dtype == torch.float32 else 1e-11)


def test_ciede2000_is_safe_within_transforms(dtype):
    grey = torch.zeros(3, 4, 5, dtype=dtype) + 40 * torch.tensor([1.0, 0, 0], dtype=dtype)[:, None, None]
    with torch.no_grad():  # what is recorded there does not show
        slope = torch.func.grad(lambda one: colour.ciede2000(one, grey).sum())(grey)
    assert bool(torch.isfinite(slope).all())
