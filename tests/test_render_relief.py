"""Pictures of a material on a relief: parallax and shadow on the patch and on the sphere."""

from __future__ import annotations

import pytest
import torch
from tests.models.examples import make
from tests.support import assert_close

from torchmat.geometry.rays import texel_centres
from torchmat.models import Lambert, Texture
from torchmat.rendering import render

SIZE = 12
OBLIQUE = (0.6, -0.3, 0.7)
LIGHT = (-0.7, 0.4, 0.4)


def unit(direction, dtype=torch.float64) -> torch.Tensor:
    vector = torch.tensor(direction, dtype=torch.float64)
    return (vector / vector.norm()).to(dtype)[:, None, None]


def bumps(rows: int = SIZE, columns: int = SIZE, dtype=torch.float64, amplitude: float = 0.1) -> torch.Tensor:
    u, v = texel_centres(rows, columns, torch.float64)
    total = torch.sin(2 * torch.pi * u) * torch.cos(2 * torch.pi * v) + 0.3 * torch.cos(2 * torch.pi * u + 1)
    return (amplitude * total)[None].to(dtype)


def relief_of(name="ptm", options=None, rows=SIZE, columns=SIZE, dtype=torch.float64, **settings):
    flat = make(name, options or {}, rows, columns, dtype, **settings)
    return flat.on_relief(bumps(rows, columns, dtype), torch.rand(3, rows, columns, dtype=torch.float64).to(dtype) * 0.1)


@pytest.mark.parametrize("rows, columns", [(SIZE, SIZE), (6, SIZE), (SIZE, 6)])
def test_patch_at_its_own_size_is_shade(rows, columns, dtype):
    material = relief_of(rows=rows, columns=columns, dtype=dtype)
    picture = render(material, "patch", [LIGHT], size=columns)
    assert_close(picture, material.shade(unit(LIGHT, dtype), unit((0, 0, 1), dtype)))


@pytest.mark.parametrize("rows, columns", [(SIZE, SIZE), (6, SIZE)])
def test_oblique_patch_is_shade_along_each_texels_ray(rows, columns, dtype):
    material = relief_of(rows=rows, columns=columns, dtype=dtype)
    picture = render(material, "patch", [LIGHT], view=OBLIQUE, size=columns)
    per_texel = unit(OBLIQUE, dtype).expand(3, rows, columns)
    assert_close(picture, material.shade(unit(LIGHT, dtype), per_texel), 1e-4 if dtype == torch.float32 else None)
    assert float((picture - render(material.surface(), "patch", [LIGHT], view=OBLIQUE, size=columns)).abs().max()) > 0.1


def test_oblique_patch_and_shade_differ_by_their_filters_alone():
    # shade looks the finished picture up bicubically, the renderer looks the maps up bilinearly: on a smooth albedo of 48
    # texels both come near what lies between. Measured 9e-3 apart, and 0.3 from the flat surface.
    u, v = texel_centres(48, 48, torch.float64)
    albedo = torch.stack((0.5 + 0.3 * torch.sin(2 * torch.pi * u), 0.5 + 0.3 * torch.cos(2 * torch.pi * v), 0.5 + 0 * u))
    material = Texture({"albedo": albedo}).on_relief(bumps(48, 48))
    light = (0.1, 0.2, 0.95)
    picture = render(material, "patch", [light], view=OBLIQUE, size=48)
    shaded = material.shade(unit(light), unit(OBLIQUE)).detach()
    assert_close(picture, shaded, 0.02)
    assert float((shaded - material.surface().shade(unit(light), unit(OBLIQUE)).detach()).abs().max()) > 0.1


@pytest.mark.parametrize("view", [(0.0, 0.0, 1.0), OBLIQUE])
def test_patch_repeats_the_tile_with_its_parallax(view):
    material = relief_of()
    once = render(material, "patch", [LIGHT], view=view, size=SIZE)
    twice = render(material, "patch", [LIGHT], view=view, size=2 * SIZE, repeat=2)
    assert_close(twice, once.repeat(1, 2, 2), 1e-9)


def test_patch_of_a_surface_that_ends_goes_on_with_its_border():
    material = relief_of(tiles=False)
    picture = render(material, "patch", [LIGHT], view=OBLIQUE, size=3 * SIZE, repeat=3)
    assert bool(torch.isfinite(picture).all())
    # v up: the tile itself is at the lower left, and the far corner shows its upper right texel alone.
    assert_close(picture[:, :SIZE, -SIZE:], picture[:, :1, -1:].expand(3, SIZE, SIZE), 1e-9)


def test_patch_is_black_for_a_light_or_view_below():
    material = relief_of()
    assert not bool(render(material, "patch", [(0.5, 0, -0.5)], size=4).any())
    assert not bool(render(material, "patch", [LIGHT], view=(1, 0, -0.1), size=4).any())


def test_sphere_shows_the_relief(dtype):
    material = Lambert({"albedo": torch.full((3, SIZE, SIZE), 0.8, dtype=dtype), "height": bumps(dtype=dtype)}, normals="height")
    for light in (LIGHT, (1.0, 0.0, 0.0), (0.3, -0.8, -0.2)):
        picture = render(material, "sphere", [light], size=24)
        assert picture.shape == (3, 24, 24) and picture.dtype == dtype
        assert bool(torch.isfinite(picture).all()) and bool((picture >= 0).all()) and bool((picture <= 0.8 + 1e-6).all())
    shown, flat = (render(m, "sphere", [LIGHT], size=24) for m in (material, material.surface()))
    # Normals are the same, so what differs is parallax and shadow.
    assert float((shown - flat).abs().max()) > 0.2
    assert float(shown.mean()) < float(flat.mean())


def test_sphere_of_a_vanishing_relief_is_the_flat_sphere():
    flat = make("ptm", {}, SIZE, SIZE)
    picture = render(flat.on_relief(bumps(amplitude=1e-12)), "sphere", [LIGHT], size=16)
    assert_close(picture, render(flat, "sphere", [LIGHT], size=16), 1e-9)


@pytest.mark.parametrize("mesh", ["patch", "sphere"])
def test_lights_add_up(mesh):
    material = relief_of()
    one, other = (0.3, 0.2, 0.8), (-0.5, 0.1, 0.4)
    both = render(material, mesh, [one, other], size=8)
    assert_close(both, render(material, mesh, [one], size=8) + render(material, mesh, [other], size=8))
    assert not bool(render(material, mesh, [], size=8).any())


def test_rendering_keeps_no_graph():
    assert not render(relief_of(), "patch", view=OBLIQUE, size=4).requires_grad
