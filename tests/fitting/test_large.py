"""Large images: texels a few rows at a time, errors and pictures on some of them, and nothing that differs from the whole."""

from __future__ import annotations

import importlib

import numpy as np
import pytest
import torch
from tests.support import hemisphere, plausible_images

import torchmat as tm
from torchmat import Btf, colour
from torchmat.btf import stream
from torchmat.btf.btf import Decoder, summarise
from torchmat.btf.store import CLIPPED
from torchmat.report.tables import measured_rows

LIGHT = hemisphere()
VIEW = np.tile([0.0, 0.0, 1.0], (len(LIGHT), 1))
evaluation = importlib.import_module("torchmat.fitting.evaluate")


@pytest.fixture(scope="module")
def btf():
    """8-bit codes of 24 x 30 texels, some of them clipped."""
    values = torch.from_numpy(plausible_images(LIGHT, VIEW, 24, 30).astype(np.float32))
    codes = (255 * colour.linear_to_srgb(values / values.flatten().quantile(0.97)).clamp(0, 1)).round().byte().numpy()
    flags = np.where((codes == 255).any(axis=1), CLIPPED, 0).astype(np.uint8)
    return Btf(summarise(codes, flags), torch.as_tensor(LIGHT).float(), torch.as_tensor(VIEW).float(), Decoder(codes.dtype, "srgb", 1.0))


@pytest.mark.parametrize("model", ["ptm", "lptm", "hsh", "lambert", "phong_srf"])
def test_rows_at_a_time_give_what_all_at_once_do(btf, model, monkeypatch):
    whole = tm.fit(btf, model, measure="none")
    monkeypatch.setattr(stream, "BAND_VALUES", 5 * 3 * btf.width * min(len(btf), stream.BAND_SAMPLES))
    bands = [(rows.start, rows.stop) for rows, _ in btf.bands()]
    assert bands == [(0, 5), (5, 10), (10, 15), (15, 20), (20, 24)]
    parted = tm.fit(btf, model, measure="none")
    for name, value in whole.material.maps.items():
        value = value.detach()
        scale = value.abs().max()
        assert float((parted.material.maps[name].detach() - value).abs().max() / scale) < 1e-4, name
    assert torch.equal(parted.coverage, whole.coverage)


def test_a_curve_over_codes_is_the_curve_of_values(btf):
    def curve(values):
        return values.clamp(min=1e-3).log_()

    assert torch.equal(btf.through(curve).images([0, 3]), curve(btf.images([0, 3])))
    assert btf.divided_by(torch.full((len(btf), 3), 2.0), "").through(curve) is None
    values = Btf.from_tensors(btf.images([0, 1]), btf.light[:2], btf.view[:2])
    assert values.through(curve) is None


@pytest.mark.parametrize("storage", ["half", "png8", "png16"])
def test_some_texels_are_those_of_the_whole(btf, storage):
    material = tm.fit(btf, "ptm", measure="none", storage=storage).material
    rows, columns = slice(1, 20, 4), slice(0, 30, 3)
    for exported, whole in ((False, material), (True, material.as_exported())):
        some = material.some_texels(rows, columns, exported)
        assert torch.equal(some.maps["polynomial"], whole.maps["polynomial"][:, rows, columns])
    light = torch.tensor([0.0, 0.6, 0.8])[:, None, None]
    assert torch.allclose(some.shade(light, light), whole.shade(light, light)[:, rows, columns], atol=1e-6)


def test_large_images_are_measured_on_some_texels_and_it_is_said(btf, monkeypatch):
    result = tm.fit(btf, "ptm", measure="full")
    assert "every" not in result.report["held_out"]
    monkeypatch.setattr(evaluation, "LARGE_TEXELS", 500)
    monkeypatch.setattr(evaluation, "_OF_EACH", 80)
    report = tm.fit(btf, "ptm").report
    assert report["held_out"]["every"] == 3 and report["held_out"]["samples"] == len(result.split.held_out)
    few = result.material.some_texels(slice(None, None, 3), slice(None, None, 3))
    wanted = tm.evaluate(few, btf.window(0, 0, btf.height, btf.width, 3), result.split.held_out).report
    for figure in ("mse", "relative_error", "psnr_db", "psnr_log_db"):
        assert report["held_out"][figure] == pytest.approx(wanted[figure], rel=1e-6)
    middle = tm.evaluate(result.material, btf, result.split.held_out).report  # all of it is the middle
    assert report["held_out"]["delta_e"] == pytest.approx(middle["delta_e"], rel=1e-6)
    assert "every 3th row" not in str(measured_rows(report)) and "every 3rd row" in str(measured_rows(report))
    assert evaluation.spacing_of(result.material.on_relief(torch.zeros(1, 24, 30)), btf) == 1


