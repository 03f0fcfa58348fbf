"""The benchmark suite of fine reliefs and of their finish: error, the height's error against the truth, seconds, and shading."""

from __future__ import annotations

from typing import Any

import torch
from measure import timed
from reliefs import REFERENCES, _against_truth, _load

import torchmat as tm
from torchmat.models import Lambert

WAYS = {"fast": {"relief": "fast"}, "fine": {"relief": "fine", "finish": False}, "fine, finished": {"relief": "fine"}}
_DEEP = tuple(name for name in REFERENCES if name != "disk")


def finish(seeds: tuple[int, ...] = (0, 1), effort: float = 1.0) -> list[dict[str, Any]]:
    """The distribution material on a recovered relief that is followed fast, finely, and finely with a finish."""
    rows = []
    for data in (*_DEEP, "sample"):
        btf = _load(data)
        for seed in seeds:
            for way, settings in WAYS.items():
                result = tm.fit(btf, "distribution", geometry="recover", seed=seed, effort=effort, **settings)
                report = result.report
                row: dict[str, Any] = {
                    "data": data, "way": way, "seed": seed, "seconds": report["fit_seconds"], "bytes": report["bytes_per_texel"],
                    "dB": report["held_out_after_export"]["psnr_db"],
                    "error": report["held_out_after_export"]["relative_error"],
                    "finish": report["figures"].get("finish", {}).get("kept"),
                }
                if data in REFERENCES:
                    height, normal = (result.material.maps["height"].detach()[0].numpy(), result.relief.normal.numpy())
                    row["height RMS error / std"] = _against_truth(data, height, normal)["height RMS error / std"]
                rows.append(row)
                print(row, flush=True)
    return rows + _shading()


def _shading() -> list[dict[str, Any]]:
    """Seconds of one picture of 512 x 512, one light and view, and of the same at points."""
    generator = torch.Generator().manual_seed(0)
    coarse = 0.1 * torch.rand(1, 1, 24, 24, generator=generator)
    height = torch.nn.functional.interpolate(coarse, size=(512, 512), mode="bicubic").clamp(0, 0.1)[0]
    up = torch.zeros(3, 512, 512)
    up[2] = 1
    flat = Lambert({"albedo": torch.rand(3, 512, 512, generator=generator), "normal": up})
    one = torch.tensor([0.3, 0.2, 0.933])[:, None, None], torch.tensor([-0.3, 0.4, 0.866])[:, None, None]
    every = tuple(d.expand(3, 512, 512).contiguous() for d in one)
    rows = []
    for way in ("fast", "fine"):
        material = flat.on_relief(height).with_relief(way)
        with torch.no_grad():
            rows.append({
                "way": way, "one light and view": timed(lambda m=material: m.shade(*one)), "per pixel": timed(lambda m=material: m.shade(*every)),
            })
    print(rows, flush=True)
    return rows
