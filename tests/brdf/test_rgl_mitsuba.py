"""The eight files of the RGL database against Mitsuba's `measured`, which shares nothing with the package."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tests.brdf.directions import near_mirror, planes, random_directions
from tests.brdf.files import rgl_fields, write_tensor_file
from tests.support import shared_path

from torchmat import load_brdf
from torchmat.brdf.spectral import matching_functions, rgb_weights

mi = pytest.importorskip("mitsuba", reason="Mitsuba is not installed: pip install 'torchmat[mitsuba]'")
pytestmark = pytest.mark.usefixtures("variant")

FILES = (
    "acrylic_felt_purple", "cardboard", "cc_iris_purple_gem", "chm_mint", "irid_flake_paint2", "leaf_maple",
    "satin_rosaline", "vch_golden_yellow",
)
PAIRS = 2000


def evaluated(path, light: np.ndarray, view: np.ndarray) -> np.ndarray:
    """Return pi times what Mitsuba gives a path that comes from the view and goes on to the light, [n, 3]."""
    bsdf = mi.load_dict({"type": "measured", "filename": str(path)})
    context, place = mi.BSDFContext(), mi.SurfaceInteraction3f()
    found = np.empty((len(light), 3))
    for row, (toward, away) in enumerate(zip(light, view, strict=True)):
        place.wi = mi.Vector3f(*away)
        found[row] = np.array(bsdf.eval(context, place, mi.Vector3f(*toward))).ravel()
    return np.pi * found


def pairs() -> tuple[np.ndarray, np.ndarray]:
    """Return directions all over the hemisphere, half of the views near the mirror direction."""
    light = random_directions(PAIRS, 1, 0.0)
    return light, np.concatenate((near_mirror(light[: PAIRS // 2], 2), random_directions(PAIRS // 2, 3, 0.0)))


@pytest.mark.parametrize("name", FILES)
def test_files_of_the_database(name):
    path = shared_path(f"real/rgl/{name}_rgb.bsdf")
    light, view = pairs()
    expected = evaluated(path, light, view)
    for dtype in (torch.float32, torch.float64):
        found = load_brdf(path, dtype).value(planes(light, dtype), planes(view, dtype))[:, :, 0, 0].double().numpy()
        # Relative to the value, or to a thousandth of the mean where it is smaller; Mitsuba computes in float32.
        # Measured over the eight files: 6.2e-4 at worst, in the near-mirror chm_mint, and 3.3e-6 on average.
        relative = np.abs(found - expected) / np.maximum(np.abs(expected), 1e-3 * np.abs(expected).mean())
        assert relative.max() < 2e-3 and relative.mean() < 1e-5
        assert np.abs(expected).max() > 0.3


# Not two azimuths: such a file counts as isotropic, and Mitsuba 3.9 then reads a number that it never sets.
@pytest.mark.parametrize("azimuths, turn", [(5, 2 * np.pi), (4, np.pi), (3, np.pi / 2)])
def test_made_up_anisotropic_files(tmp_path, azimuths, turn):
    path = write_tensor_file(tmp_path / "made_up.bsdf", rgl_fields(azimuths, turn))
    light, view = (d[::8] for d in pairs())
    expected = evaluated(path, light, view)
    found = load_brdf(path, torch.float64).shade(planes(light), planes(view))[:, :, 0, 0].numpy()
    assert np.abs(found - expected).max() < 1e-4 * expected.max()  # float32 there: measured 1e-5


def test_matching_functions_against_the_tables_of_the_standard():
    wavelengths = np.arange(380.0, 781.0, 5)
    standard = np.array([np.array(mi.cie1931_xyz(float(w))).ravel() for w in wavelengths]).T
    found = matching_functions(torch.from_numpy(wavelengths)).numpy()
    assert np.abs(found - standard).max() < 0.025  # of 1.78: what the fit is worth


def test_colours_of_spectra_against_the_tables_of_the_standard():
    wavelengths = np.arange(360.0, 831.0, 5)
    bell = np.exp(-0.5 * ((wavelengths - 535) / 40) ** 2)
    weights = rgb_weights(torch.from_numpy(wavelengths)).numpy()
    for spectrum in (np.ones_like(bell), 0.1 + 0.6 * bell, 0.7 - 0.6 * bell, 0.2 + 0.4 * (wavelengths - 360) / 470):
        standard = mi.spectrum_list_to_srgb(list(wavelengths), list(spectrum), bounded=False, d65=True)
        assert np.abs(weights @ spectrum - np.array(standard).ravel()).max() < 3e-3  # measured 1.3e-3
