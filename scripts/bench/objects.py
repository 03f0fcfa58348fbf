"""The benchmark suite of objects: visibility once, then pictures per second beside how far they are from the truth."""

from __future__ import annotations

import time
from typing import Any

from measure import SHARED, timed

import torchmat as tm
from torchmat.brdf import load_brdf
from torchmat.btf.interpolated import RawBtf
from torchmat.fitting.models.spheres.to_brdf import fit_sphere_images
from torchmat.metrics import relative
from torchmat.rendering import Camera, Directional
from torchmat.rendering.as_mesh import as_mesh
from torchmat.rendering.mesh import Mesh
from torchmat.rendering.mipmap import Pyramid, Shader
from torchmat.rendering.objects import shade_visible
from torchmat.rendering.visibility import see

_BUNNY = SHARED / "meshes" / "bunny" / "stanford-bunny.obj"
_RGL = SHARED / "real" / "rgl"
_VIEW = (0.3, 0.25, 1.0)
_FIELD_OF_VIEW = 0.5
_LIGHTS = (
    (-0.4, 0.5, 0.77), (0.6, 0.4, 0.7), (0.0, 0.9, 0.4), (0.9, 0.1, 0.4),
    (-0.9, 0.2, 0.4), (0.2, -0.4, 0.9), (-0.6, 0.7, -0.2), (0.5, 0.8, -0.3),
)


def _camera(mesh: Mesh, field_of_view: float | None = _FIELD_OF_VIEW) -> Camera:
    return Camera.framing(mesh.centre, mesh.radius, _VIEW, field_of_view)


def _visibility(name: str, mesh: Mesh) -> list[dict[str, Any]]:
    rows = []
    for rays, edges_only in ((1, False), (4, True), (4, False)):
        seen = see(mesh, _camera(mesh), 512, rays, edges_only)
        speed = timed(lambda r=rays, e=edges_only: see(mesh, _camera(mesh), 512, r, e))
        rows.append({
            "mesh": name, "triangles": len(mesh.faces), "rays a pixel": f"{rays}{' at edges' if edges_only else ''}",
            "points": len(seen.pixel), "visibility": speed,
        })
    return rows


def _frames(name: str, mesh: Mesh, model: str, shader: Shader, truth: Shader | None = None, repeat: float = 1.0) -> list[dict]:
    rows = []
    visible = see(mesh, _camera(mesh), 512, 1, repeat=repeat)
    pyramid = Pyramid(shader)
    for count in (1, 2, 4, 8):
        lights = [Directional(light) for light in _LIGHTS[:count]]
        speed = timed(lambda lamps=lights: shade_visible(pyramid, visible, lamps), 7)
        error = None
        if truth is not None:
            shown, wanted = shade_visible(pyramid, visible, lights), shade_visible(truth, visible, lights)
            error = relative(float((shown - wanted).square().sum()), float(wanted.square().sum()))
        rows.append({
            "mesh": name, "model": model, "points": len(visible.pixel), "lights": count, "shading": speed,
            "pictures/s": 1 / speed["seconds"], "relative error of the picture": error,
        })
        print(f"{name:8s} {model:34s} {count} lights {1 / speed['seconds']:7.1f} pictures/s  {error}", flush=True)
    return rows


def objects() -> list[dict[str, Any]]:
    """Visibility of a 512 x 512 picture, and pictures per second for 1, 2, 4 and 8 lights, one ray a pixel."""
    if not _BUNNY.exists():
        print(f"skipped: {_BUNNY.relative_to(SHARED)} is absent")
        return []
    start = time.perf_counter()
    meshes = {"bunny": as_mesh(_BUNNY)}
    loading = time.perf_counter() - start
    meshes["teapot"] = as_mesh("teapot")
    rows: list[dict[str, Any]] = []
    for name, mesh in meshes.items():
        rows += _visibility(name, mesh)
    rows[0]["load (s)"] = loading
    brdf = load_brdf(_RGL / "vch_golden_yellow_rgb.bsdf")
    spheres = fit_sphere_images(brdf, size=256).material
    btf = tm.load_btf(SHARED / "reference" / "leather.zip")
    leather = tm.fit(btf, "distribution", geometry="recover", measure=False).material
    for name, mesh in meshes.items():
        rows += _frames(name, mesh, "sphere_images, golden paint", spheres, brdf)
        rows += _frames(name, mesh, "measured table, golden paint", brdf)
        rows += _frames(name, mesh, "distribution, leather, parallax", leather, RawBtf(btf), repeat=3.0)
        for model in ("texture", "lambert", "phong_srf", "shading_map", "pca"):
            fitted = tm.fit(btf, model, measure=False).material
            rows += _frames(name, mesh, f"{model}, leather", fitted, RawBtf(btf), repeat=3.0)
    return rows
