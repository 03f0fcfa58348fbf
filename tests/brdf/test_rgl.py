"""Measured BRDFs of the RGL kind, made up by the tests: against explicit integrals, symmetries, hard cases, spectra."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from tests.brdf.directions import HARD_PAIRS, graze, near_mirror, planes, random_directions, shade_and_differentiate
from tests.brdf.files import rgl_fields, write_tensor_file
from tests.reference.brdf import rgl
from tests.support import assert_close

from torchmat import load_brdf
from torchmat.brdf import RglBrdf
from torchmat.brdf.spectral import d65, matching_functions, rgb_weights
from torchmat.brdf.warp import Grid, Slices, Warp, find_slices
from torchmat.errors import RangeError, ShapeError

KINDS = {
    "isotropic": {},
    "isotropic_with_two_azimuths": {"azimuths": 2},
    "whole_value": {"jacobian": 0},
    "anisotropic": {"azimuths": 5},
    "anisotropic_half": {"azimuths": 4, "turn": math.pi},
    "anisotropic_quarter": {"azimuths": 3, "turn": math.pi / 2},
}
every_kind = pytest.mark.parametrize("kind", KINDS)
ONE = Slices((torch.tensor(0),), (torch.tensor(1.0, dtype=torch.float64),))


def load(tmp_path, dtype=torch.float64, **choices):
    return load_brdf(write_tensor_file(tmp_path / "made up.bsdf", rgl_fields(**choices)), dtype)


@every_kind
def test_values_match_explicit_integrals(tmp_path, kind, dtype):
    brdf = load(tmp_path, dtype, **KINDS[kind])
    assert isinstance(brdf, RglBrdf) and brdf.dtype == dtype and brdf.description == "Made up"
    assert brdf.isotropic == kind.startswith(("isotropic", "whole"))
    light = random_directions(14, 1)
    view = np.concatenate((near_mirror(light[:7], 2), random_directions(7, 3)))
    found = brdf.shade(planes(light, dtype), planes(view, dtype))[:, :, 0, 0]
    rows = zip(planes(light, dtype)[:, :, 0, 0].tolist(), planes(view, dtype)[:, :, 0, 0].tolist(), strict=True)
    expected = torch.tensor([rgl(rgl_fields(**KINDS[kind]), *row) for row in rows], dtype=torch.float64)
    assert_close(found.double(), expected, 2e-5 if dtype == torch.float32 else 1e-12)


def test_a_uniform_density_is_not_moved():
    warp = Warp(torch.ones(1, 4, 6), torch.float64)
    x, y = torch.rand(2, 50, dtype=torch.float64)
    across, down = warp.invert(x, y, ONE)
    assert_close(across, x, 1e-12)
    assert_close(down, y, 1e-12)


def test_a_ramp_is_warped_by_its_square_by_hand():
    # f = x over the square: the integral up to x is x^2, the same in every row.
    ramp = torch.linspace(0, 1, 5, dtype=torch.float64).expand(1, 3, 5)
    x, y = torch.rand(2, 50, dtype=torch.float64)
    across, down = Warp(ramp, torch.float64).invert(x, y, ONE)
    assert_close(across, x * x, 1e-12)
    assert_close(down, y, 1e-12)
    across, down = Warp(ramp.transpose(1, 2), torch.float64).invert(y, x, ONE)
    assert_close(across, y, 1e-12)
    assert_close(down, x * x, 1e-12)


def test_the_ends_of_the_square_stay_in_place(dtype):
    warp = Warp(torch.rand(2, 5, 4, dtype=torch.float64), dtype)
    slices = find_slices((torch.tensor([0.0, 1.0], dtype=dtype),), (torch.tensor([0.3] * 4, dtype=dtype),))
    x, y = torch.tensor([[0.0, 1, 0, 1], [0, 0, 1, 1]], dtype=dtype)
    across, down = warp.invert(x, y, slices)
    assert_close(across, x, 1e-6)
    assert_close(down, y, 1e-6)


def test_a_density_of_nothing_gives_zeros():
    across, down = Warp(torch.zeros(1, 3, 3), torch.float32).invert(*torch.rand(2, 7), ONE)
    assert not bool(across.any()) and not bool(down.any())


def test_a_grid_with_channels_is_each_of_them():
    values = torch.rand(1, 3, 4, 2, dtype=torch.float64)
    x, y = torch.rand(2, 5, 6, dtype=torch.float64)
    both = Grid(values).at(x, y, ONE)
    for channel in range(2):
        assert_close(both[..., channel], Grid(values[..., channel]).at(x, y, ONE), 1e-12)
    assert_close(Grid(values).at(torch.tensor(1.0).double(), torch.tensor(0.5).double(), ONE), values[0, 1, 3], 1e-12)


@pytest.mark.parametrize("kind", ["isotropic", "whole_value"])
def test_isotropic_ones_do_not_turn(tmp_path, kind):
    brdf = load(tmp_path, **KINDS[kind])
    light, view = random_directions(20, 4), random_directions(20, 5)
    turn = np.array([[0.6, 0.8, 0], [-0.8, 0.6, 0], [0, 0, 1]])
    found = brdf.shade(planes(light @ turn), planes(view @ turn))
    assert_close(found, brdf.shade(planes(light), planes(view)), 1e-9)


@pytest.mark.parametrize("kind, mirrored", [("anisotropic_half", (-1, -1, 1)), ("anisotropic_quarter", (-1, 1, 1))])
def test_a_part_of_the_azimuths_stands_for_all(tmp_path, kind, mirrored):
    brdf = load(tmp_path, **KINDS[kind])
    light, view = random_directions(20, 6), random_directions(20, 7)
    found = brdf.shade(planes(light * mirrored), planes(view * mirrored))
    assert_close(found, brdf.shade(planes(light), planes(view)), 1e-12)


def test_one_view_serves_many_lights(tmp_path):
    brdf = load(tmp_path, **KINDS["anisotropic"])
    light, view = planes(random_directions(12, 8)), planes(random_directions(1, 9))
    together = brdf.shade(light[:, :, 0, 0].T.reshape(3, 3, 4), view[0])
    assert together.shape == (3, 3, 4)
    apart = brdf.shade(light, view.expand(12, -1, -1, -1))[:, :, 0, 0]
    assert_close(together.flatten(1).T, apart, 1e-12)


@every_kind
def test_gradcheck(tmp_path, kind):
    brdf = load(tmp_path, **KINDS[kind])
    light, view = (planes(random_directions(3, seed, 0.2)).requires_grad_() for seed in (10, 11))
    assert torch.autograd.gradcheck(brdf.shade, (light, view))


# Where half vector and view have an azimuth that rounding does not change, and those where float64 still tells it.
SETTLED = ("light_is_view", "light_at_normal_view_at_horizon", "both_at_horizon_same_side", "both_at_horizon_across")
IN_FLOAT64 = (*SETTLED, "mirror_pair", "both_at_horizon_opposite")


@every_kind
def test_case_1_values_at_hard_directions_match_integrals_or_the_bounds_of_the_table_and_gradients_are_finite(tmp_path, kind, dtype):
    brdf, fields = load(tmp_path, dtype, **KINDS[kind]), rgl_fields(**KINDS[kind])
    rgb, facets = fields["rgb"], fields["ndf"] if fields["jacobian"][0] else np.array(4.0)
    shadowing = fields["sigma"] if fields["jacobian"][0] else np.array(1.0)
    settled = SETTLED if dtype == torch.float32 else IN_FLOAT64
    for pair, directions in HARD_PAIRS.items():
        found = shade_and_differentiate(brdf, *directions, dtype)[:, 0, 0].double().numpy()
        if pair in settled:
            # At mirrored directions the oracle's acos has half of its digits.
            bound = 2e-5 if dtype == torch.float32 else 1e-9 if pair in SETTLED else 1e-5
            np.testing.assert_allclose(found, rgl(fields, *directions), rtol=bound, err_msg=pair)
        else:  # the azimuth is open: any of the table's entries may count, and nothing beyond them
            low, high = (math.pi * getattr(rgb, end)() * getattr(facets, end)() / 4 for end in ("min", "max"))
            assert (found >= 0.999 * low / shadowing.max()).all() and (found <= 1.001 * high / shadowing.min()).all(), pair


@every_kind
def test_case_1_below_the_horizon_is_black_without_gradient(tmp_path, kind):
    light = planes([(0.6, 0, -0.8), (0.6, 0, 0.8), (1, 0, 0)]).requires_grad_()
    view = planes([(0, 0.6, 0.8), (0, 0.6, -0.8), (0, 0, 1)]).requires_grad_()
    found = load(tmp_path, **KINDS[kind]).shade(light, view)
    assert not bool(found.any())
    found.sum().backward()
    assert not bool(light.grad.any()) and not bool(view.grad.any())


def test_case_2_value_is_continuous_on_the_way_into_the_horizon(tmp_path):
    heights = [10.0**-k for k in range(2, 9)]
    light, view = (planes([graze(a, h) for h in heights]) for a in (0.3, 0.8))
    steps = load(tmp_path).shade(light, view).diff(dim=0).abs().amax(dim=(1, 2, 3))
    assert float(steps[-1]) < 1e-3
    assert float(steps[-1]) <= float(steps[0])


@pytest.mark.parametrize("kind", ["isotropic", "anisotropic"])
def test_case_5_azimuth_zero_is_a_full_turn(tmp_path, kind):
    brdf = load(tmp_path, **KINDS[kind])
    fixed = planes([graze(1.0, 0.7)])
    for azimuth in (0.0, math.pi, 1.0, 1.0 + math.pi):  # of the axes, of the files' ends, and of the other direction
        turning = planes([graze(azimuth - 1e-8, 0.5), graze(azimuth + 1e-8, 0.5)])
        for found in (brdf.shade(turning, fixed), brdf.shade(fixed, turning)):
            assert_close(found[0], found[1], 1e-6)


def test_negative_colours_count_as_black(tmp_path):
    fields = rgl_fields()
    fields["rgb"][:, :, 1] *= -1
    brdf = load_brdf(write_tensor_file(tmp_path / "x.bsdf", fields), torch.float64)
    light, view = planes(random_directions(9, 12)), planes(random_directions(9, 13))
    found = brdf.shade(light, view)
    assert bool((found[:, 0] > 0).all()) and not bool(found[:, 1].any())
    assert bool((brdf.value(light, view)[:, 1] < 0).all())


def spectral_fields(reflectance, wavelengths, **choices):
    """Replace the colours of a made-up file by one spectrum everywhere."""
    fields = rgl_fields(**choices)
    shape = fields.pop("rgb").shape
    spectra = np.broadcast_to(reflectance[None, None, :, None, None], (*shape[:2], len(wavelengths), *shape[3:]))
    spectra = np.ascontiguousarray(spectra, np.float32)
    return {**fields, "wavelengths": wavelengths.astype(np.float32), "spectra": spectra}


@pytest.mark.parametrize("wavelengths", [np.arange(360, 1001, 3.3), np.array([400.0, 500, 520, 610, 700])])
def test_a_white_spectrum_is_white(tmp_path, wavelengths):
    fields = spectral_fields(np.ones(len(wavelengths)), wavelengths, jacobian=0)
    path = write_tensor_file(tmp_path / "white.bsdf", fields)
    found = load_brdf(path, torch.float64).shade(planes(random_directions(9, 14)), planes(random_directions(9, 15)))
    assert_close(found, torch.full_like(found, math.pi), 1e-6)


def test_spectra_become_their_colours_at_every_place(tmp_path):
    wavelengths = np.linspace(380, 730, 36)
    random = np.random.default_rng(16).uniform(0, 1, (1, 4, 36, 4, 4)).astype(np.float32)
    fields = {**spectral_fields(np.ones(36), wavelengths), "spectra": random}
    weights = rgb_weights(torch.from_numpy(wavelengths.astype(np.float32)).double()).numpy()
    colours = np.einsum("cw,ptwij->ptcij", weights, random.astype(np.float64)).astype(np.float32)
    spectral = load_brdf(write_tensor_file(tmp_path / "spectral.bsdf", fields), torch.float64)
    light, view = planes(random_directions(9, 17)), planes(random_directions(9, 18))
    plain = {k: v for k, v in fields.items() if k not in ("spectra", "wavelengths")} | {"rgb": colours}
    expected = load_brdf(write_tensor_file(tmp_path / "rgb.bsdf", plain), torch.float64)
    assert_close(spectral.value(light, view), expected.value(light, view), 1e-5)


def test_narrow_bands_have_the_colours_that_people_see():
    wavelengths = torch.arange(380, 781, 5, dtype=torch.float64)
    red, green, blue = rgb_weights(wavelengths)
    assert_close(torch.stack((red, green, blue)).sum(dim=1), torch.ones(3, dtype=torch.float64))
    for row, low, high in ((red, 590, 630), (green, 520, 560), (blue, 430, 470)):
        assert low <= float(wavelengths[row.argmax()]) <= high
    assert float(red[(wavelengths == 500)]) < 0 < float(green[(wavelengths == 500)])  # outside of the gamut of sRGB


def test_the_observer_and_the_light_by_the_standard():
    # CIE 1931 at 450, 550, 600 nm (CIE 015): the fit is off by at most 1.5 % of the largest value.
    found = matching_functions(torch.tensor([450.0, 550.0, 600.0]).double())
    expected = torch.tensor([[0.3362, 0.4334, 1.0622], [0.0380, 0.9950, 0.6310], [1.7721, 0.0087, 0.0008]]).double()
    assert_close(found, expected, 0.015)
    assert d65(torch.tensor([560.0, 565.0, 379.0, 790.0])).tolist() == pytest.approx([100, 98.165, 0, 0])


@pytest.mark.parametrize(
    "error, words, changes",
    [
        (ShapeError, r"ndf must be \[rows, columns\]", {"ndf": torch.ones(1, 5)}),
        (ShapeError, "sigma must be", {"sigma": torch.ones(5)}),
        (ShapeError, r"vndf must be \[1, 4, rows", {"vndf": torch.ones(1, 3, 5, 5)}),
        (ShapeError, r"colours must be \[1, 4, 3", {"colours": torch.ones(1, 4, 2, 5, 5)}),
        (RangeError, "ndf must be finite; 4 of 4", {"ndf": torch.full((2, 2), math.nan)}),
    ],
)
def test_bad_arrays_are_refused_by_name(error, words, changes):
    fields = {name: torch.from_numpy(array) for name, array in rgl_fields().items() if name != "description"}
    parts = {"ndf": fields["ndf"], "sigma": fields["sigma"], "vndf": fields["vndf"], "colours": fields["rgb"]}
    parts |= changes
    with pytest.raises(error, match=words):
        RglBrdf(fields["theta_i"], fields["phi_i"], **parts)
