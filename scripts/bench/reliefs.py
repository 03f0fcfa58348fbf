"""The benchmark suites of geometry: recovered against true heights, and what a relief buys each model."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import torch
from measure import SHARED, timed

import torchmat as tm
from torchmat.btf.btf import Btf
from torchmat.btf.light_table import read_lights
from torchmat.btf.photographs import read_photographs
from torchmat.fitting import recover_geometry
from torchmat.geometry import photometric_stereo, relief_from_photographs, soft_shadow, trace_view
from torchmat.models import Distribution
from torchmat.models.distribution import default_tilt
from torchmat.report.comparison import parse_model

REFERENCES = ("stones", "leather", "wallpaper", "weave_ubo2003", "disk")
MODELS = (
    "texture", "lambert", "lptm", "ptm", "hsh", "phong_srf", "phong_srf:residual=half_light", "pca", "local_pca",
)


def _load(name: str) -> Btf:
    if name == "sample":
        return tm.load_btf(tm.sample_path())
    if name == "real wallpaper":
        return tm.load_btf(SHARED / "real" / "ubo2003_wallpaper")
    return tm.load_btf(SHARED / "reference" / f"{name}.zip")


def _against_truth(name: str, height: np.ndarray, normal: np.ndarray) -> dict[str, Any]:
    truth = np.load(SHARED / "reference" / f"{name}_truth.npz")
    wanted = truth["height"] - truth["height"].mean()
    cosine = (normal * truth["normal"].transpose(2, 0, 1)).sum(axis=0)
    flat = wanted.std() == 0
    centred = height - height.mean()
    return {
        "median normal error (degrees)": float(np.median(np.degrees(np.arccos(cosine.clip(-1, 1))))),
        "height correlation": None if flat else float(np.corrcoef(centred.ravel(), wanted.ravel())[0, 1]),
        "height RMS error / std": None if flat else float((centred - wanted).std() / wanted.std()),
        "height range": float(np.ptp(height)), "true range": float(np.ptp(wanted)),
        "offset error": float(height.mean() - truth["height"].mean()),
    }


def geometry() -> list[dict[str, Any]]:
    """Heights and normals against the truth: of one view, and of all training pairs; then speed."""
    rows = []
    for name in REFERENCES:
        btf, tiles = _load(name), name != "disk"
        front = ((btf.view_index == 0) & (btf.light[:, 2] > 0.1)).nonzero()[:, 0]
        images, light, weight = btf.images(front), btf.light[front], btf.weights(front)
        alone = relief_from_photographs(images, light, weight, tiles)
        speed = timed(lambda i=images, l=light, w=weight, t=tiles: relief_from_photographs(i, l, w, t))
        rows.append({"data": name, "from": "frontal view", "time": speed,
                     **_against_truth(name, alone.height[0].numpy(), alone.normal.numpy())})
        kept = tm.split_samples(btf).train
        part = Btf.from_tensors(btf.images(kept), btf.light[kept], btf.view[kept], btf.valid(kept))
        found = recover_geometry(part, tiles=tiles).relief
        speed = timed(lambda p=part, t=tiles: recover_geometry(p, tiles=t), 3)
        rows.append({"data": name, "from": "all views (80 % of the pairs)", "time": speed,
                     **_against_truth(name, found.height[0].numpy(), found.normal.numpy())})
        print(rows[-2:], flush=True)
    return rows + _speed()


def _speed() -> list[dict[str, Any]]:
    generator = torch.Generator().manual_seed(0)
    coarse = 0.1 * torch.rand(1, 1, 24, 24, generator=generator)
    height = torch.nn.functional.interpolate(coarse, size=(512, 512), mode="bicubic").clamp(0, 0.1)[0]
    direction = torch.tensor([0.5, 0.3, 0.812])[:, None, None]
    both = timed(lambda: (trace_view(height, direction), soft_shadow(height, direction)), 15)
    folder = SHARED / "real" / "psbox_cat"
    images = read_photographs(folder / "Objects")
    light = read_lights(folder / "light_directions.txt", len(images))
    stereo = timed(lambda: photometric_stereo(images, light), 9)
    rows = [
        {"what": "parallax and shadow, 512 x 512, one view and light", "speed": both},
        {"what": "photometric stereo, 12 images of 430 x 550", "speed": stereo},
    ]
    print(rows, flush=True)
    return rows


def relief() -> list[dict[str, Any]]:
    """Each model flat and with geometry="recover", held-out pairs: error, what was chosen, seconds."""
    rows = []
    for data in ("stones", "wallpaper", "real wallpaper", "disk"):
        btf, tiles = _load(data), data != "disk"
        for text in MODELS:
            model, options = parse_model(text)
            flat = tm.fit(btf, model, geometry="flat", tiles=tiles, **options).report
            found = tm.fit(btf, model, geometry="recover", tiles=tiles, **options).report
            rows.append({
                "data": data, "model": text, "chosen": found["figures"]["geometry"]["chosen"],
                "flat bytes": flat["bytes_per_texel"], "bytes": found["bytes_per_texel"],
                "flat error": flat["held_out"]["relative_error"], "error": found["held_out_after_export"]["relative_error"],
                "flat dB": flat["held_out"]["psnr_db"], "dB": found["held_out_after_export"]["psnr_db"],
                "seconds": found["fit_seconds"], "of which recovery": found["figures"]["geometry"]["recovery_seconds"],
            })
            print(rows[-1], flush=True)
    return rows


def distribution() -> list[dict[str, Any]]:
    """The distribution material with recovered geometry: error after export, bytes, seconds; and its shading speed."""
    rows = []
    for data in (*REFERENCES, "sample"):
        btf, tiles = _load(data), data != "disk"
        start = time.perf_counter()
        result = tm.fit(btf, "distribution", geometry="recover", tiles=tiles, measure=True)
        report = result.report
        row = {
            "data": data, "lobes": report["figures"]["lobes"], "parts": ", ".join(report["figures"]["parts"]),
            "bytes": report["bytes_per_texel"], "shared": report["shared_bytes"], "fit seconds": report["fit_seconds"],
            "with measuring": time.perf_counter() - start, "peak MB": report["peak_rss_mb"],
            "error": report["held_out"]["relative_error"], "dB": report["held_out"]["psnr_db"],
            "error after export": report["held_out_after_export"]["relative_error"],
            "dB after export": report["held_out_after_export"]["psnr_db"],
        }
        if data == "disk":
            row["rotation error (degrees)"] = _rotation_error(result.material)
        rows.append(row)
        print(row, flush=True)
    return rows + _shading()


def _rotation_error(material: Distribution) -> float:
    """Return the median error of the disk's rotation, a line that turns with the azimuth, away from the centre.

    The shared specular map may itself be turned: the angle between the two is what is left open, and taken out.
    """
    rows, columns = material.size
    v, u = np.meshgrid(0.5 - (np.arange(rows) + 0.5) / rows, (np.arange(columns) + 0.5) / columns - 0.5, indexing="ij")
    azimuth, radius = np.arctan2(v, u), np.hypot(u, v)
    x, y = material.maps["rotation"].detach().double().numpy()
    apart = np.exp(2j * (np.arctan2(y, x) - azimuth))
    common = np.angle(apart[radius > 0.1].mean())
    gap = np.abs(np.angle(apart * np.exp(-1j * common))) / 2
    return float(np.degrees(np.median(gap[radius > 0.1])))


def _shading() -> list[dict[str, Any]]:
    generator = torch.Generator().manual_seed(0)

    def plane(channels: int, low: float = 0.0) -> torch.Tensor:
        return low + (1 - low) * torch.rand(channels, 512, 512, generator=generator)

    unit = torch.nn.functional.normalize
    maps = {
        "diffuse": plane(3), "normal": unit(plane(3, -1) * 0.3 + torch.tensor([0, 0, 1.0])[:, None, None], dim=0),
        "specular_mask": plane(1), "fresnel": plane(1), "rotation": unit(plane(2, -1), dim=0),
        "specular": torch.rand(6, 48, 48, generator=generator), "index": plane(2), "tilt": default_tilt(),
    }
    one = torch.tensor([0.3, 0.2, 0.933])[:, None, None], torch.tensor([-0.3, 0.4, 0.866])[:, None, None]
    every = tuple(d.expand(3, 512, 512).contiguous() for d in one)
    rows = []
    for parts in (("specular_mask",), ("normal", "specular_mask", "fresnel", "rotation")):
        for lobes in (1, 2):
            kept = {"diffuse", "specular", *parts} | ({"index"} if lobes > 1 else set())
            chosen = {name: value[: 3 * lobes] if name == "specular" else value for name, value in maps.items() if name in kept}
            material = Distribution(chosen, lobes=lobes, parts=parts)
            with torch.no_grad():
                image = timed(lambda m=material: m.shade(*one), 15)
                pixel = timed(lambda m=material: m.shade(*every), 15)
            rows.append({"parts": ", ".join(parts), "lobes": lobes, "one light and view": image, "per pixel": pixel,
                         "frames a second": f"{1 / image['seconds']:.0f} / {1 / pixel['seconds']:.0f}"})
    print(rows, flush=True)
    return rows
