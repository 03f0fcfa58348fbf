"""Pictures whose every pixel is known."""

from __future__ import annotations

import math

import pytest
import torch
from tests.models.examples import CASES, make
from tests.support import assert_close

from torchmat.errors import RangeError, ShapeError
from torchmat.models import Lambert, Texture
from torchmat.rendering import Camera, Point, render
from torchmat.rendering.shapes import make_mesh

ALBEDO = torch.tensor([0.8, 0.5, 0.2], dtype=torch.float64)[:, None, None]


def _white(height=4, width=4, dtype=torch.float64, **settings) -> Texture:
    return Texture({"albedo": ALBEDO.to(dtype).expand(3, height, width)}, **settings)


def test_patch_of_a_constant_lambert_texture_is_the_cosine(dtype):
    light = (0.3, -0.2, 0.9)
    cosine = 0.9 / math.sqrt(0.3**2 + 0.2**2 + 0.9**2)
    picture = render(_white(dtype=dtype), "patch", [light], size=10)
    assert picture.shape == (3, 10, 10)
    assert picture.dtype == dtype
    assert_close(picture, (ALBEDO.to(dtype) * cosine).expand(3, 10, 10))


def test_patch_is_the_texture_itself_at_its_own_size(dtype):
    albedo = torch.rand(3, 6, 6, dtype=dtype)
    picture = render(Texture({"albedo": albedo}), "patch", [(0, 0, 1)], size=6)
    assert_close(picture, albedo, 1e-5)


def test_patch_repeats_the_texture():
    albedo = torch.rand(3, 4, 4, dtype=torch.float64)
    picture = render(Texture({"albedo": albedo}), "patch", [(0, 0, 1)], size=12, repeat=3)
    assert_close(picture, albedo.repeat(1, 3, 3))


@pytest.mark.parametrize("height, width, rows", [(2, 4, 5), (4, 2, 20), (1, 100, 1)])
def test_patch_keeps_texels_square(height, width, rows):
    assert render(_white(height, width), "patch", size=10).shape == (3, rows, 10)


def test_patch_is_black_for_a_light_or_view_below():
    assert not bool(render(_white(), "patch", [(0.5, 0, -0.5)], size=4).any())
    assert not bool(render(_white(), "patch", [(0, 0, 1)], view=(1, 0, -0.1), size=4).any())


@pytest.mark.parametrize("light", [(0.0, 0.0, 1.0), (-0.4, 0.5, 0.768), (1.0, 0.0, 0.0), (0.3, -0.8, -0.2)])
def test_sphere_of_a_constant_texture_is_analytic(dtype, light):
    size = 16
    picture = render(_white(dtype=dtype), "sphere", [light], size=size)
    length = math.sqrt(sum(k * k for k in light))
    expected = torch.zeros(size, size, dtype=torch.float64)
    for row in range(2 * size):
        for column in range(2 * size):
            x, y = ((column + 0.5) / size - 1) * 1.02, -((row + 0.5) / size - 1) * 1.02
            if x * x + y * y < 1:
                n_dot_l = (x * light[0] + y * light[1] + math.sqrt(1 - x * x - y * y) * light[2]) / length
                expected[row // 2, column // 2] += max(0.0, n_dot_l) / 4
    # The sphere is 65,024 flat triangles, the pixels at its outline see that: measured 4e-4.
    assert_close(picture, (ALBEDO * expected).to(dtype), 1e-3)


def test_sphere_seen_from_the_right_is_what_the_front_shows_under_lights_turned_with_it(dtype):
    # From +x the picture's right is -z and what lies toward the camera is +x.
    material, sphere = _white(dtype=dtype), make_mesh("sphere")
    x, y, z = light = (0.3, -0.2, 0.9)
    front = render(material, sphere, [light], size=16)
    assert_close(render(material, sphere, [(z, y, -x)], view=(1, 0, 0), size=16), front, 1e-3)  # other triangles
    assert float((render(material, sphere, [light], view=(1, 0, 0), size=16) - front).abs().max()) > 0.1


def test_sphere_turns_a_bumped_normal_with_the_surface():
    # A normal tilted toward +x of the texture looks to the right at the front of the sphere.
    normal = torch.tensor([0.6, 0, 0.8], dtype=torch.float64)[:, None, None].expand(3, 2, 2)
    picture = render(Lambert({"albedo": torch.ones_like(normal), "normal": normal}), "sphere", [(0, 0, 1)], size=33)
    row = picture[0, 16]
    # The brightest point is where the surface leans 36.87 degrees to the left: x = -0.6.
    place = ((float(row.argmax()) + 0.5) / 33 * 2 - 1) * 1.02
    assert abs(place + 0.6) < 0.1
    assert float(row.max()) > 0.99


def test_sphere_shows_the_texture_upright():
    albedo = torch.zeros(3, 4, 4, dtype=torch.float64)
    albedo[0, :2] = 1  # the upper half is red
    albedo[1, 2:] = 1  # the lower half is green
    picture = render(Texture({"albedo": albedo}, ), "sphere", [(0, 0, 1)], size=32)
    # v = 0 at the equator and 1 at the pole: green to 45 degrees of latitude, then red, and so again below.
    for row, red in ((2, True), (12, False), (18, True), (29, False)):
        seen = picture[:2, row, 16]
        assert float(seen[0 if red else 1]) > 0.2
        assert float(seen[0 if red else 1]) > 2 * float(seen[1 if red else 0])  # filtered at the seams


@pytest.mark.parametrize("mesh", ["patch", "sphere"])
def test_lights_add_up_and_their_length_does_not_matter(mesh):
    material = make("phong_srf", {"residual": "half", "base": "phong"})
    one, other = (0.3, 0.2, 0.8), (-0.5, 0.1, 0.4)
    both = render(material, mesh, [one, tuple(7 * k for k in other)], size=8)
    assert_close(both, render(material, mesh, [one], size=8) + render(material, mesh, [other], size=8))
    assert not bool(render(material, mesh, [], size=8).any())


def test_each_option_reaches_the_picture():
    material, torus, lights = _white(), make_mesh("torus", segments=24), [(1, 0.3, 0.2)]
    plain = render(material, torus, lights, view=(0, 1, 1), size=(30, 50))
    assert plain.shape == (3, 30, 50)
    changed = {
        "shadows": {"shadows": True}, "rays": {"rays": 1}, "camera": {"camera": Camera((0, 3, 3))},
        "view": {"view": (1, 1, 0)}, "edges_only": {"edges_only": True},
    }
    for name, options in changed.items():
        other = render(material, torus, lights, **{"view": (0, 1, 1), "size": (30, 50), **options})
        assert float((other - plain).abs().max()) > 1e-4, name


def test_background_is_black():
    picture = render(_white(), "sphere", [(0, 0, 1)], size=40)
    corner = picture[:, [0, 0, -1, -1], [0, -1, 0, -1]]
    assert not bool(corner.any())
    assert float(picture[:, 20, 20].min()) > 0.19


@pytest.mark.parametrize("name, options", CASES)
@pytest.mark.parametrize("mesh", ["patch", "sphere"])
def test_every_model_renders(name, options, mesh, dtype):
    picture = render(make(name, options, 3, 4, dtype), mesh, [(0.1, 0.2, 0.9), (0, 0.9, 0.1)], size=9)
    assert bool(torch.isfinite(picture).all())
    assert bool((picture >= 0).all())
    assert float(picture.max()) > 0


@pytest.mark.parametrize("size", [1, 3])
@pytest.mark.parametrize("mesh", ["patch", "sphere"])
def test_tiny_pictures_and_one_texel(mesh, size):
    picture = render(_white(1, 1), mesh, [(0, 0, 1)], size=size)
    assert picture.shape == (3, size, size)
    assert float(picture[0, size // 2, size // 2]) > 0.5


def test_rendering_keeps_no_graph():
    assert not render(_white(), "patch", size=2).requires_grad


def test_errors():
    material = _white()
    with pytest.raises(RangeError, match=r"mesh must be one of .*Did you mean 'sphere'\?"):
        render(material, "spere")
    with pytest.raises(RangeError, match="size and repeat must be positive; they are 0 and 1.0"):
        render(material, size=0)
    for repeat in (0.0, -1.0, math.inf, math.nan):
        with pytest.raises(RangeError, match="size and repeat must be positive"):
            render(material, repeat=repeat)
    with pytest.raises(ShapeError, match=r"light must be x, y, z; its shape is \(2,\)"):
        render(material, lights=[(1, 2)])
    with pytest.raises(ShapeError, match="light must be x, y, z"):
        render(material, lights=(0, 0, 1))
    for bad in ((0, 0, 0), (math.nan, 0, 1), (math.inf, 0, 0)):
        with pytest.raises(RangeError, match="light must be a finite direction"):
            render(material, lights=[bad])
    for bad in ((0, 0, 0), (math.nan, 0, 1)):
        for mesh in ("patch", "sphere"):
            with pytest.raises(RangeError, match="must be a finite direction"):
                render(material, mesh, view=bad, size=2)
    for size in ((4,), (4, 0), 2.5):
        with pytest.raises(RangeError, match="size and repeat must be positive"):
            render(material, size=size)
    with pytest.raises(RangeError, match="size of a patch must be its columns"):
        render(material, "patch", size=(4, 4))
    with pytest.raises(RangeError, match="the lights of a patch must be directional"):
        render(material, "patch", [Point((0, 0, 1))], size=4)
    with pytest.raises(RangeError, match="the camera must lie outside of the mesh 'sphere'"):
        render(material, "sphere", camera=Camera((0, 0, 0.5)), size=4)
    with pytest.raises(RangeError, match="the light must lie outside of the mesh 'sphere'"):
        render(material, "sphere", [Point((0, 0, 0.5))], size=4)


def test_a_patch_that_repeats_too_often_to_be_seen_is_the_mean():
    checks = (torch.arange(8)[:, None] + torch.arange(8)).remainder(2).double().expand(3, 8, 8)
    picture = render(Texture({"albedo": checks}), "patch", [(0, 0, 1)], size=10, repeat=73)
    assert_close(picture, torch.full((3, 10, 10), 0.5, dtype=torch.float64), 1e-9)


def test_what_cannot_be_rendered_is_named():
    for wrong in ("my_material", 3, None):
        with pytest.raises(RangeError, match="material must be a Material, a Brdf or a RawBtf"):
            render(wrong)
