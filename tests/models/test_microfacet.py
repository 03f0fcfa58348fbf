"""The microfacet material: values by hand, energy, reciprocity, its ends, and what renderers call its maps."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from tests.fitting.test_add_a_model import ggx_value
from tests.models.examples import assert_same, directions, make, make_maps, per_image
from tests.models.test_distribution import _grazing_pair, differentiated, plane, polar

from torchmat import RangeError, ShapeError, load_material, save_material
from torchmat.models import Microfacet
from torchmat.models.microfacet import MICROFACET_PARTS
from torchmat.models.renderers import alphas_of_gltf, alphas_of_openpbr, as_gltf, as_openpbr, from_metalness, to_metalness

LIGHT, VIEW = (per_image(directions(20, seed=seed)) for seed in (1, 2))
OTHER = [part for part in MICROFACET_PARTS if part != "normal"]


def texel(*roughness: float, parts=(), f0: float = 0.5, dtype=torch.float64, **maps: torch.Tensor) -> Microfacet:
    """Return one texel, black but for its lobe of one F0."""
    own = {"diffuse": plane(0.0, 0.0, 0.0), "specular_f0": plane(f0, f0, f0), "roughness": plane(*roughness)} | maps
    return Microfacet({name: value.to(dtype) for name, value in own.items()}, parts=parts)


def test_isotropic_it_is_walters_formula():
    diffuse, f0, alpha = 0.3, 0.6, 0.35
    material = texel(math.sqrt(alpha), f0=f0, diffuse=plane(diffuse, diffuse, diffuse))
    for light, view in zip(LIGHT[:, :, 0, 0].numpy(), VIEW[:, :, 0, 0].numpy(), strict=True):
        cosine = float(np.linalg.norm(light + view)) / 2
        matte = ggx_value(diffuse, 0.0, alpha, light, view)
        wanted = matte + (ggx_value(diffuse, 1.0, alpha, light, view) - matte) * (f0 + (1 - f0) * (1 - cosine) ** 5)
        found = material.shade(*(torch.tensor(d)[:, None, None] for d in (light, view)))[0, 0, 0].detach()
        assert abs(float(found) / wanted - 1) < 2e-3  # 1e-4 beside the denominator, which is at least 0.1


def test_along_the_normal_by_hand(dtype):
    # D = 1 / (pi alpha_u alpha_v), G = 1: pi D F0 / 4.
    material = texel(math.sqrt(0.5), math.sqrt(0.2), f0=0.8, parts=["anisotropy"], dtype=dtype, rotation=plane(1.0, 0.0))
    up = polar(0, 0, dtype)
    assert_same(material.shade(up, up).detach()[:, 0, 0], torch.full((3,), 0.8 / (4 * 0.1), dtype=dtype), 2e-4)


def test_the_highlight_is_longest_along_the_rotated_direction():
    for angle in (0.0, 0.7, 2.0):
        turn = plane(math.cos(angle), math.sin(angle))
        material = texel(0.8, 0.3, parts=["anisotropy"], rotation=turn)
        degrees = math.degrees(angle)
        along, across = (float(material.shade(polar(50, degrees + more), polar(0)).detach().max()) for more in (0, 90))
        assert along > 20 * across


@pytest.mark.parametrize("angle_deg", [17.0, 45.0, 203.0])
def test_turning_the_surface_turns_the_rotation(angle_deg):
    cosine, sine = math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))
    turn = torch.tensor([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]], dtype=torch.float64)
    one, other = (texel(0.7, 0.4, parts=["anisotropy"], rotation=plane(*axis)) for axis in ((1.0, 0.0), (cosine, sine)))
    turned = [torch.einsum("ij,njhw->nihw", turn, d) for d in (LIGHT, VIEW)]
    assert_same(other.shade(*turned), one.shade(LIGHT, VIEW), 1e-10)


def test_equal_roughness_both_ways_is_isotropic():
    assert_same(texel(0.6, 0.6, parts=["anisotropy"], rotation=plane(0.6, 0.8)).shade(LIGHT, VIEW), texel(0.6).shade(LIGHT, VIEW))


@pytest.mark.parametrize("parts", [[], OTHER, ["layered"], ["coat"], ["sheen"]])
def test_reciprocity(parts):
    material = make("microfacet", {"parts": parts}, 3, 3)
    assert_same(material.shade(LIGHT, VIEW) / LIGHT[:, 2:], material.shade(VIEW, LIGHT) / VIEW[:, 2:], 1e-10)


def hemisphere_of_lights(count: int = 64):
    """Return lights [n, 3, 1, 1] at the midpoints of equal areas of the projected hemisphere: each stands for pi / n."""
    place = (torch.arange(count, dtype=torch.float64) + 0.5) / count
    radius, azimuth = torch.meshgrid(place.sqrt(), 2 * math.pi * place, indexing="ij")
    light = torch.stack((radius * azimuth.cos(), radius * azimuth.sin(), (1 - radius**2).sqrt())).flatten(1).T
    return light[:, :, None, None]


@pytest.mark.parametrize("roughness", [(0.5,), (0.75,), (1.0,), (0.9, 0.5)])
@pytest.mark.parametrize("view_deg", [0, 40, 75])
def test_a_white_furnace_gives_no_more_than_it_gets(roughness, view_deg):
    """F0 of 1: the mean of value / cos over equal projected areas is the albedo, at most 1."""
    light = hemisphere_of_lights()
    parts = ["anisotropy"] if len(roughness) == 2 else []
    material = texel(*roughness, f0=1.0, parts=parts, **({"rotation": plane(0.6, 0.8)} if parts else {}))
    with torch.no_grad():
        albedo = float((material.shade(light, polar(view_deg)) / light[:, 2:]).mean())
    assert 0.25 < albedo < 1.0
    if roughness == (1.0,) and view_deg == 0:
        assert abs(albedo - (1 - math.log(2))) < 1e-3  # D is 1 / pi there, and G / (4 (n.l)(n.v)) 1 / (2 (1 + n.l))
    white = texel(*roughness, f0=0.04, parts=[*parts, "layered"], diffuse=plane(1.0, 1.0, 1.0), **(
        {"rotation": plane(0.6, 0.8)} if parts else {}))
    with torch.no_grad():
        assert float((white.shade(light, polar(view_deg)) / light[:, 2:]).mean()) < 1.0 + 2e-3


@pytest.mark.parametrize("roughness", [0.0, 1e-3, 0.5, 1.0])
@pytest.mark.parametrize("f0", [0.0, 1.0, 1.5])
@pytest.mark.parametrize("tilt_deg", [0, 70, 89.9])
def test_cases_1_2_3_7_the_ends_of_directions_roughness_and_f0(roughness, f0, tilt_deg, dtype):
    every = {
        "normal": polar(tilt_deg, 77), "rotation": plane(0.0, 1.0), "f90": plane(1.0), "coat": plane(min(1.0, f0)),
        "coat_roughness": plane(roughness), "sheen": plane(1.0, 0.0, 0.5), "sheen_roughness": torch.tensor([0.1]),
        "rolloff": torch.tensor([-1.0, 1.0]),
    }
    material = texel(roughness, 1 - roughness, f0=f0, parts=MICROFACET_PARTS, dtype=dtype, **every)
    pole = polar(0, 0, dtype)
    low = [polar(90 - math.degrees(1e-4), azimuth, dtype) for azimuth in (0, 77, 257)]
    for light, view in ((pole, pole), *((one, other) for one in low for other in (*low, pole))):
        differentiated(material, light, view)
    for light in (-pole, polar(120, 30, dtype)):
        assert not bool(differentiated(material, light, pole).any())


@pytest.mark.parametrize("apart_deg", [0, 60, 180])
def test_case_2_continuous_on_every_path_into_grazing(apart_deg, dtype):
    normal, alpha = polar(60), 0.2
    material = texel(math.sqrt(alpha), f0=1.0, parts=["normal"], dtype=dtype, normal=normal, diffuse=plane(0.1, 0.2, 0.3))
    heights = 0.5 * 1.1 ** -torch.arange(180.0, dtype=torch.float64)
    for cosines in ((heights, heights), (heights**2, heights), (heights, heights**2), (heights / 10, heights)):
        pairs = [_grazing_pair(normal, float(l), float(v), apart_deg, dtype) for l, v in zip(*cosines, strict=True)]
        value = differentiated(material, *(torch.stack(side) for side in zip(*pairs, strict=True)))[:, :, 0, 0]
        largest = 1 / alpha**2 / (4 * alpha)
        assert float((value[1:] - value[:-1]).abs().max()) < 0.12 * largest and float(value[-1].max()) < 1e-2 * largest


def test_a_rotation_of_length_0_is_no_turn_and_its_length_does_not_matter(dtype):
    light, view = LIGHT.to(dtype), VIEW.to(dtype)
    one, none, long = (texel(0.7, 0.4, parts=["anisotropy"], dtype=dtype, rotation=plane(*r)) for r in ((0.5, 0.0), (0.0, 0.0), (1.0, 0.0)))
    assert_same(none.shade(light, view), long.shade(light, view))
    assert_same(one.shade(light, view), long.shade(light, view))
    differentiated(none, polar(30, 10, dtype), polar(85, 0, dtype))


@pytest.mark.parametrize("part", OTHER)
def test_an_absent_part_is_its_neutral_value(part):
    if part in ("anisotropy", "layered"):
        return  # equal roughness, above, and what a layer takes, below
    neutral = {
        "f90": {"f90": plane(1.0)}, "coat": {"coat": plane(0.0), "coat_roughness": plane(0.5)},
        "sheen": {"sheen": plane(0.0, 0.0, 0.0), "sheen_roughness": torch.tensor([0.5])}, "rolloff": {"rolloff": torch.zeros(2)},
    }[part]
    kept = {"diffuse": plane(0.1, 0.2, 0.3)}
    found = texel(0.6, parts=[part], **kept, **neutral).shade(LIGHT, VIEW)
    bare = texel(0.6, **kept).shade(LIGHT, VIEW)
    assert_same(found, bare)


def test_less_than_2_percent_reflect_less_at_grazing_and_nothing_has_no_lobe():
    light, view = polar(80, 0), polar(80, 180)
    found = [float(texel(0.3, f0=f0).shade(light, view).detach().max()) for f0 in (0.0, 0.01, 0.02)]
    rise = (1 - math.cos(math.radians(80))) ** 5
    assert found[0] == 0 and abs(found[1] / found[2] - (0.01 + 0.49 * rise) / (0.02 + 0.98 * rise)) < 1e-9


def test_a_layer_lets_through_what_it_does_not_reflect():
    # At 60 degrees 1 - cos is 1/2: F is 0.2 + 0.8 / 32. Roughness 1 is taken off.
    light, view = polar(60, 0), polar(60, 180)
    under = texel(1.0, f0=0.2, parts=["layered"], diffuse=plane(1.0, 1.0, 1.0)).shade(light, view)
    alone = texel(1.0, f0=0.2).shade(light, view)
    assert_same((under - alone).flatten().detach(), torch.full((3,), 0.5 * (1 - 0.225) ** 2, dtype=torch.float64))


def test_the_roll_off_by_hand():
    found = texel(1.0, f0=0.0, f90=plane(0.0), parts=["rolloff", "f90"], diffuse=plane(1.0, 1.0, 1.0), rolloff=torch.tensor([0.2, -0.4], dtype=torch.float64))
    curve = 1 + 0.2 / 2 - 0.4 / 32
    assert_same(found.shade(polar(60), polar(0))[:, 0, 0].detach(), torch.full((3,), 0.5 * curve, dtype=torch.float64))


@pytest.mark.parametrize("storage", ["png8", "half", "paint8"])
def test_round_trip(storage, tmp_path):
    material = make("microfacet", {"parts": list(MICROFACET_PARTS)}, 5, 4, torch.float32, storage=storage)
    loaded = load_material(save_material(material, tmp_path / "out"))
    light, view = LIGHT.float(), VIEW.float()
    assert type(loaded) is Microfacet and loaded.options == material.options
    assert torch.equal(loaded.shade(light, view), material.as_exported().shade(light, view))


def test_what_is_no_material_is_refused():
    with pytest.raises(RangeError, match="roughness must lie in"):
        texel(1.1)
    with pytest.raises(RangeError, match="specular_f0 must lie in"):
        texel(0.5, f0=-0.1)
    with pytest.raises(RangeError, match="'sheen'"):
        texel(0.5, parts=["shen"])
    with pytest.raises(ShapeError, match="roughness must be"):
        texel(0.5, parts=["anisotropy"], rotation=plane(1.0, 0.0))


def test_slopes_of_height_and_normal_add_up():
    maps = make_maps("microfacet", {"parts": ["normal"]}, 6, 8)
    flat = Microfacet(maps, parts=["normal"])
    level = flat.on_relief(torch.zeros(1, 6, 8, dtype=torch.float64))
    assert_same(level.surface().maps["normal"], flat.maps["normal"], 1e-12)
    back = level.from_surface({name: value for name, value in level.surface().maps.items()})
    assert_same(back["normal"], flat.maps["normal"], 1e-12)


def test_gltf_and_openpbr_alphas_come_back():
    maps = make_maps("microfacet", {"parts": ["anisotropy", "f90", "coat"]}, 4, 5)
    material = Microfacet(maps, parts=["anisotropy", "f90", "coat"])
    alpha = maps["roughness"] ** 2
    wanted = torch.stack((alpha.amax(dim=0), alpha.amin(dim=0)))
    gltf, pbr = as_gltf(material), as_openpbr(material)
    assert_same(alphas_of_gltf(gltf.roughness, gltf.anisotropy), wanted, 1e-12)
    assert_same(alphas_of_openpbr(pbr.specular_roughness, pbr.specular_roughness_anisotropy), wanted, 1e-12)
    assert torch.equal(gltf.direction, pbr.direction)
    turned = material.with_maps(roughness=wanted.sqrt(), rotation=gltf.direction)
    assert_same(turned.shade(LIGHT, VIEW), material.shade(LIGHT, VIEW), 1e-10)
    assert_same(gltf.specular_colour * 0.04 * gltf.specular, maps["specular_f0"], 1e-12)
    assert_same(gltf.specular, maps["f90"] * (50 * maps["specular_f0"].mean(dim=0, keepdim=True)).clamp(max=1), 1e-12)
    assert torch.equal(gltf.clearcoat * 0.04, maps["coat"] / 0.04 * 0.04)
    bare = as_gltf(texel(0.5))
    assert bare.anisotropy is None and bare.clearcoat is None and float(bare.roughness) == 0.5
    assert float(as_openpbr(texel(0.0)).specular_roughness_anisotropy) == 0


def test_metalness_by_hand_and_back():
    base = torch.rand(3, 8, 8, dtype=torch.float64) * 0.8 + 0.1
    metal = torch.linspace(0, 1, 64, dtype=torch.float64).reshape(1, 8, 8)
    diffuse, f0 = from_metalness(base, metal)
    found = to_metalness(diffuse, f0)
    grey = to_metalness(*from_metalness(base[:1].expand(3, -1, -1), metal))
    assert_same(grey[0], base[:1].expand(3, -1, -1), 1e-6)
    assert_same(grey[1], metal, 1e-6)
    again = from_metalness(*found)
    assert_same(again[0], diffuse, 0.05)
    assert_same(again[1], f0, 0.05)
    dark = to_metalness(plane(0.3, 0.2, 0.1), plane(0.02, 0.02, 0.02))
    assert float(dark[1]) == 0 and torch.equal(dark[0], plane(0.3, 0.2, 0.1))
