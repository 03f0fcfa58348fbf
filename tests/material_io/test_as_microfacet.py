"""Any material as a microfacet one: exact where it is one, near where one lobe suffices, and the error that is measured."""

from __future__ import annotations

import math

import pytest
import torch
from tests.models.distributions import distribution
from tests.models.examples import directions, make, per_image

import torchmat as tm
from torchmat import Btf, RangeError
from torchmat.create.from_textures import ggx_lobe
from torchmat.errors import ShapeError
from torchmat.material_io.as_microfacet import as_microfacet, held_out_error, shading_error
from torchmat.material_io.as_microfacet.directions import lobe_pairs, measured_pairs
from torchmat.material_io.as_microfacet.lobes import kinds_of, schlick_terms, solve_two, weights_of
from torchmat.models import Distribution, Lambert, Microfacet, Texture


def smooth(roughness: float, count: int = 1, **maps: torch.Tensor) -> Distribution:
    """Return a distribution material whose specular map is GGX's, masked as GGX is."""
    found = {"diffuse": torch.full((3, 2, 3), 0.2), "specular": ggx_lobe(roughness, 128), "masking": torch.full((2,), roughness**2)}
    return Distribution({**found, **maps}, parts=["masking", *maps])


@pytest.mark.parametrize("pairs", [measured_pairs, lobe_pairs])
def test_directions_are_unit_above_the_surface_and_always_the_same(pairs):
    light, view = pairs()
    for direction in (light, view):
        assert float((direction.norm(dim=1) - 1).abs().max()) < 1e-12 and float(direction[:, 2].min()) > 0.05
    assert all(torch.equal(one, other) for one, other in zip(pairs(), (light, view), strict=True)) and len(light) > 100


def test_half_vectors_of_the_lobes_are_those_that_are_meant():
    light, view = lobe_pairs()
    half = torch.nn.functional.normalize(light + view, dim=1)
    polar = torch.rad2deg(torch.acos(half[:, 2].clamp(max=1)))
    assert sorted({round(float(angle), 3) for angle in polar})[:4] == [0.0, 1.5, 3.5, 6.0]


def test_the_error_is_the_relative_one_by_hand():
    white, grey = (Texture({"albedo": torch.full((3, 2, 2), value)}) for value in (0.5, 0.4))
    assert shading_error(white, white) == 0
    assert shading_error(white, grey) == pytest.approx(0.04, rel=1e-5)  # ((0.5 - 0.4) / 0.5)^2
    assert math.isnan(shading_error(Texture({"albedo": torch.zeros(3, 2, 2)}), grey))
    with pytest.raises(ShapeError, match=r"what is held must be \(2, 2\)"):
        shading_error(white, Texture({"albedo": torch.zeros(3, 2, 3)}))


@pytest.mark.parametrize("parts", [[], ["normal", "anisotropy", "f90"], ["coat", "sheen", "rolloff", "layered"]])
def test_a_microfacet_material_is_itself(parts):
    material = make("microfacet", {"parts": parts}, 3, 4, torch.float32)
    found = as_microfacet(material)
    assert all(torch.equal(found.maps[name], value) for name, value in material.maps.items())
    assert shading_error(material, found) == 0


def test_a_relief_becomes_normals_and_opacity_stays():
    material = make("microfacet", {"parts": ["normal"]}, 4, 4, torch.float32).on_relief(0.02 * torch.rand(1, 4, 4))
    material = material.with_maps(**{})._like({**material.maps, "opacity": torch.ones(1, 4, 4)})
    found = as_microfacet(material)
    assert not found.has_relief and torch.equal(found.maps["normal"], material.surface().maps["normal"])
    assert torch.equal(found.maps["opacity"], torch.ones(1, 4, 4))


@pytest.mark.parametrize("name", ["texture", "lambert"])
def test_matte_models_are_exact(name):
    material = make(name, {}, 3, 4, torch.float32)
    found = as_microfacet(material)
    assert isinstance(material, Texture | Lambert) and shading_error(material, found) < 1e-12


@pytest.mark.parametrize(("roughness", "most"), [(0.35, 1e-3), (0.6, 1e-4), (0.9, 1e-5)])
def test_a_specular_map_of_ggx_is_found_again(roughness, most):
    material = smooth(roughness)
    found = as_microfacet(material)
    assert float(found.maps["roughness"].detach().mean()) == pytest.approx(roughness, rel=0.03)  # what is beside the lobe counts as diffuse too
    assert shading_error(material, found) < most
    assert float((found.maps["diffuse"].detach() - 0.2).abs().max()) < 2e-3


def test_mask_fresnel_normal_and_rotation_are_those_of_the_texel():
    base = distribution(3, 4, 1, ("normal", "rotation"))
    mask, fresnel = 0.2 + torch.rand(3, 2, 3), torch.rand(1, 2, 3)
    material = Distribution({
        "diffuse": torch.full((3, 2, 3), 0.1), "specular": ggx_lobe(0.5, 128), "masking": torch.full((2,), 0.25), "specular_mask": mask,
        "fresnel": fresnel, "normal": base.maps["normal"].detach()[:, :2, :3], "rotation": base.maps["rotation"].detach()[:, :2, :3],
    }, parts=["masking", "specular_mask", "fresnel", "normal", "rotation"], mask_channels=3)
    found = as_microfacet(material)
    assert shading_error(material, found) < 0.01  # F90 is grey
    ratio = found.maps["specular_f0"].detach() / (mask * fresnel)
    assert float(ratio.std() / ratio.mean()) < 1e-4
    assert torch.equal(found.maps["normal"], material.maps["normal"])


def test_other_exponents_than_schlicks_are_brought_to_his():
    assert schlick_terms(5.0) == (0.0, 1.0)
    low, rise = schlick_terms(2.4)
    assert 0 < low < 0.2 and 0.5 < rise < 4 and schlick_terms(12.0)[0] == 0
    maps = {"diffuse": torch.full((3, 2, 3), 0.1), "specular": ggx_lobe(0.5, 128), "masking": torch.full((2,), 0.25),
            "fresnel": torch.full((1, 2, 3), 0.1)}
    material = Distribution(maps, parts=["masking", "fresnel"], fresnel_exponent=2.4)
    assert shading_error(material, as_microfacet(material)) < 0.02  # measured: 0.0136
    plain = Distribution(maps, parts=["masking", "fresnel"])
    assert shading_error(material, as_microfacet(plain)) > 0.1  # measured: 0.21, as if it were Schlick's


@pytest.mark.parametrize(("more", "most"), [({}, 0.1), ({"masking": torch.full((2,), 0.9)}, 0.02)])  # measured: 0.084, 0.012
def test_masking_that_is_not_that_of_the_lobe_is_taken_up_at_grazing(more, most):
    maps = {"diffuse": torch.full((3, 2, 3), 0.1), "specular": ggx_lobe(0.5, 128), "fresnel": torch.full((1, 2, 3), 0.2)}
    material = Distribution(maps | more, parts=["fresnel", *more])
    assert shading_error(material, as_microfacet(material)) < most  # without a factor on F90: 0.19, 0.06


def test_mixtures_of_lobes_have_a_roughness_of_their_own():
    index = torch.tensor([[[1.0, 0.0, 0.5]], [[0.0, 1.0, 0.5]]])
    specular = torch.cat((ggx_lobe(0.3, 128), ggx_lobe(0.7, 128)))
    maps = {"diffuse": torch.zeros(3, 1, 3), "specular": specular, "index": index, "masking": torch.full((2,), 0.25)}
    found = as_microfacet(Distribution(maps, lobes=2, parts=["masking"]))
    sharp, soft, between = found.maps["roughness"].detach()[0, 0].tolist()
    assert (sharp, soft) == (pytest.approx(0.3, abs=0.03), pytest.approx(0.7, abs=0.05)) and sharp <= between < soft


def test_kinds_and_their_weights():
    index = torch.tensor([[[1.0, 0.0, 0.25]], [[0.0, 1.0, 0.75]]])
    kinds = kinds_of(index)
    assert len(kinds) == 3
    weights = weights_of(index, kinds)
    assert torch.allclose(torch.einsum("jhw,jk->khw", weights, kinds.float()), index, atol=1e-5)
    assert torch.allclose(weights.sum(dim=0), torch.ones(1, 3))


def test_two_factors_that_may_not_be_negative():
    first, second = torch.rand(50, dtype=torch.float64), torch.rand(50, dtype=torch.float64)
    wanted = torch.tensor([[0.5, 2.0, 0.0], [1.0, 0.0, 3.0]], dtype=torch.float64)
    target = first[:, None] * wanted[0] + second[:, None] * wanted[1]
    x, y, left = solve_two(first, second, target[..., None])
    assert torch.allclose(torch.stack((x, y))[..., 0], wanted, atol=1e-6) and float(left) < 1e-6
    x, y, _ = solve_two(first, second, (first[:, None] - 0.1 * second[:, None]).expand(50, 3)[..., None])
    assert float(y.max()) == 0 and float(x.min()) > 0.5


def test_one_lobe_of_samples_is_found():
    lobe = torch.tensor((0.3, 0.3, 0.3, 0.2, 0.2, 0.2, math.log(30.0)))
    material = make("phong_srf", {"residual": "half", "base": "phong"}, 3, 3, torch.float32)
    material = material.with_maps(lobe=lobe, residual=torch.zeros_like(material.maps["residual"]))
    found = as_microfacet(material)
    assert "anisotropy" not in found.options["parts"] and shading_error(material, found) < 0.05
    matte = as_microfacet(make("ptm", {}, 2, 2, torch.float32))
    assert isinstance(matte, Microfacet) and matte.size == (2, 2)


@pytest.mark.parametrize("name", ["sphere_images", "shading_map", "neural"])
def test_models_of_other_kinds_come_through(name):
    options = {"sphere_images": {"angles_deg": [0.0, 45.0, 90.0]}, "neural": {"latent": 3, "hidden": 5, "layers": 1}}
    material = make(name, options.get(name, {"slices": 4, "brdf": "phong"}), 2, 3, torch.float32)
    found = as_microfacet(material)
    assert found.size == material.size and shading_error(material, found) < 0.6  # random maps are no surface


def test_what_knows_measured_directions_alone_is_refused():
    with pytest.raises(RangeError, match="the material must be a BRDF; pca knows the directions that were measured"):
        as_microfacet(make("pca", {"components": 3}, 2, 3, torch.float32))


def test_the_error_against_samples_is_that_of_evaluate():
    material = make("microfacet", {"parts": []}, 3, 4, torch.float32)
    light, view = (directions(12, torch.float32, seed) for seed in (1, 2))
    with torch.no_grad():
        images = material.shade(per_image(light), per_image(view))


    btf = Btf.from_tensors(images, light, view)
    darker = material.with_maps(diffuse=0.5 * material.maps["diffuse"].detach())
    rows = torch.tensor([1, 4, 7])
    wanted = tm.evaluate(darker, btf, rows, perceptual=False).report["relative_error"]
    assert held_out_error(darker, btf, rows) == pytest.approx(wanted, rel=1e-9) and held_out_error(material, btf) < 1e-10
    with pytest.raises(ShapeError, match="btf must be 2 x 2 as the material"):
        held_out_error(make("microfacet", {"parts": []}, 2, 2, torch.float32), btf)
