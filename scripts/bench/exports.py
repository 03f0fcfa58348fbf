"""The benchmark suite of exporters: seconds, peak memory and shading error of a material of 1024 x 1024 in each form."""

from __future__ import annotations

import os
from typing import Any

from measure import in_fresh_process, median_of

_SIDE = int(os.environ.get("TORCHMAT_BENCH_SIDE", "1024"))
_REPEATS = int(os.environ.get("TORCHMAT_BENCH_REPEATS", "3"))
# A wavy surface of a few roughnesses: what textures are like, not noise, which no PNG packs.
_MAKE = """
import json, math, tempfile, time
from pathlib import Path
import torch
import torchmat as tm
from torchmat.create.from_textures import ggx_lobe
from torchmat.geometry import normals_from_slopes
from torchmat.machine import peak_memory_mb
from torchmat.models import Distribution, Microfacet
side = {side}
y, x = torch.meshgrid(torch.arange(side) / side, torch.arange(side) / side, indexing="ij")
wave = lambda fast, low, high: low + (high - low) * (0.5 + 0.5 * torch.sin(fast * 2 * math.pi * x) * torch.cos(3 * math.pi * fast * y))[None]
angle = wave(2, 0, 3)
maps = dict(
    diffuse=torch.cat([wave(k, 0.1, 0.7) for k in (3, 4, 5)]), normal=normals_from_slopes(torch.cat((wave(20, -.3, .3), wave(17, -.3, .3)))),
    rotation=torch.cat((torch.cos(angle), torch.sin(angle))),
)
def microfacet():
    return Microfacet(dict(maps, specular_f0=wave(3, 0.03, 0.5).repeat(3, 1, 1), roughness=torch.cat((wave(5, .4, .7), wave(5, .3, .4)))),
                      parts=["normal", "anisotropy"])
def distribution():
    own = dict(maps, fresnel=wave(3, 0.05, 0.6), specular_mask=wave(4, 0.2, 0.9), specular=ggx_lobe(0.4), masking=torch.full((2,), 0.16))
    return Distribution(own, parts=["normal", "rotation", "fresnel", "specular_mask", "masking"])
"""
_EXPORT = """
with tempfile.TemporaryDirectory() as room:
    material, before = {model}(), peak_memory_mb()
    start = time.perf_counter()
    losses = tm.export(material, Path(room) / "out{suffix}", to={to!r}, **{options!r})
    seconds = time.perf_counter() - start
    size = sum(path.stat().st_size for path in Path(room).rglob("*") if path.is_file())
print(json.dumps(dict(seconds=seconds, peak_rss_mb=peak_memory_mb(), before_mb=before, megabytes=size / 1e6, errors=dict(losses.errors))))
"""
FORMS = (
    ("folder", {}), ("gltf", {}), ("gltf", {"depth": 8}), ("materialx", {}), ("materialx", {"form": "closest"}), ("mitsuba", {}),
    ("mitsuba", {"form": "plain"}), ("blender", {}), ("orm", {}), ("orm", {"vendor": "poliigon"}),
)


def exports() -> list[dict[str, Any]]:
    """Each form of a microfacet and a distribution material of 1024 x 1024, with what is off against the material itself."""
    rows = []
    for model in ("microfacet", "distribution"):
        for to, options in FORMS:
            code = _MAKE.format(side=_SIDE) + _EXPORT.format(model=model, suffix=".glb" if to == "gltf" else "", to=to, options=options)
            runs = in_fresh_process(code, _REPEATS)
            row = {"model": model, "texels": _SIDE**2, "to": to, "options": options, "export": median_of(runs, "seconds")}
            rows.append(row | {key: runs[-1][key] for key in ("peak_rss_mb", "before_mb", "megabytes", "errors")})
            print(rows[-1], flush=True)
    return rows
