"""What measuring costs is bounded: by a share of texels for SSIM and CIEDE2000, by bands of rows for the rest."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tests.support import all_pairs, hemisphere, plausible_images

import torchmat as tm
from torchmat import Btf, RangeError, metrics
from torchmat.report.tables import fit_tables

LIGHT, VIEW = all_pairs(hemisphere(), hemisphere(((0, 1), (60, 3))))


@pytest.fixture(name="module")
def evaluate_module():
    import importlib

    return importlib.import_module("torchmat.fitting.evaluate")


@pytest.fixture(scope="module")
def btf():
    return Btf.from_tensors(plausible_images(LIGHT, VIEW, 12, 16).astype(np.float32), LIGHT, VIEW)


@pytest.mark.parametrize(
    "samples, height, width, wanted",
    [
        (40, 64, 64, (40, 64, 64)),
        (2401, 64, 64, (256, 64, 64)),
        (50, 300, 500, (13, 300, 500)),
        (50, 3000, 4000, (8, 434, 577)),
        (3, 3000, 4000, (3, 708, 942)),
        (1, 100, 100, (1, 100, 100)),
        (8, 1, 10_000_000, (8, 1, 250_000)),
        (8, 4000, 10, (8, 4000, 10)),
    ],
)
def test_the_share_of_texels(module, samples, height, width, wanted):
    count, rows, columns = module.perceptual_share(samples, height, width)
    assert (count, rows.stop - rows.start, columns.stop - columns.start) == wanted
    assert abs((height - rows.stop) - rows.start) <= 1 and abs((width - columns.stop) - columns.start) <= 1
    if count * height * width > 2_000_000:
        assert count * (rows.stop - rows.start) * (columns.stop - columns.start) < 2_020_000


def planes(seed):
    return torch.from_numpy(np.random.default_rng(seed).random((2, 3, 21, 17), dtype=np.float32))


def test_bands_of_rows_change_no_figure(monkeypatch):
    valid, clipped = planes(2)[:, :1] > 0.2, planes(3)[:, :1] > 0.9

    def figures():
        errors = metrics.SampleErrors()
        errors.add(planes(0), planes(1), valid, clipped, torch.tensor([True, True]))
        return errors.report()

    whole = figures()
    seen = []
    sums = metrics._sums
    monkeypatch.setattr(metrics, "_sums", lambda *band: seen.append(band[0].shape[-2]) or sums(*band))
    monkeypatch.setattr(metrics, "BAND_VALUES", 5 * 2 * 3 * 17)
    banded = figures()
    assert seen == [5, 5, 5, 5, 1]
    for name, value in whole.items():
        assert banded[name] == pytest.approx(value, rel=1e-9)


def test_ssim_and_delta_e_are_those_of_the_middle(module, monkeypatch, btf):
    material = tm.fit(btf, "ptm", measure="none").material
    monkeypatch.setattr(module, "PERCEPTUAL_TEXELS", 8 * 6 * 8)
    rows = torch.arange(len(btf))
    found = tm.evaluate(material, btf, rows).report
    assert (found["perceptual_samples"], found["perceptual_size"]) == (8, [6, 8])
    chosen = torch.linspace(0, len(btf) - 1, 8).round().long()
    errors = metrics.SampleErrors()
    with torch.no_grad():
        predicted = material.shade(btf.light[chosen][:, :, None, None], btf.view[chosen][:, :, None, None])[..., 3:9, 4:12]
    images = btf.images(chosen)[..., 3:9, 4:12]
    errors.add(predicted, images, torch.ones(8, 1, 6, 8, dtype=torch.bool), torch.zeros(8, 1, 6, 8, dtype=torch.bool), torch.ones(8, dtype=torch.bool))
    for name in ("ssim", "delta_e"):
        assert found[name] == pytest.approx(errors.report()[name], rel=1e-5)
    monkeypatch.setattr(module, "PERCEPTUAL_TEXELS", 2_000_000)
    assert tm.evaluate(material, btf, rows).report["psnr_db"] == found["psnr_db"]


def test_how_much_is_measured_is_asked_for_and_said(module, monkeypatch, btf):
    full = tm.fit(btf, "ptm", holdout=0.4)
    assert full.report["held_out"]["samples"] == len(full.split.held_out) == len(full.held_out_errors)
    assert tm.fit(btf, "ptm", holdout=0.4, measure=True).report["held_out"] == full.report["held_out"]
    monkeypatch.setattr(module, "QUICK_TEXELS", 10 * 12 * 16)
    monkeypatch.setattr(module, "_PERCEPTUAL_SOME", 8 * 6 * 8)
    monkeypatch.setattr(module, "_PERCEPTUAL_TRAIN", 8 * 3 * 4)
    quick = tm.fit(btf, "ptm", holdout=0.4, measure="quick")
    assert [quick.report[part]["samples"] for part in ("train", "held_out", "held_out_after_export")] == [10, 10, 10]
    assert quick.held_out_errors is None and len(quick.split.held_out) > 10
    assert "10 images; SSIM and delta E: 8, the middle 6 x 8 texels" in fit_tables(quick.report)
    assert quick.report["train"]["perceptual_size"] == [3, 4]
    thorough = tm.fit(btf, "ptm", holdout=0.4, measure="full").report
    assert thorough["train"]["perceptual_size"] == [12, 16]
    assert thorough["held_out"]["psnr_db"] == full.report["held_out"]["psnr_db"]
    assert tm.fit(btf, "ptm", measure="none").report["train"] == {} == tm.fit(btf, "ptm", measure=False).report["train"]
    with pytest.raises(RangeError, match="measure must be one of 'none', 'quick', 'full'"):
        tm.fit(btf, "ptm", measure="fast")


def test_of_large_images_few_are_measured_again(module, monkeypatch, btf):
    monkeypatch.setattr(module, "TRAIN_TEXELS", 9 * 12 * 16)
    monkeypatch.setattr(module, "_OF_TRAIN", 10 * 12 * 16)
    assert [tm.fit(btf, "ptm", measure=how).report["train"]["samples"] for how in ("full", "auto")] == [9, 10]


def test_rows_of_a_comparison_may_be_quick(module, monkeypatch, btf):
    monkeypatch.setattr(module, "QUICK_TEXELS", 10 * 12 * 16)
    row = tm.compare(btf, ["texture"], holdout=0.4, measure="quick")[0]
    assert row["report"]["held_out"]["samples"] == 10 and row["relative_error"] > 0
    with pytest.raises(RangeError, match="compare: measure must be one of 'quick', 'full'"):
        tm.compare(btf, ["texture"], measure="none")
