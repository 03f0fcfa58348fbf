"""Pictures of objects against Mitsuba, a ray tracer that shares nothing with the package."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from tests.support import shared_path

from torchmat.brdf import AnalyticBrdf, load_brdf
from torchmat.rendering import Camera, Directional, Point
from torchmat.rendering.mesh import load_mesh
from torchmat.rendering.objects import shade_visible
from torchmat.rendering.shapes import make_mesh
from torchmat.rendering.visibility import see

mi = pytest.importorskip("mitsuba", reason="Mitsuba is not installed: pip install 'torchmat[mitsuba]'")
pytestmark = pytest.mark.usefixtures("variant")

SIZE = (24, 32)
SUN = Directional((-0.5, 0.6, 0.7), (1.0, 0.8, 0.5))
VIEW = (0.4, 0.3, 1.0)
DIFFUSE = (0.7, 0.4, 0.2)


def rgb(values) -> dict:
    return {"type": "rgb", "value": [float(value) for value in values]}


BRDFS = {
    "diffuse": (
        lambda: AnalyticBrdf("lambert", diffuse=DIFFUSE, dtype=torch.float64),
        lambda: {"type": "diffuse", "reflectance": rgb(DIFFUSE)},
    ),
    # A perfect mirror of facets: Fresnel's factor is 1 in both.
    "ggx": (
        lambda: AnalyticBrdf("ggx", diffuse=0.0, specular=1.0, roughness=0.3, dtype=torch.float64),
        lambda: {"type": "roughconductor", "material": "none", "distribution": "ggx", "alpha": 0.3},
    ),
    "ggx_anisotropic": (
        lambda: AnalyticBrdf(
            "ggx_anisotropic", diffuse=0.0, specular=1.0, roughness_along=0.5, roughness_across=0.15,
            dtype=torch.float64,
        ),
        lambda: {
            "type": "roughconductor", "material": "none", "distribution": "ggx", "alpha_u": 0.5, "alpha_v": 0.15,
        },
    ),
    "measured": (
        lambda: load_brdf(shared_path("real/rgl/vch_golden_yellow_rgb.bsdf"), torch.float64),
        lambda: {"type": "measured", "filename": str(shared_path("real/rgl/vch_golden_yellow_rgb.bsdf"))},
    ),
}


def shape_of(mesh, bsdf: dict):
    properties = mi.Properties()
    properties["material"] = mi.load_dict(bsdf)
    found = mi.Mesh(
        "object", len(mesh.position), len(mesh.faces), has_vertex_normals=True, has_vertex_texcoords=True,
        props=properties,
    )
    parameters = mi.traverse(found)
    parameters["vertex_positions"] = mesh.position.numpy().ravel()
    parameters["vertex_normals"] = mesh.normal.numpy().ravel()
    parameters["vertex_texcoords"] = mesh.uv.numpy().ravel()
    parameters["faces"] = mesh.faces.numpy().astype(np.uint32).ravel()
    parameters.update()
    return found


def emitter_of(light) -> dict:
    # A value is pi times reflectance times cosine.
    power = rgb(math.pi * k for k in light.intensity)
    if isinstance(light, Point):
        return {"type": "point", "position": list(light.position), "intensity": power}
    return {"type": "directional", "direction": [-k for k in light.direction], "irradiance": power}


def sensor_of(camera: Camera) -> dict:
    transform = mi.ScalarTransform4f
    ends = (mi.ScalarPoint3f(list(map(float, place))) for place in (camera.position, camera.target))
    world = transform().look_at(*ends, camera.up)
    sensor = {
        "near_clip": 1e-2, "far_clip": 1e3, "sampler": {"type": "multijitter", "sample_count": 64},
        "film": {
            "type": "hdrfilm", "height": SIZE[0], "width": SIZE[1], "rfilter": {"type": "box"},
            "component_format": "float32",
        },
    }
    if camera.width is None:
        fov = {"type": "perspective", "fov": math.degrees(camera.field_of_view), "fov_axis": "x", "to_world": world}
        return sensor | fov
    half = camera.width / 2
    return sensor | {"type": "orthographic", "to_world": world @ transform().scale([half, half, 1.0])}


def direct_light(mesh, bsdf: dict, lights, camera: Camera) -> torch.Tensor:
    """Return what Mitsuba says of the ray through each pixel's centre [3, rows, columns], point by point."""
    scene, context = mi.load_dict({"type": "scene", "object": shape_of(mesh, bsdf)}), mi.BSDFContext()
    rows, columns = SIZE
    x = ((torch.arange(columns, dtype=torch.float64) + 0.5) / columns * 2 - 1).repeat(rows)
    y = ((1 - (torch.arange(rows, dtype=torch.float64) + 0.5) / rows * 2) * (rows / columns)).repeat_interleave(columns)
    rays = camera.rays(x, y, columns)
    found = np.zeros((rows * columns, 3))
    for number, (origin, direction) in enumerate(zip(rays.origin.tolist(), rays.direction.tolist(), strict=True)):
        hit = scene.ray_intersect(mi.Ray3f(mi.Point3f(origin), mi.Vector3f(direction)))
        if not hit.is_valid():
            continue
        for light in lights:
            way = np.array(light.position) - np.array(hit.p) if isinstance(light, Point) else np.array(light.direction)
            distance = np.linalg.norm(way)
            toward = mi.Vector3f((way / distance).tolist())
            shadow = hit.spawn_ray(toward)
            if isinstance(light, Point):
                shadow.maxt = float(distance)
            if not scene.ray_test(shadow):
                value = np.pi * np.array(hit.bsdf().eval(context, hit, hit.to_local(toward))).ravel()
                # The colours of measured files lie in part outside of RGB, where Mitsuba's values are negative.
                power = np.array(light.intensity) / (distance**2 if isinstance(light, Point) else 1)
                found[number] += np.maximum(value, 0) * power
    return torch.from_numpy(found).T.reshape(3, rows, columns)


def path_traced(mesh, bsdf: dict, lights, camera: Camera) -> torch.Tensor:
    """Return Mitsuba's picture of direct light with shadows [3, rows, columns], 64 random rays a pixel."""
    emitters = {f"light_{number}": emitter_of(light) for number, light in enumerate(lights)}
    scene = mi.load_dict({
        "type": "scene", "integrator": {"type": "path", "max_depth": 2}, "object": shape_of(mesh, bsdf),
        "sensor": sensor_of(camera), **emitters,
    })
    return torch.from_numpy(np.array(mi.render(scene, seed=1))[..., :3].copy()).permute(2, 0, 1).double()


def perspective(mesh) -> Camera:
    return Camera.framing(mesh.centre.tolist(), mesh.radius, VIEW, 0.6)


def orthographic(mesh) -> Camera:
    return Camera.framing(mesh.centre.tolist(), mesh.radius, VIEW)


def lights_of(mesh) -> tuple:
    """Return a distant light and a point light that stands as near by as the mesh is large."""
    place = (mesh.centre + mesh.radius * torch.tensor([1.2, 1.4, 1.6])).tolist()
    return SUN, Point(tuple(place), tuple(mesh.radius**2 * k for k in (4.0, 5.0, 6.0)))


def apart_at_points(mesh, name: str, camera: Camera, shadows: bool = True) -> float:
    """Return the mean absolute difference of single rays over the mean: nothing is left out."""
    brdf, bsdf = (make() for make in BRDFS[name])
    seen = see(mesh, camera, SIZE, 1, dtype=brdf.dtype)
    expected = direct_light(mesh, bsdf, lights_of(mesh), camera)
    assert float((expected > 0).double().mean()) > 0.15
    found = shade_visible(brdf, seen, lights_of(mesh), shadows)
    return float((found - expected).abs().mean() / expected.mean())


# The numbers in comments were measured at 36 x 48 rays.
@pytest.mark.parametrize("view, shadows", [(perspective, False), (orthographic, True)])
def test_points_of_a_sphere(view, shadows):
    # Nothing hides another part: measured 1e-5 diffuse, 5e-6 GGX and 2.4e-5 measured, of Mitsuba's float32.
    mesh = make_mesh("sphere")
    for name in ("diffuse", "ggx", "measured"):
        assert apart_at_points(mesh, name, view(mesh), shadows) < 1e-4


@pytest.mark.parametrize("shape, view", [("torus", perspective), ("cube", orthographic), ("teapot", perspective)])
def test_points_of_shapes_that_shadow_themselves(shape, view):
    # Measured at most 8.0e-5 (torus), 3.4e-7 (cube) and 7.2e-5 (teapot).
    mesh = make_mesh(shape)
    for name in ("diffuse", "ggx", "measured"):
        assert apart_at_points(mesh, name, view(mesh)) < 1e-3


@pytest.mark.parametrize("shape", ["sphere", "torus"])
def test_points_of_an_anisotropic_surface(shape):
    # Measured 4.4e-3 and 6.2e-3: Mitsuba's tangents are those of each triangle, ours go smoothly from one to the next.
    mesh = make_mesh(shape)
    assert apart_at_points(mesh, "ggx_anisotropic", perspective(mesh)) < 0.01


@pytest.mark.parametrize("file", ["spot/spot.obj", "bunny/stanford-bunny.obj", "teapot/teapot.obj"])
def test_points_of_meshes_of_files(file):
    # Measured 1.5e-3, 7.9e-4 and 1.8e-4 diffuse, less for the others. What is left are some ten points near the border
    # of light, where flat triangles that bend away from the light are dark in Mitsuba and ours are round.
    mesh = load_mesh(shared_path(f"meshes/{file}"))
    for name in ("diffuse", "ggx", "measured"):
        assert apart_at_points(mesh, name, perspective(mesh)) < 5e-3


def apart_in_pictures(mesh, name: str, lights, camera: Camera) -> float:
    """Return the mean absolute difference of pictures over the mean, away from the outline."""
    brdf, bsdf = (make() for make in BRDFS[name])
    seen = see(mesh, camera, SIZE, 16, dtype=brdf.dtype)
    covered = seen.resolve(torch.ones(1, 1, len(seen.pixel), dtype=brdf.dtype))
    inside = -torch.nn.functional.max_pool2d(-covered, 3, 1, 1)[0] > 0.999
    assert int(inside.sum()) > 80
    expected = path_traced(mesh, bsdf, lights, camera)[:, inside]
    found = shade_visible(brdf, seen, lights, shadows=True)[:, inside]
    return float((found - expected).abs().mean() / expected.mean())


@pytest.mark.parametrize("shape, name, view", [
    ("sphere", "diffuse", orthographic), ("torus", "ggx", perspective), ("cube", "ggx", orthographic),
    ("teapot", "diffuse", perspective),
])
def test_pictures(shape, name, view):
    # 16 rays a pixel against 64 random ones: measured at most 4e-4 (sphere), 2.4e-3 (torus and teapot) and 3.9e-3 (cube)
    # for either formula, camera and light; most of it at edges and at the borders of shadows.
    mesh = make_mesh(shape)
    for light in lights_of(mesh):
        assert apart_in_pictures(mesh, name, [light], view(mesh)) < 0.01


def test_the_comparison_can_fail():
    mesh = make_mesh("torus", segments=48)
    brdf, bsdf = (make() for make in BRDFS["ggx"])
    camera, light = perspective(mesh), Directional((-1.0, 0.15, 0.1))
    seen = see(mesh, camera, SIZE, 1, dtype=brdf.dtype)
    expected = direct_light(mesh, bsdf, [light], camera)
    turned = Directional((-1.0, 0.15, 0.15))  # by three degrees
    for lights, shadows in (([turned], True), ([light], False)):
        found = shade_visible(brdf, seen, lights, shadows)
        assert float((found - expected).abs().mean() / expected.mean()) > 0.05
