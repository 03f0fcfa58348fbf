"""The benchmark suite of single BRDFs: microfacet and distribution beside the best formula, on the RGL files and an anisotropic lobe.

Each is a BTF of one texel (``torchmat fit MODEL --data paint.bsdf``), a fifth of its samples held out. A formula has one lobe; its
bytes are its numbers in half precision, those of a material one texel's and its tables'.
"""

from __future__ import annotations

from typing import Any

import torch
from measure import SHARED

import torchmat as tm
from torchmat import colour
from torchmat.brdf import ANALYTIC, AnalyticBrdf
from torchmat.btf.brdf_file import hemispheres
from torchmat.btf.split import split_samples
from torchmat.fitting.models.lobe import fit_lobe

_EFFORT = 0.3  # of the usual steps
_ANISOTROPIC = "brushed (Ward, anisotropic)"


def _data() -> dict[str, tm.Btf]:
    found = {path.stem.removesuffix("_rgb"): tm.load_btf(path) for path in sorted((SHARED / "real" / "rgl").glob("*.bsdf"))}
    light, view = hemispheres(isotropic=False)
    # A formula that neither model has.
    brushed = AnalyticBrdf("ward", diffuse=0.02, specular=(0.9, 0.7, 0.4), roughness_along=0.35, roughness_across=0.12, axis=0.6)
    planes = [d.float()[:, :, None, None] for d in (light, view)]
    found[_ANISOTROPIC] = tm.Btf.from_tensors(brushed.value(*planes).clamp(min=0).numpy(), light.numpy(), view.numpy())
    return found


def _errors(predicted: torch.Tensor, target: torch.Tensor) -> dict[str, float]:
    gap = colour.display(predicted[..., None, None]) - colour.display(target[..., None, None])
    error = (predicted - target).square().sum() / target.square().sum()
    return {"dB": float(-10 * gap.square().mean().clamp(min=1e-12).log10()), "error": float(error)}


def _best_formula(btf: tm.Btf, seed: int) -> dict[str, Any]:
    """Return the errors of the formula that has the smallest on training samples."""
    split, rows = split_samples(btf, 0.2, "pair", seed), []
    for name, lobe in ANALYTIC.items():
        values = btf.images(split.train)[:, :, 0, 0].double()
        light, view = (d[split.train][:, :, None, None].double() for d in (btf.light, btf.view))
        # Weighed by what a step of a display is, as the materials' own fits are.
        importance = (values.mean(dim=1).clamp(min=1e-3)) ** (2 / 2.2 - 2)
        parameters, _ = fit_lobe(lobe, light, view, values, differences=True, importance=importance)
        seen = lobe.evaluate(parameters, light, view)[:, :, 0, 0]
        light, view = (d[split.held_out][:, :, None, None].double() for d in (btf.light, btf.view))
        held_out = lobe.evaluate(parameters, light, view)[:, :, 0, 0].clamp(min=0)
        target = btf.images(split.held_out)[:, :, 0, 0].double()
        rows.append((-_errors(seen.clamp(min=0), values)["dB"], {"model": name, "bytes": 2 * len(parameters), **_errors(held_out, target)}))
    return min(rows, key=lambda row: row[0])[1]


def brdfs(seed: int = 0) -> list[dict[str, Any]]:
    """Error beside bytes of each model on each BRDF."""
    rows = []
    for name, btf in _data().items():
        rows.append({"data": name, "kind": "best formula", **_best_formula(btf, seed)})
        for model in ("microfacet", "distribution"):
            result = tm.fit(btf, model, geometry="flat", seed=seed, measure="none", progress=False, effort=_EFFORT)
            material, rest = result.material.as_exported(), result.split.held_out
            with torch.no_grad():
                predicted = material.shade(*(d[rest][:, :, None, None].to(material.dtype) for d in (btf.light, btf.view)))[:, :, 0, 0]
            rows.append({
                "data": name, "kind": model, "model": model, "bytes": material.bytes_per_texel + material.shared_bytes,
                "parts": material.options["parts"], "seconds": result.report["fit_seconds"],
                **_errors(predicted.double(), btf.images(rest)[:, :, 0, 0].double()),
            })
        print(*rows[-3:], sep="\n", flush=True)
    return rows
