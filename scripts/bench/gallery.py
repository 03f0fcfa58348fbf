"""Draw the picture at the top of the README: one object in every model beside the measured images: ``python scripts/bench/gallery.py``."""

from __future__ import annotations

import math

import torch
from measure import RESULTS

import torchmat as tm
from torchmat import colour
from torchmat.btf.interpolated import RawBtf
from torchmat.models import MATERIALS
from torchmat.rendering import Camera
from torchmat.rendering.as_mesh import as_mesh
from torchmat.rendering.lights import Directional
from torchmat.rendering.objects import shade_visible
from torchmat.rendering.visibility import see
from torchmat.report.pictures import plotting, save_figure

_COLUMNS, _SIZE, _REPEAT = 4, 320, 1.0
_VIEW, _LIGHTS = (0.35, 0.35, 1.0), [Directional((-0.5, 0.7, 0.6), (1.6,) * 3), Directional((0.9, 0.3, 0.3), (0.4, 0.45, 0.6))]
_OPTIONS = {"distribution": {"geometry": "recover"}, "lambert": {"geometry": "recover"}, "phong_srf": {"residual": "half_light"}}


def main() -> None:
    """Fit every model to the embedded sample and show it on the teapot, its error on unseen pairs above."""
    btf = tm.load_btf(tm.sample_path())
    mesh = as_mesh("teapot")
    camera = Camera.framing(mesh.centre, 0.97 * mesh.radius, _VIEW, math.radians(25))
    visible = see(mesh, camera, (int(0.72 * _SIZE), _SIZE), 4, repeat=_REPEAT)
    shown = [("the measured images", shade_visible(RawBtf(btf), visible, _LIGHTS, shadows=True, soften=True))]
    for model in MATERIALS:
        result = tm.fit(btf, model, **_OPTIONS.get(model, {}))
        picture = shade_visible(result.material, visible, _LIGHTS, shadows=True, soften=True)
        error = result.report["held_out"]["psnr_db"]
        shown.append((f"{model}: {result.report['bytes_per_texel']:.0f} B, {error:.1f} dB", picture))
        print(shown[-1][0], flush=True)
    plot = plotting()
    rows = math.ceil(len(shown) / _COLUMNS)
    figure, axes = plot.subplots(rows, _COLUMNS, figsize=(2.6 * _COLUMNS, 2.1 * rows), layout="constrained")
    for axis in axes.flat:
        axis.axis("off")
    for axis, (title, picture) in zip(axes.flat, shown, strict=False):
        axis.imshow(colour.display(picture).permute(1, 2, 0).numpy())
        axis.set_title(title, fontsize=8)
    save_figure(figure, RESULTS / "objects.png")


if __name__ == "__main__":
    with torch.no_grad():
        main()
