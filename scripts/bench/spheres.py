"""Benchmarks of sphere images: error, highlight, bytes and seconds against simpler blends and a MERL table."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from statistics import geometric_mean, mean
from typing import Any

import torch
from measure import SHARED, timed

from torchmat.brdf import Brdf, load_brdf
from torchmat.brdf.merl import MerlBrdf, tabulate
from torchmat.fitting.models.spheres.points import highlight_error, sphere_errors, unseen_lights
from torchmat.fitting.models.spheres.to_brdf import fit_sphere_images
from torchmat.models.sphere_geometry import directions_on, sphere_normals
from torchmat.models.sphere_images import PAPER_ANGLES_DEG, SphereImages, constant_turn, paper_turn

_FOLDER = SHARED / "real" / "rgl"
_SIX = (0.0, 30.0, 60.0, 90.0, 120.0, 150.0)
_LIGHTS, _HIGHLIGHTS_DEG = 24, (20.0, 65.0, 110.0)
_GLOSSY = 4.0  # so many times brighter than 12 degrees beside it is a highlight with a place
_MERL_BYTES = 90 * 90 * 180 * 3 * 8
_HARDEST = "chm_mint"


def _materials() -> Iterator[tuple[str, Brdf]]:
    for path in sorted(_FOLDER.glob("*.bsdf")):
        yield path.name.removesuffix("_rgb.bsdf"), load_brdf(path)
    if not _FOLDER.exists():
        print(f"skipped: {_FOLDER.relative_to(SHARED)} is absent")


class _Nearest:
    """The picture whose light is nearest, as it is."""

    def __init__(self, material: SphereImages) -> None:
        self.material, self.size, self.shared_bytes = material, material.maps["images"].shape[-1], material.shared_bytes

    def shade_at(self, uv: torch.Tensor, light: torch.Tensor, view: torch.Tensor) -> torch.Tensor:
        angles = self.material.options["angles_deg"]
        light_deg = math.degrees(math.acos(float((light * view).sum(dim=0).flatten()[0])))
        number = min(range(len(angles)), key=lambda j: abs(angles[j] - light_deg))
        picture = self.material.maps["images"].detach()[3 * number : 3 * number + 3].repeat(2, 1, 1)
        maps = {"images": picture, "turn": constant_turn(0), "tint": self.material.maps["tint"]}
        return SphereImages(maps, angles_deg=(0, 180)).shade_at(uv, light, view)


def _is_glossy(brdf: Brdf) -> bool:
    normal = torch.tensor([[math.sin(math.radians(polar)), 0, math.cos(math.radians(polar))] for polar in (32.5, 44.5)])
    peak, beside = brdf.shade(*directions_on(normal.T.reshape(3, 1, 2), math.radians(65)))[:, 0].sum(dim=0).tolist()
    return peak > _GLOSSY * beside


def _measured(material: Any, brdf: Brdf, angles: tuple[float, ...], glossy: bool) -> dict[str, Any]:
    lights = unseen_lights(angles, _LIGHTS)
    errors = [sphere_errors(material, brdf, [light])[0] for light in lights]
    off = [highlight_error(material, brdf, light) for light in _HIGHLIGHTS_DEG] if glossy else None
    highlight = round(max(off), 1) if off else None
    return {"error": mean(errors), "largest error": max(errors), "highlight off by (degrees)": highlight}


def _row(name: str, method: str, made: Any, seconds: float, brdf: Brdf, angles: tuple[float, ...]) -> dict[str, Any]:
    stored = isinstance(made, SphereImages)
    material = made.as_exported() if stored else made
    size = made.size if isinstance(made, _Nearest) else made.maps["images"].shape[-1] if stored else None
    row = {"material": name, "method": method, "pictures": len(angles), "size": size,
           "bytes": _MERL_BYTES if isinstance(made, MerlBrdf) else made.shared_bytes}
    row |= {**_measured(material, brdf, angles, _is_glossy(brdf)), "seconds": seconds}
    print(f"{name:20s} {method:28s} {len(angles)} x {size}  {row['bytes']}  {row['error']:.4f}  "
          f"{row['highlight off by (degrees)']}  {seconds:.1f} s", flush=True)
    return row


def _compare(name: str, brdf: Brdf, angles: tuple[float, ...], size: int) -> list[dict[str, Any]]:
    start = time.perf_counter()
    paper = SphereImages.from_brdf(brdf, angles, size)
    seconds = time.perf_counter() - start
    rows = [_row(name, "nearest picture", _Nearest(paper), seconds, brdf, angles)]
    turns = {"plain blend": constant_turn(0), "k = 1": constant_turn(1), "k = 1/2": constant_turn(0.5)}
    for method, turn in {**turns, "the paper": paper_turn()}.items():
        rows.append(_row(name, method, paper.with_maps(turn=turn), seconds, brdf, angles))
    for method, options in (("pictures fitted", {"curves": "paper", "place": False}), ("all fitted", {})):
        start = time.perf_counter()
        fitted = fit_sphere_images(brdf, angles, size, **options).material
        rows.append(_row(name, method, fitted, time.perf_counter() - start, brdf, angles))
        rows[-1]["error / the paper's"] = rows[-1]["error"] / rows[4]["error"]
    return rows


def sphere_images() -> list[dict[str, Any]]:
    """Four pictures of 256 x 256 of each RGL material, the ways of blending them, and a table as MERL's."""
    rows = []
    for name, brdf in _materials():
        rows += _compare(name, brdf, PAPER_ANGLES_DEG, 256)
        start = time.perf_counter()
        table = tabulate(brdf)
        rows.append(_row(name, "MERL table", table, time.perf_counter() - start, brdf, PAPER_ANGLES_DEG))
    ratios = {method: [row["error / the paper's"] for row in rows if row["method"] == method]
              for method in ("pictures fitted", "all fitted")}
    rows += [{"what": f"{method}: error / the paper's, geometric mean", "ratio": geometric_mean(values)}
             for method, values in ratios.items() if values]
    print(rows[-2:], flush=True)
    return rows


def sphere_sizes() -> list[dict[str, Any]]:
    """The smallest files within 5 % error; and size and number of pictures that a near-mirror needs."""
    rows = []
    for name, brdf in _materials():
        if name != _HARDEST:
            rows.append(_smallest(name, brdf, 0.05))
            continue
        for angles in (PAPER_ANGLES_DEG, _SIX):
            for size in (256, 512):
                for method, made in (("the paper", SphereImages.from_brdf), ("pictures fitted", _pictures_fitted)):
                    start = time.perf_counter()
                    material = made(brdf, angles, size)
                    rows.append(_row(name, method, material, time.perf_counter() - start, brdf, angles))
    return rows


def _pictures_fitted(brdf: Brdf, angles: tuple[float, ...], size: int) -> SphereImages:
    return fit_sphere_images(brdf, angles, size, curves="paper", place=False).material


def _smallest(name: str, brdf: Brdf, error: float) -> dict[str, Any]:
    """Return the row of the smallest 8-bit pictures, at 2 to 4 angles, that meet an error after export."""
    best = None
    for count in (2, 3, 4):
        angles = tuple(number * PAPER_ANGLES_DEG[-1] / (count - 1) for number in range(count))
        for size in (8, 12, 16, 24, 32, 48, 64, 96, 128):
            start = time.perf_counter()
            material = fit_sphere_images(brdf, angles, size, storage="png8").material
            seconds = time.perf_counter() - start
            if best is not None and material.shared_bytes >= best["bytes"]:
                break
            if mean(sphere_errors(material.as_exported(), brdf, unseen_lights(angles, _LIGHTS))) <= error:
                best = _row(name, f"smallest at {error:.0%}", material, seconds, brdf, angles)
                best["share of a MERL table"] = best["bytes"] / _MERL_BYTES
                break
    return best or {"material": name, "method": f"none within {error:.0%}"}


def sphere_shading() -> list[dict[str, Any]]:
    """Milliseconds for as many pixels as a bunny fills of 512 x 512, by number of lights, directions per pixel."""
    rows = []
    normal = sphere_normals(440)
    for size in (256, 512):
        maps = {"images": torch.rand(12, size, size), "turn": paper_turn(), "tint": torch.ones(3, 1, 1)}
        material = SphereImages(maps)
        sets = []
        for number in range(8):
            light, view = directions_on(normal, 0.3 + 0.1 * number)
            kept = (light[2] > 0) & (view[2] > 0.05)
            sets.append([d[:, kept][:, None, :110_000].contiguous() for d in (light, view)])
        uv = torch.zeros(2, 1, 110_000)
        with torch.no_grad():
            for lights in (1, 2, 4, 8):
                speed = timed(lambda m=material, n=lights: [m.shade_at(uv, *pair) for pair in sets[:n]], 15)
                rows.append({"size": size, "pixels": 110_000, "lights": lights, **speed})
                rows[-1]["frames a second"] = 1 / speed["seconds"]
                print(rows[-1], flush=True)
    return rows
