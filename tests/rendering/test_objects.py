"""Visible points under lights: against a loop over points, shadows against geometry, and what holds for all models."""

from __future__ import annotations

import math

import pytest
import torch
from tests.models.examples import CASES, make
from tests.rendering.scenes import front, squares, white
from tests.support import assert_close, shared_path

from torchmat.errors import RangeError
from torchmat.models import Texture
from torchmat.rendering import Camera, Directional, Point, render
from torchmat.rendering.mesh import load_mesh
from torchmat.rendering.mipmap import Pyramid
from torchmat.rendering.objects import shade_visible
from torchmat.rendering.shapes import SHAPES, make_mesh
from torchmat.rendering.visibility import see

LIGHTS = (
    Directional((-0.4, 0.5, 0.768), (0.9, 0.5, 0.1)), Point((1.5, 1.0, 2.0), (2.0, 3.0, 4.0)),
    Directional((0.9, 0.1, -0.2)),
)
MODELS = [("phong_srf", {"residual": "half", "base": "phong"}), ("ptm", {}), ("hsh", {"terms": 4})]


@pytest.fixture(scope="module")
def meshes():
    segments = {"sphere": 12, "torus": 12, "teapot": 4}
    return {name: make_mesh(name, **({"segments": segments[name]} if name in segments else {})) for name in SHAPES}


def look(mesh, size=(7, 9), rays=1, dtype=torch.float64, direction=(0.3, 0.4, 1.0), **options):
    return see(mesh, Camera.framing(mesh.centre, mesh.radius, direction, 0.5), size, rays, dtype=dtype, **options)


def to_place(light, place: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the direction [3] and the intensity [3] that reach a place [3], by hand."""
    intensity = torch.tensor(light.intensity, dtype=torch.float64)
    if isinstance(light, Directional):
        direction = torch.tensor(light.direction, dtype=torch.float64)
        return direction / direction.norm(), intensity
    way = torch.tensor(light.position, dtype=torch.float64) - place
    return way / way.norm(), intensity / way.norm() ** 2


@pytest.mark.parametrize("name, options", MODELS)
@pytest.mark.parametrize("shape", ["torus", "cube"])
def test_each_pixel_is_shade_at_summed_over_lights(meshes, name, options, shape):
    material = make(name, options, 3, 4)
    seen = look(meshes[shape], rays=4, repeat=0.05)  # so that a pixel is smaller than a texel, and full size serves
    expected = torch.zeros(3, 7 * 9, dtype=torch.float64)
    for number, pixel in enumerate(seen.pixel.tolist()):
        frame, view = seen.frame[:, :, 0, number], seen.view[:, :, number]
        for light in LIGHTS:
            direction, intensity = to_place(light, seen.position[:, 0, number])
            local = (frame @ direction)[:, None, None]
            value = material.shade_at(seen.uv[:, :, number : number + 1], local, view[:, :, None])
            expected[:, pixel] += value[:, 0, 0].detach() * intensity / 4
    assert float(expected.max()) > 0.1
    assert_close(shade_visible(material, seen, LIGHTS), expected.reshape(3, 7, 9))


@pytest.mark.parametrize("name, options", CASES)
def test_every_model_on_every_shape(meshes, name, options, dtype):
    material = make(name, options, 3, 4, dtype)
    for shape, mesh in meshes.items():
        seen = look(mesh, dtype=dtype, repeat=2.0)
        picture = shade_visible(material, seen, LIGHTS)
        assert picture.shape == (3, 7, 9) and picture.dtype == dtype, shape
        assert bool(torch.isfinite(picture).all()) and bool((picture >= 0).all()) and float(picture.max()) > 0, shape
    singly = sum(shade_visible(material, seen, [light]) for light in LIGHTS)
    assert_close(picture, singly, 1e-5 if dtype == torch.float32 else 1e-12)
    assert not bool(shade_visible(material, seen, []).any())


def test_a_relief_on_an_object_is_seen_from_each_points_own_side(meshes):
    flat = make("ptm", {}, 6, 6)
    height = 0.2 * torch.rand(1, 6, 6, dtype=torch.float64)
    relief = flat.on_relief(height)
    seen = look(meshes["sphere"], rays=1, repeat=0.05)
    expected = torch.zeros(3, 63, dtype=torch.float64)
    for number, pixel in enumerate(seen.pixel.tolist()):
        light = (seen.frame[:, :, 0, number] @ to_place(LIGHTS[0], seen.position[:, 0, number])[0])[:, None, None]
        value = relief.shade_at(seen.uv[:, :, number : number + 1], light, seen.view[:, :, number][:, :, None])
        expected[:, pixel] = value[:, 0, 0].detach() * torch.tensor(LIGHTS[0].intensity, dtype=torch.float64)
    picture = shade_visible(relief, seen, LIGHTS[:1])
    assert_close(picture, expected.reshape(3, 7, 9))
    assert float((picture - shade_visible(flat, seen, LIGHTS[:1])).abs().max()) > 0.01


def test_the_picture_is_linear_in_each_channel_of_the_light(meshes):
    seen = look(meshes["teapot"])
    material = make("ptm", {}, 3, 4)
    for kind, place in ((Directional, (0.2, 0.3, 1.0)), (Point, (0.5, 2.0, 3.0))):
        white_light = shade_visible(material, seen, [kind(place)])
        factor = torch.tensor([0.0, 0.25, 1e4], dtype=torch.float64)
        tinted = shade_visible(material, seen, [kind(place, (0.0, 0.25, 1e4))])
        assert_close(tinted, white_light * factor[:, None, None])


def test_a_point_light_far_away_is_a_distant_one(meshes):
    # Measured 1.4e-4: from 1e4 away a shape 2 wide sees directions 2e-4 apart.
    material = make("phong_srf", {"residual": "half", "base": "phong"}, 3, 4)
    direction = (0.48, 0.6, 0.64)
    seen = look(meshes["torus"])
    far = shade_visible(material, seen, [Point(tuple(1e4 * k for k in direction), (1e8, 1e8, 1e8))])
    assert_close(far, shade_visible(material, seen, [Directional(direction)]), 5e-4)


def test_a_light_below_the_horizon_gives_exactly_nothing(dtype):
    quad = make_mesh("quad")
    for material in (make("ptm", {}, 3, 4, dtype), white(dtype)):
        seen = look(quad, dtype=dtype, direction=(0.0, 0.0, 1.0))
        for light in (Directional((0.3, 0.1, -0.5)), Directional((1, 0, 0)), Point((0, 0.2, -3))):
            assert not bool(shade_visible(material, seen, [light]).any())
        assert not bool(shade_visible(material, look(quad, dtype=dtype, direction=(0.1, 0, -1)), LIGHTS).any())


def test_a_brdf_is_a_material(meshes, dtype):
    seen = look(meshes["sphere"], dtype=dtype)
    picture = shade_visible(white(dtype), seen, [Directional((0.2, 0.5, 0.7), (1, 2, 3))])
    direction = torch.tensor([0.2, 0.5, 0.7], dtype=dtype)
    normal = seen.frame[2]
    cosine = (normal * (direction / direction.norm())[:, None, None]).sum(dim=0, keepdim=True).clamp(min=0)
    cosine = cosine * (seen.view[2:] > 0)
    expected = seen.resolve(torch.cat((cosine, 2 * cosine, 3 * cosine)))
    assert_close(picture, expected)


@pytest.mark.parametrize("repeat", [1, 2])
def test_a_texture_stands_upright_on_the_quad(repeat):
    albedo = torch.rand(3, 6, 6, dtype=torch.float64)
    camera = Camera((0, 0, 3), width=1.0)
    options = {"size": 6 * repeat, "repeat": repeat, "camera": camera, "rays": 1}
    picture = render(Texture({"albedo": albedo}), "quad", [(0, 0, 1)], **options)
    assert_close(picture, albedo.repeat(1, repeat, repeat), 1e-6)  # float32 texture coordinates


def test_both_precisions_agree(meshes):
    material = make("phong_srf", {"residual": "half", "base": "phong"}, 3, 4)
    single = make("phong_srf", {"residual": "half", "base": "phong"}, 3, 4, torch.float32)
    for mesh in meshes.values():
        fine = shade_visible(material, look(mesh), LIGHTS)
        coarse = shade_visible(single, look(mesh, dtype=torch.float32), LIGHTS)
        assert_close(coarse, fine.float(), 1e-4)  # measured 1.4e-5


def test_a_pyramid_serves_many_pictures(meshes):
    material = make("ptm", {}, 8, 8)
    seen = look(meshes["sphere"], repeat=8.0)
    pyramid = Pyramid(material)
    first = shade_visible(pyramid, seen, LIGHTS)
    assert len(pyramid.levels) > 1
    assert first.equal(shade_visible(pyramid, seen, LIGHTS)) and first.equal(shade_visible(material, seen, LIGHTS))


def test_a_light_inside_is_an_error(meshes):
    seen = look(meshes["sphere"])
    with pytest.raises(RangeError, match=r"the light must lie outside of the mesh 'sphere'; it stands at \(0.1, 0.0"):
        shade_visible(white(), seen, [Directional((0, 0, 1)), Point((0.1, 0.0, 0.0))])


# Shadows


def picture_of(mesh, lights, width: float = 4.0, size: int = 40) -> torch.Tensor:
    return shade_visible(white(), see(mesh, front(width), size, 1, dtype=torch.float64), lights, shadows=True)[0]


def plane(size: int = 40, width: float = 4.0) -> tuple[torch.Tensor, torch.Tensor]:
    across = ((torch.arange(size, dtype=torch.float64) + 0.5) / size - 0.5) * width
    return across.expand(size, size), -across[:, None].expand(size, size)


TABLE = squares((0, 0, 0, 3), (0, 0, 1, 0.4))


@pytest.mark.parametrize("azimuth_deg", [0, 90, 180, 270])
def test_a_distant_light_casts_the_square_where_it_must(azimuth_deg):
    x, y = plane()
    azimuth = math.radians(azimuth_deg)
    away = (math.cos(azimuth), math.sin(azimuth))
    shadow = ((x + away[0]).abs() < 0.4) & ((y + away[1]).abs() < 0.4)
    expected = (~shadow).double() * math.sqrt(0.5)
    assert 60 < int(shadow.sum()) < 70
    assert_close(picture_of(TABLE, [Directional((*away, 1.0))]), expected)


def test_a_point_light_casts_a_larger_square():
    x, y = plane()
    top = (x.abs() < 0.4) & (y.abs() < 0.4)
    height = torch.where(top, 2.0, 3.0).double()
    distance = (x**2 + y**2 + height**2).sqrt()
    shadow = ~top & (x.abs() < 0.6) & (y.abs() < 0.6)  # 3 / (3 - 1) times as large
    assert int(shadow.sum()) == 12 * 12 - 8 * 8
    assert_close(picture_of(TABLE, [Point((0, 0, 3))]), torch.where(shadow, 0.0, height / distance**3))


def test_what_lies_behind_a_point_light_casts_no_shadow():
    x, y = plane()
    top = (x.abs() < 0.4) & (y.abs() < 0.4)
    distance = (x**2 + y**2 + 0.49).sqrt()
    assert_close(picture_of(TABLE, [Point((0, 0, 0.7))]), torch.where(top, 0.0, 0.7 / distance**3))
    # The same light just above the upper square reaches nothing but that.
    assert bool(((picture_of(TABLE, [Point((0, 0, 1.01))]) > 0) == top).all())


def test_a_light_in_the_surface_itself_is_dark_and_finite():
    picture = picture_of(squares((0, 0, 0, 3)), [Point((0.05, 0.05, 0.0))])
    assert bool(torch.isfinite(picture).all()) and not bool(picture.any())


@pytest.mark.parametrize("segments", [8, 24, 256])
@pytest.mark.parametrize("light", [(1, 0, 0), (0.8, 0.6, -0.1), (-0.9, 0.1, -0.9), (0.0, 1.0, 0.0), (0.1, 0.2, 1.0)])
def test_a_convex_shape_casts_no_shadow_on_itself(segments, light):
    seen = look(make_mesh("sphere", segments=segments), size=48)
    for lamp in (Directional(light), Point(tuple(1.5 * k / math.hypot(*light) for k in light))):
        assert_close(*(shade_visible(white(), seen, [lamp], shadows=on) for on in (True, False)))


def test_a_torus_lit_along_its_axis_casts_no_shadow_on_what_faces_the_light():
    for segments in (12, 48, 256):
        seen = look(make_mesh("torus", segments=segments), size=48, direction=(0.2, 1.0, 0.6))
        assert_close(*(shade_visible(white(), seen, [Directional((0, 1, 0))], shadows=on) for on in (True, False)))


@pytest.mark.parametrize("name", ["torus", "teapot", "cube", "spot"])
def test_what_the_camera_sees_a_light_in_its_place_reaches(name):
    mesh = load_mesh(shared_path("meshes/spot/spot.obj")) if name == "spot" else make_mesh(name)
    direction = (0.4, 0.5, 0.8)
    camera = Camera.framing(mesh.centre, mesh.radius, direction)
    seen = see(mesh, camera, 64, 1, dtype=torch.float64)
    for light in (Directional(direction), Point(tuple(1e4 * k for k in direction), (1e8,) * 3)):
        lit, free = (shade_visible(white(), seen, [light], shadows=on)[0] for on in (True, False))
        assert int((free > 0).sum()) > 800
        # Rays that just pass an outline may meet it on their way back.
        assert int((lit != free).sum()) <= 4


def test_shadows_hide_part_of_the_teapot_and_never_add_light():
    mesh = make_mesh("teapot", segments=8)
    seen = look(mesh, size=40)
    lit, free = (shade_visible(white(), seen, [Directional((1, 0.3, 0.2))], shadows=on)[0] for on in (True, False))
    assert bool((lit <= free).all()) and 20 < int((lit < free).sum()) < 400


def test_shadows_far_from_the_origin_are_those_near_it():
    # Numbers in float32 are 2e-3 apart there, more than the lift of a shadow ray that the size alone asks for.
    seen = []
    for z in (0.0, 20000.3):
        mesh = squares((0, 0, z, 3), (0, 0, z + 1, 0.4))
        seen.append(see(mesh, Camera((0, 0, z + 10), (0, 0, z), width=4.0), 40, 1))
    pictures = [shade_visible(white(torch.float32), one, [Directional((1, 0, 1))], shadows=True) for one in seen]
    assert_close(pictures[1], pictures[0], 1e-4)
