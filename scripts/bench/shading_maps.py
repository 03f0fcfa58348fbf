"""The benchmark suite of shading maps: an arc, an RTI set, BTFs; what sectors and the joint fit buy; speed."""

from __future__ import annotations

from typing import Any

import torch
from measure import SHARED, timed

import torchmat as tm
from torchmat.btf.btf import Btf
from torchmat.models import ShadingMap
from torchmat.models.base import combine
from torchmat.models.shading_map import assemble, layer_weights, look_up_layer
from torchmat.report.comparison import parse_model

_SETS = {
    "real wallpaper": "real/ubo2003_wallpaper", "lion's head (RTI)": "real/loewenkopf_rti",
    "leather": "reference/leather.zip", "wallpaper": "reference/wallpaper.zip", "disk": "reference/disk.zip",
    "stones": "reference/stones.zip", "weave (8-bit)": "reference/weave_ubo2003.zip",
}
_ARC = (
    "texture", "lambert", "ptm", "phong_srf", "shading_map:joint=false", "shading_map:joint=false,overflow=scale",
    "shading_map:joint=false,brdf=ggx", "shading_map", "shading_map:brdf=lambert", "shading_map:brdf=ggx",
    "shading_map:azimuths=4", "shading_map:azimuths=8",
)
_PAIRS = (
    "texture", "ptm", "phong_srf:residual=half_light", "shading_map:joint=false", "shading_map",
    "shading_map:brdf=ggx", "shading_map:brdf=ggx,azimuths=4", "shading_map:brdf=ggx,azimuths=8",
    "shading_map:brdf=ggx_anisotropic",
)


def _row(data: str, btf: Btf, text: str, by: str) -> dict[str, Any]:
    model, options = parse_model(text)
    options = {"storage": "png8", **options}
    result = tm.fit(btf, model, holdout_by=by, measure=False, **options)
    held_out = result.split.held_out
    before, after = (
        tm.evaluate(material, btf, held_out).report for material in (result.material, result.material.as_exported())
    )
    row = {
        "data": data, "held out by": by, "model": text, "train": len(result.split.train), "held out": len(held_out),
        "bytes": result.material.bytes_per_texel, "fit seconds": result.report["fit_seconds"],
        "stop": result.stop_reason,
        "error": before["relative_error"], "dB": before["psnr_db"], "error after export": after["relative_error"],
        "dB after export": after["psnr_db"],
    }
    print(f"{data:18s} {by:5s} {text:40s} {row['bytes']:5.0f} B {row['fit seconds']:6.2f} s  {row['error']:.4f} "
          f"{row['dB']:.2f} dB, exported {row['error after export']:.4f} {row['dB after export']:.2f} dB", flush=True)
    return row


def shading_maps() -> list[dict[str, Any]]:
    """Error on unseen lights and pairs, 8-bit slices, beside bytes and seconds; then assembling and shading."""
    rows = []
    for data, place in _SETS.items():
        path = SHARED / place
        if not path.exists():
            print(f"skipped: {path.name} is absent")
            continue
        btf = tm.load_btf(path)
        if data == "real wallpaper":
            rows += [_row(data, btf, text, "arc") for text in _ARC]
        rows += [_row(data, btf, text, "pair") for text in _PAIRS]
    return rows + _speed()


def _speed() -> list[dict[str, Any]]:
    generator = torch.Generator().manual_seed(0)
    images = torch.rand(10, 3, 512, 512, generator=generator) * torch.linspace(0.1, 1, 10)[:, None, None, None]
    rows = [{"what": "assemble ten 512 x 512 images to 8 slices", "time": timed(lambda: assemble(images), 15)}]
    slices, brightest = assemble(images)
    stack = slices.unflatten(0, (8, 3))
    places = 7 * torch.rand(1, 512, 512, generator=generator)
    one = torch.tensor([0.3, 0.2, 0.933])[:, None, None], torch.tensor([-0.3, 0.4, 0.866])[:, None, None]
    every = tuple(d.expand(3, 512, 512).contiguous() for d in one)
    lobe = torch.tensor([0.4, 0.3, 0.2, 0.1, 0.1, 0.1, 3.0])
    material = ShadingMap({"slices": slices, "lobe": lobe, "brightest": brightest})
    four = ShadingMap({"slices": slices.repeat(4, 1, 1), "lobe": lobe, "brightest": brightest}, azimuths=4)
    ways = {
        "stack per pixel, two gathered": lambda: look_up_layer(stack, places),
        "stack per pixel, all combined": lambda: combine(layer_weights(places, 8), stack),
        "stack per image, two slices": lambda: look_up_layer(stack, places[:, :1, :1]),
        "stack per image, all combined": lambda: combine(layer_weights(places[:, :1, :1], 8), stack),
        "shade, one light and view": lambda: material.shade(*one), "shade, per pixel": lambda: material.shade(*every),
        "shade, one light and view, 4 sectors": lambda: four.shade(*one),
        "shade, per pixel, 4 sectors": lambda: four.shade(*every),
    }
    with torch.no_grad():
        rows += [{"what": f"512 x 512: {what}", "time": timed(way, 15)} for what, way in ways.items()]
    for row in rows:
        print(row["what"], f"{1000 * row['time']['seconds']:.2f} ms", flush=True)
    return rows
