"""Near lights in closed forms: each texel has equations of its own."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tests.btf.files import srgb_decoded
from tests.fitting.near_data import DOME, bumps, degrees, dome, lambert, places, scene, towards
from tests.support import assert_close

from torchmat import Btf, fit
from torchmat.btf.lambert import lambert_of, stereo_of, with_estimated_intensities
from torchmat.fitting.models import by_texel
from torchmat.fitting.training import Training, make_training
from torchmat.models.bases import BASES

SIZE = (6, 8)
FLAT = np.zeros(SIZE)
UP = np.stack((np.zeros(SIZE), np.zeros(SIZE), np.ones(SIZE)))
LIGHTS = dome(24)


def _values(name: str, coefficients: np.ndarray):
    """Return the function that gives values for a linear model's coefficients [K, 3, H, W]."""

    def of(light: np.ndarray) -> np.ndarray:
        view = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)[:, None, None]
        basis = BASES[name].evaluate(torch.from_numpy(light), view).numpy()
        return np.einsum("nkhw,kchw->nchw", basis, coefficients)

    return of


def _coefficients(terms: int) -> np.ndarray:
    random = np.random.default_rng(terms)
    found = random.uniform(-0.1, 0.1, (terms, 3, *SIZE))
    found[-1 if terms == 6 else 0] += 0.6
    return found


def _options(model: str, terms: int) -> dict:
    return {"hsh": {"terms": terms, "space": "linear"}, "ptm": {"space": "linear"}, "texture": {}}[model]


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("model, basis, terms, map_", [
    ("texture", "cosine", 1, "albedo"), ("ptm", "polynomial", 6, "polynomial"), ("hsh", "hsh9", 9, "harmonic"),
    ("hsh", "hsh16", 16, "harmonic"),
])
def test_coefficients_are_recovered(model, basis, terms, map_, dtype):
    truth = np.abs(_coefficients(terms))
    made = scene(_values(basis, truth), FLAT, UP, LIGHTS, np.float32 if dtype == torch.float32 else np.float64)
    result = fit(made.btf, model, holdout=0, dtype=dtype, storage="float", **_options(model, terms))
    expected = torch.from_numpy(truth.reshape(-1, *SIZE)).to(dtype)
    # Sixteen harmonics of 24 lights are nearly dependent in a texel beside the dome: float32 images hold no more.
    near = {16: 1e-3 if dtype == torch.float32 else 1e-9}.get(terms, 1e-5 if dtype == torch.float32 else 1e-9)
    assert_close(result.material.maps[map_], expected, near)
    assert float(result.coverage.min()) == 1
    values = made.btf.images(range(24), torch.float64)
    if float(values.min()) > 0:
        assert result.report["train"]["relative_error"] < 1e-8
    far = fit(made.far, model, holdout=0, dtype=dtype, storage="float", **_options(model, terms))
    off = float((far.material.maps[map_].detach() - expected).abs().max()) / float(expected.abs().max())
    assert off > (0.015 if terms == 1 else 0.1) and far.report["train"]["relative_error"] > 5e-4


def test_codes_of_a_screen_and_the_sums_of_lptm():
    codes = _values("polynomial", np.abs(_coefficients(6)))
    made = scene(lambda light: srgb_decoded(codes(light)), FLAT, UP, LIGHTS)
    near, far = (fit(data, "ptm", holdout=0.2, dtype=torch.float64).report["held_out"]["relative_error"] for data in (made.btf, made.far))
    assert near < 1e-8 and far > 1e-3
    albedo = np.random.default_rng(3).uniform(0.2, 0.8, (3, *SIZE))
    made = scene(lambert(albedo, UP), FLAT, UP, LIGHTS)
    chroma = fit(made.btf, "lptm", holdout=0, space="linear", dtype=torch.float64, storage="float").material.maps["chroma"].detach()
    assert_close(chroma / chroma.mean(dim=0), torch.from_numpy(albedo / albedo.mean(axis=0)), 1e-9)


def test_texels_that_samples_leave_open():
    """Without four lights in one texel 2 of 6 unknowns are open, and clipped ones do not count as determined."""
    made = scene(_values("polynomial", np.abs(_coefficients(6))), FLAT, UP, LIGHTS)
    images = made.btf._store.pixels
    weight = np.ones((24, 1, *SIZE), dtype=bool)
    weight[4:, :, 2, 3] = False
    weight[:, :, 0, 0] = False
    weight[5, :, 1, 1] = False
    btf = Btf.from_tensors(images, None, made.btf.view, weight, light_position=LIGHTS)
    result = fit(btf, "ptm", holdout=0, space="linear", dtype=torch.float64, storage="float")
    coverage = result.coverage[0]
    assert float(coverage[2, 3]) == pytest.approx(4 / 6) and float(coverage[0, 0]) == 0 and float(coverage[1, 1]) == 1
    assert int((coverage < 1).sum()) == 2
    found, truth = result.material.maps["polynomial"].detach().unflatten(0, (6, 3)), torch.from_numpy(np.abs(_coefficients(6)))
    assert torch.equal(found[..., 0, 0], torch.zeros(6, 3, dtype=torch.float64))
    assert_close(found[..., 1, 1], truth[..., 1, 1], 1e-9)
    basis = BASES["polynomial"].evaluate(btf.directions(range(4), torch.float64)[0], torch.tensor([0.0, 0, 1])[:, None, None].double())[:, :, 2, 3]
    least = torch.linalg.pinv(basis) @ basis @ truth[..., 2, 3]
    assert_close(found[..., 2, 3], least, 1e-6)


def test_strips_and_runs_of_samples_change_nothing(monkeypatch):
    made = scene(_values("hsh9", _coefficients(9)), FLAT, UP, LIGHTS)
    maps = []
    for texels, values in ((16384, 4_000_000), (16, 16 * 9 * 5)):
        monkeypatch.setattr(by_texel, "_TEXELS", texels)
        monkeypatch.setattr(by_texel, "_VALUES", values)
        maps.append(fit(made.btf, "hsh", space="linear", dtype=torch.float64, storage="float", measure="none").material.maps["harmonic"].detach())
    assert_close(maps[1], maps[0], 1e-10)


def test_windows_are_parts_of_the_whole():
    made = scene(lambert(np.full((3, *SIZE), 0.5), UP), FLAT, UP, LIGHTS)
    whole, part = (fit(data, "ptm", holdout=0, dtype=torch.float64, measure="none").material.maps["polynomial"].detach()
                   for data in (made.btf, made.btf.window(1, 2, 4, 5)))
    assert_close(part, whole[:, 1:5, 2:7], 1e-9)


def test_far_positions_fit_as_directions_do():
    made = scene(_values("polynomial", np.abs(_coefficients(6))), FLAT, UP, 1e6 * LIGHTS / DOME, np.float32)
    near, far = (fit(data, "ptm", holdout=0, space="linear", storage="float").material.maps["polynomial"] for data in (made.btf, made.far))
    assert_close(near, far, 1e-5)


def test_near_cameras_fit_what_depends_on_the_view():
    view = dome(24, 1.5, 40)
    light = LIGHTS[::-1] / DOME
    gap, _ = towards(view, FLAT)
    half = gap + light[:, :, None, None]
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    truth = np.abs(_coefficients(9))[:3]
    images = np.einsum("nkhw,kchw->nchw", half, truth)
    btf = Btf.from_tensors(images, light.copy(), None, view_position=view)
    found = by_texel.fit_texels(_training(btf), 3, BASES["half"].evaluate).fit
    assert_close(found.coefficients, torch.from_numpy(truth), 1e-9)


def _training(btf: Btf) -> Training:
    return make_training(btf, torch.arange(len(btf)), 0, True, torch.float64, False)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_normals_under_a_near_dome(dtype):
    """A flat wall 30 cm wide under a dome of 80 cm, and bumps on it."""
    made = scene(lambert(np.full((3, 12, 16), 0.5), _up(12, 16)), np.zeros((12, 16)), _up(12, 16), LIGHTS)
    rows = torch.arange(len(made.btf))
    near, far = (degrees(stereo_of(data, rows, dtype).normal, made.normal) for data in (made.btf, made.far))
    assert near.max() < (0.05 if dtype == torch.float32 else 1e-4) and far.mean() > 8
    z, normal = bumps(12, 16, 0.02)
    rough = scene(lambert(0.3 + 0.2 * np.cos(9 * places(12, 16)[:1]) + np.zeros((3, 1, 1)), normal), z, normal, LIGHTS)
    near, far = (degrees(stereo_of(data, rows, dtype).normal, normal) for data in (rough.btf, rough.far))
    assert near.mean() < 0.25 * far.mean()
    assert lambert_of(rough.btf).residual < 0.02 < 0.05 < lambert_of(rough.far).residual


def _up(height, width):
    return np.stack((np.zeros((height, width)), np.zeros((height, width)), np.ones((height, width))))


def test_lambert_fits_normals_and_albedo():
    z, normal = bumps(12, 16, 1e-7)
    normal = np.stack((0.2 * np.sin(9 * places(12, 16)[0]), 0.1 * np.cos(7 * places(12, 16)[1]), np.ones((12, 16))))
    normal /= np.linalg.norm(normal, axis=0)
    made = scene(lambert(np.full((3, 12, 16), 0.5), normal), z, normal, dome(24, highest_deg=45))
    near, far = (fit(data, "lambert", holdout=0, dtype=torch.float64) for data in (made.btf, made.far))
    assert degrees(near.material.maps["normal"].detach(), normal).max() < 0.01
    assert degrees(far.material.maps["normal"].detach(), normal).mean() > 5
    assert_close(near.material.maps["albedo"], torch.full((3, 12, 16), 0.5, dtype=torch.float64), 1e-4)


def test_intensities_of_near_lights_are_estimated():
    z, normal = bumps(12, 16, 0.02)
    bright = np.random.default_rng(0).uniform(0.5, 2, (24, 3))
    made = scene(lambda light: lambert(np.full((3, 12, 16), 0.4), normal)(light) * bright[:, :, None, None], z, normal, LIGHTS)
    found = with_estimated_intensities(made.btf).intensity.numpy()
    assert np.abs(found / found.mean(axis=0) / (bright / bright.mean(axis=0)) - 1).max() < 0.06  # heights of 0.03 widths are not in the directions


def test_an_object_mask_leaves_the_rest_out():
    mask = torch.zeros(12, 16, dtype=torch.bool)
    mask[2:10, 3:12] = True
    z, normal = bumps(12, 16, 0.02)
    made = scene(lambert(np.full((3, 12, 16), 0.4), normal), z, normal, LIGHTS)
    masked, whole = made.btf.masked(mask), stereo_of(made.btf, torch.arange(24), torch.float64)
    found = stereo_of(masked, torch.arange(24), torch.float64)
    assert_close(found.normal[:, mask], whole.normal[:, mask], 1e-9)
    result = fit(masked, "ptm", holdout=0, dtype=torch.float64)
    assert float(result.coverage[0][~mask].max()) == 0 and float(result.coverage[0][mask].min()) == 1
