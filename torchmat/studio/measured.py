"""A material beside the images that it was made of: one pair as pictures, and the figures of its report."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from torchmat import colour
from torchmat.btf import Btf, load_btf, split_samples
from torchmat.errors import DataError, RangeError, message, notice
from torchmat.fitting import load_config
from torchmat.fitting.evaluate import comparable, evaluate
from torchmat.models import Material
from torchmat.report.samples import nearest_sample, shown
from torchmat.studio.reported import REPORT, report_in

PARTS = ("held_out", "held_out_after_export")


class Measured:
    """The images at `path`, read as the fit of the material in `folder` read them, where its report says how."""

    def __init__(self, path: str, folder: Path) -> None:
        self._path, self._folder = path, folder
        self._btf: Btf | None = None

    @property
    def report(self) -> dict[str, Any]:
        """The report of the material's fit; an empty one where there is none."""
        return report_in(self._folder)

    @property
    def btf(self) -> Btf:
        """The images; they are read when they are first asked for."""
        if self._btf is None:
            run = self.report.get("run") or {}
            settings = load_config(run["config"]).data if "config" in run else {}
            self._btf = load_btf(self._path, **settings, progress=False)
            if "digest" in run and self._btf.digest() != run["digest"]:
                notice(self._path, "these are not the images that the material was fitted to: its report's figures are of others")
        return self._btf

    def beside(self, material: Material, light: Sequence[float], view: Sequence[float]) -> dict[str, Any]:
        """Return the measured pair that lies nearest to two directions: target, fit and difference as RGB bytes, and figures.

        `light` and `view` are three numbers each, above the surface. The figures are those of `report.samples.shown`.
        """
        material, btf = comparable(material, self.btf)
        one = shown(btf, material, nearest_sample(btf, _unit("light", light), _unit("view", view)), "nearest")
        most = max(float(one.difference.abs().max()), 1e-6)
        pictures = {"target": _bytes(one.target), "fit": _bytes(one.fit), "difference": _signed(one.difference / most)}
        return {
            "pictures": pictures, "height": one.target.shape[1], "width": one.target.shape[2], "sample": one.sample,
            "directions": one.directions, "brightness": one.brightness, "most": most,
            "relative_error": one.relative_error, "psnr_db": one.psnr_db, "report": self.figures(),
        }

    def figures(self) -> dict[str, Any]:
        """Return the figures that the report of the fit has on held-out pairs; an empty table where it has none."""
        found: dict[str, Any] = next((self.report[part] for part in reversed(PARTS) if self.report.get(part)), {})
        return {name: found[name] for name in ("relative_error", "psnr_db", "ssim", "delta_e", "samples") if name in found}

    def held_out(self, material: Material) -> dict[str, Any]:
        """Return the figures of the material as it is now on the pairs that its fit held out, as the report measures them."""
        report = self.report
        if not all(name in report for name in ("holdout", "holdout_by", "seed")):
            step = "Fit it with torchmat fit, or compare single pairs."
            raise DataError(message(str(self._folder), REPORT, "say which pairs were held out", "it does not", step))
        split = split_samples(self.btf, report["holdout"], report["holdout_by"], report["seed"])
        found = evaluate(material, self.btf, split.held_out).report
        return {name: found[name] for name in ("relative_error", "psnr_db", "ssim", "delta_e", "samples")}


def _unit(name: str, direction: Sequence[float]) -> Tensor:
    good = isinstance(direction, list | tuple) and len(direction) == 3
    good = good and all(isinstance(one, int | float) and math.isfinite(one) for one in direction)
    if not good or not direction[2] > 0:
        raise RangeError(message("studio", name, "be three numbers, the third above 0", f"it is {direction!r}"))
    found = torch.tensor(direction, dtype=torch.float64)
    return found / found.norm()


def _bytes(picture: Tensor) -> bytes:
    codes = (colour.display(picture.float()) * 255).round().to(torch.uint8)
    return codes.permute(1, 2, 0).contiguous().numpy().tobytes()


def _signed(share: Tensor) -> bytes:
    """Return a difference [H, W] from -1 (blue) over 0 (white) to 1 (red) as RGB bytes."""
    low, high = share.clamp(max=0), share.clamp(min=0)
    planes = torch.stack((1 + low, 1 + low - high, 1 - high)).clamp(0, 1)
    return (planes * 255).round().to(torch.uint8).permute(1, 2, 0).contiguous().numpy().tobytes()
