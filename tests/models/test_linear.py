"""Texture, Lambert, PTM, LPTM and HSH by hand."""

from __future__ import annotations

import math

import pytest
import torch
from tests.models.examples import assert_same, make, make_maps

from torchmat.errors import RangeError
from torchmat.models import Hsh, Lambert, Lptm, Ptm, Texture
from torchmat.models.bases import BASES

LIGHT = (0.6, 0.08, math.sqrt(1 - 0.36 - 0.0064))


def _direction(values, dtype=torch.float64):
    return torch.tensor(values, dtype=dtype)[:, None, None]


def _map(*values, dtype=torch.float64):
    return torch.tensor(values, dtype=dtype)[:, None, None]


POLE = _direction((0.0, 0.0, 1.0))


def test_texture():
    material = Texture({"albedo": _map(0.2, 0.4, 0.6)})
    assert_same(material.shade(_direction((0.6, 0.0, 0.8)), POLE), _map(0.16, 0.32, 0.48))
    assert_same(material.shade(POLE, POLE), _map(0.2, 0.4, 0.6))


def test_lambert():
    material = Lambert({"albedo": _map(0.5, 1.0, 2.0), "normal": _map(0.6, 0.0, 0.8)})
    assert_same(material.shade(_direction((0.6, 0.0, 0.8)), POLE), _map(0.5, 1.0, 2.0))
    assert_same(material.shade(POLE, POLE), _map(0.4, 0.8, 1.6))


def test_lambert_normals_are_normalised_and_facing_away_is_dark():
    material = Lambert({"albedo": _map(1.0, 1.0, 1.0), "normal": _map(0.3, 0.0, 0.4)})
    assert_same(material.shade(POLE, POLE), _map(0.8, 0.8, 0.8))
    assert not bool(material.shade(_direction((-0.96, 0.0, 0.28)), POLE).any())


def test_a_zero_normal_is_dark_with_finite_gradients():
    material = Lambert({"albedo": _map(1.0, 1.0, 1.0), "normal": _map(0.0, 0.0, 0.0)})
    value = material.shade(POLE, POLE)
    value.sum().backward()
    assert not bool(value.any())
    assert bool(torch.isfinite(material.maps["normal"].grad).all())


@pytest.mark.parametrize(("code", "light"), [(-0.5, 0.0), (0.0, 0.0), (0.02, 0.02 / 12.92), (1.0, 1.0), (2.0, (2.055 / 1.055) ** 2.4)])
def test_sums_in_codes_are_decoded_and_black_below_zero(code, light):
    coefficients = torch.zeros(18, 1, 1, dtype=torch.float64)
    coefficients[15:] = code  # the constant term
    material = Ptm({"polynomial": coefficients}, space="srgb")
    assert_same(material.shade(_direction(LIGHT), POLE), _map(light, light, light))
    material.shade(_direction(LIGHT), POLE).sum().backward()
    assert bool(torch.isfinite(material.maps["polynomial"].grad).all())


def test_a_material_that_says_no_space_is_linear():
    assert Ptm({"polynomial": torch.zeros(18, 1, 1)}).options["space"] == "linear"


def test_ptm():
    coefficients = torch.zeros(18, 1, 1, dtype=torch.float64)
    for term, number in enumerate((1.0, 2.0, 3.0, 4.0, 5.0, 6.0)):
        coefficients[3 * term] = number  # red only
    value = Ptm({"polynomial": coefficients}).shade(_direction(LIGHT), POLE)
    assert_same(value, _map(0.36 + 2 * 0.0064 + 3 * 0.048 + 4 * 0.6 + 5 * 0.08 + 6, 0, 0))


def test_lptm():
    luminance = _map(1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
    value = Lptm({"luminance": luminance, "chroma": _map(0.5, 0.25, 0.0)}).shade(_direction(LIGHT), POLE)
    shared = 0.36 + 2 * 0.0064 + 3 * 0.048 + 4 * 0.6 + 5 * 0.08 + 6
    assert_same(value, _map(0.5 * shared, 0.25 * shared, 0))
    negative = Lptm({"luminance": -luminance, "chroma": _map(0.5, 0.25, 0.0)})
    assert not bool(negative.shade(_direction(LIGHT), POLE).any())


@pytest.mark.parametrize("terms", [4, 9, 16])
def test_hsh(terms):
    harmonic = torch.zeros(3 * terms, 1, 1, dtype=torch.float64)
    harmonic[1] = 2.0  # green of the constant term
    value = Hsh({"harmonic": harmonic}, terms=terms).shade(_direction(LIGHT), POLE)
    assert_same(value, _map(0, 2 / math.sqrt(2 * math.pi), 0))


def test_hsh_terms():
    maps = make_maps("hsh", {"terms": 9})
    assert Hsh(maps).options == {"terms": 9, "space": "linear"}
    with pytest.raises(RangeError, match="terms must be one of 4, 9, 16; it is 5"):
        Hsh(maps, terms=5)
    assert_same(Hsh(maps, terms=9.0).shade(POLE, POLE), Hsh(maps).shade(POLE, POLE))


@pytest.mark.parametrize("name", ["texture", "lambert", "ptm", "lptm", "hsh"])
def test_none_of_them_sees_the_view(name):
    material = make(name, {})
    views = _direction((0.6, 0.0, 0.8)), _direction((0.0, -0.8, 0.6))
    assert torch.equal(*(material.shade(_direction(LIGHT), view) for view in views))


def test_bytes_per_texel_in_half_precision():
    sizes = {"texture": 6, "lambert": 12, "ptm": 36, "lptm": 18, "hsh": 54}
    assert {name: make(name, {}).bytes_per_texel for name in sizes} == sizes


def test_textures_have_the_terms_names():
    names = [name for _, name, *_ in make("ptm", {}).textures()]
    assert names == [f"polynomial_{term}" for term in BASES["polynomial"].terms]
