"""Parallax, shadow and shading of a relief against Mitsuba, a ray tracer that shares nothing with the package."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from torchmat.geometry import soft_shadow, trace_view
from torchmat.models import Lambert

mi = pytest.importorskip("mitsuba", reason="Mitsuba is not installed: pip install 'torchmat[mitsuba]'")
pytestmark = pytest.mark.usefixtures("variant")

TEXELS = 32
FINE = 4  # vertices per texel
MARGIN = 1  # tiles on each side: the longest way to the light is 0.7 of a tile, and no view moves by more than 0.3
PAIRS = [((0.75, 0.35, 0.55), (-0.6, -0.5, 0.5)), ((-0.3, 0.8, 0.5), (0.2, 0.8, 0.3))]  # view, light


def unit(direction) -> np.ndarray:
    return np.array(direction) / np.linalg.norm(direction)


def planes(direction) -> torch.Tensor:
    return torch.from_numpy(unit(direction))[:, None, None]


def surface(x, y):
    """The height, in texture widths, at x (right) and y (up), each of period 1."""
    total = 0.05 * np.sin(2 * np.pi * (x + y) + 0.4) + 0.04 * np.cos(2 * np.pi * (x - 2 * y) - 1.1)
    return total + 0.035 * np.sin(2 * np.pi * 2 * x + 0.8) + 0.02


def height_map() -> torch.Tensor:
    u = (np.arange(TEXELS) + 0.5) / TEXELS
    return torch.from_numpy(surface(*np.meshgrid(u, 1 - u)))[None]


@pytest.fixture(scope="module")
def mesh(variant):
    """The tile from 0 to 1, and `MARGIN` more on each side."""
    count = TEXELS * FINE
    line = np.arange(-MARGIN * count, (MARGIN + 1) * count + 1) / count
    x, y = np.meshgrid(line, line)
    position = np.stack((x, y, surface(x, y)), axis=-1).reshape(-1, 3)
    corner = np.arange(len(line) ** 2).reshape(len(line), -1)
    a, b, c, d = (part.ravel() for part in (corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]))
    faces = np.concatenate((np.stack((a, b, c), axis=1), np.stack((a, c, d), axis=1)))
    properties = mi.Properties()
    white = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 1.0}}}
    properties["material"] = mi.load_dict(white)
    properties["face_normals"] = True
    found = mi.Mesh("relief", len(position), len(faces), props=properties)
    parameters = mi.traverse(found)
    parameters["vertex_positions"] = position.ravel().astype(np.float32)
    parameters["faces"] = faces.ravel().astype(np.uint32)
    parameters.update()
    return found


@pytest.fixture(scope="module")
def scene(mesh):
    return mi.load_dict({"type": "scene", "relief": mesh})


def places(count: int = 45) -> np.ndarray:
    """Return [n, 2] places of the plane, off the texel centres."""
    line = (np.arange(count) + 0.37) / count
    return np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)


def hits_of(scene, view: np.ndarray) -> np.ndarray:
    """Return where the rays of a view through `places()` first meet the mesh, [n, 3]."""
    found = []
    for x, y in places():
        start = np.array([x, y, 0.0]) + 0.5 / view[2] * view  # above everything
        hit = scene.ray_intersect(mi.Ray3f(mi.Point3f(*start), mi.Vector3f(*-view)))
        assert hit.is_valid()
        found.append(np.array(hit.p).ravel())
    return np.array(found)


@pytest.mark.parametrize("view, light", PAIRS)
def test_hits_are_those_of_a_ray_tracer(scene, view, light):
    expected = hits_of(scene, unit(view))
    uv = torch.from_numpy(places().T[:, None])
    found = trace_view(height_map(), planes(view), uv)
    apart = np.abs(np.concatenate((found.uv[:, 0].numpy(), found.height[:, 0].numpy())).T - expected).max(axis=1)
    moved = np.abs(expected[:, :2] - places()).max(axis=1)
    # The package's surface is bilinear between 32 texels, the mesh's between 128 vertices: measured medians of 4.5e-4 at
    # most (a texel is 3e-2), 2e-3 for 95 of 100, and 3 of 2,025 rays that pass an edge on its other side.
    assert np.median(apart) < 1e-3
    assert np.quantile(apart, 0.95) < 4e-3
    assert (apart > 1 / TEXELS).mean() < 5e-3
    assert np.median(moved) > 0.05, "no parallax would pass as well"


@pytest.mark.parametrize("view, light", PAIRS)
def test_shadows_are_those_of_a_ray_tracer(scene, view, light):
    direction = unit(light)
    uv = torch.from_numpy(places().T[:, None])
    lit = soft_shadow(height_map(), planes(light), uv=uv)[0, 0].numpy()
    blocked = []
    for x, y in places():
        start = np.array([x, y, surface(x, y) + 1e-4])
        blocked.append(scene.ray_test(mi.Ray3f(mi.Point3f(*start), mi.Vector3f(*direction))))
    blocked = np.array(blocked)
    certain = (lit == 0) | (lit == 1)
    assert certain.mean() > 0.9 and blocked.mean() > 0.05
    # Beside the penumbra the package asks the ray once a texel: measured 8 of 2,025 wrong at most, 19 with it.
    assert (blocked == (lit > 0.5))[certain].mean() < 0.01
    assert (blocked == (lit > 0.5)).mean() < 0.02


def rendered(mesh, view: np.ndarray, light: np.ndarray) -> np.ndarray:
    """Return the rectified picture [H, W] under direct light: what each texel of the plane z = 0 sees."""
    sensor = np.eye(4)  # sheared, so that the film covers the tile whatever the view; the camera's x points left
    sensor[:3, 0], sensor[:3, 1], sensor[:3, 2] = (-0.5, 0, 0), (0, 0.5, 0), -view
    sensor[:3, 3] = np.array([0.5, 0.5, 0]) + view
    scene = mi.load_dict({
        "type": "scene", "relief": mesh, "integrator": {"type": "path", "max_depth": 2},
        "light": {
            "type": "directional", "direction": list(-light), "irradiance": {"type": "rgb", "value": math.pi},
        },
        "sensor": {
            "type": "orthographic", "near_clip": 1e-3, "far_clip": 10.0, "to_world": mi.ScalarTransform4f(sensor),
            "sampler": {"type": "multijitter", "sample_count": 36},
            "film": {
                "type": "hdrfilm", "width": TEXELS, "height": TEXELS, "rfilter": {"type": "box"},
                "component_format": "float32",
            },
        },
    })
    return np.array(mi.render(scene, seed=1))[..., 1]


@pytest.mark.parametrize("view, light", PAIRS)
def test_shading_is_that_of_a_path_tracer(mesh, view, light):
    expected = rendered(mesh, unit(view), unit(light))
    albedo = torch.ones(3, TEXELS, TEXELS, dtype=torch.float64)
    material = Lambert({"albedo": albedo, "height": height_map()}, normals="height")
    with torch.no_grad():
        found = material.shade(planes(light), planes(view))[1].numpy()
        flat = material.surface().shade(planes(light), planes(view))[1].numpy()
    apart, without = np.abs(found - expected), np.abs(flat - expected)
    # Measured: medians 4.2e-3 (2.6e-3 with the true normals in place of Sobel's) and 3.7e-3, from a surface of 32 texels
    # against one of 128; 95 of 100 within 0.018 and 0.056: the rest are edges and shadow borders, sharp in Mitsuba.
    assert np.median(apart) < 8e-3
    assert np.quantile(apart, 0.95) < 0.08
    # The same normals and albedo without parallax and shadow: medians of 0.09 and 0.11.
    assert np.median(without) > 10 * np.median(apart)
    assert np.quantile(without, 0.95) > 5 * np.quantile(apart, 0.95)
