"""Smith's masking in the distribution material: values by hand, the printed formula beside it, and the hard cases 1 to 8."""

from __future__ import annotations

import json
import math

import pytest
import torch
from tests.models.distributions import MASKED, distribution, shaded
from tests.models.examples import assert_same, directions, per_image
from tests.models.test_distribution import COLOUR, _grazing_pair, build, colour_of, differentiated, plane, polar, random_table

from torchmat import RangeError, load_material, save_material
from torchmat.create.edits import tilt as edit_tilt
from torchmat.material_io.packing import pack, unpack
from torchmat.models.blend import blend
from torchmat.models.distribution import Distribution, default_tilt
from torchmat.models.edit import add_part, drop_part, neutral_part, replace_map

LIGHT, VIEW = (per_image(directions(20, seed=seed)) for seed in (1, 2))


def masked(alpha_u: float, alpha_v: float, dtype=torch.float64, **given) -> Distribution:
    """Return one texel of a specular map of COLOUR under masking of two numbers."""
    bare = build(dtype, **given)
    return add_part(bare, "masking", torch.tensor([alpha_u, alpha_v], dtype=dtype))


def test_values_by_hand(dtype):
    # Along the normal both roots are 1: the denominator is 2. At 60 and 60 degrees across, of roughness 1/2 along x:
    # 2 * 1/2 * sqrt(1/4 * 3/4 + 1/4) = sqrt(7) / 4; along y, of roughness 1: sqrt(3/4 + 1/4) = 1.
    material = masked(0.5, 1.0, dtype)
    for light, view, denominator in (
        (polar(0, 0, dtype), polar(0, 0, dtype), 2.0), (polar(60, 0, dtype), polar(60, 180, dtype), math.sqrt(7) / 4),
        (polar(60, 90, dtype), polar(60, 270, dtype), 1.0),
    ):
        share = math.pi * float(light[2]) / (denominator + 1e-4)
        assert_same(colour_of(material, light, view), torch.tensor(COLOUR, dtype=dtype) * share)


def test_a_quarter_turn_swaps_the_two_numbers(dtype):
    light, view = LIGHT.to(dtype), VIEW.to(dtype)
    turned, swapped = masked(0.2, 0.7, dtype, rotation=plane(0.0, 1.0)), masked(0.7, 0.2, dtype)
    assert_same(turned.shade(light, view), swapped.shade(light, view))


def test_roughness_1_has_no_masking_but_the_sum_of_cosines():
    # |d| is 1: D without its product.
    share = math.pi * LIGHT[:, 2:] / (LIGHT[:, 2:] + VIEW[:, 2:] + 1e-4)
    assert_same(masked(1.0, 1.0).shade(LIGHT, VIEW), share * torch.tensor(COLOUR, dtype=torch.float64)[:, None, None])


def test_rough_metal_grows_towards_grazing_as_ggx_does():
    """What D cannot do: a lobe of GGX over its peak at the pole, at 74 degrees against the mirror image."""
    alpha, up = 0.25, polar(0)
    steep = polar(74, 0), polar(74, 180)
    cosine = math.cos(math.radians(74))
    lambda_ = (math.sqrt(1 + (alpha * math.tan(math.radians(74))) ** 2) - 1) / 2
    expected = (1 / (1 + 2 * lambda_)) / cosine  # G / (n.l n.v) n.l, of the same half vector
    with_smith, printed = masked(alpha, alpha), build()
    found = [float((colour_of(m, *steep) / colour_of(m, up, up))[0]) for m in (with_smith, printed)]
    assert abs(found[0] / expected - 1) < 1e-3 and found[1] < 0.6 * expected


def test_gradients_of_masking_match_differences():
    material = masked(0.2, 0.6, specular=random_table(), rotation=plane(0.6, 0.8), fresnel=plane(0.3))
    material.shade(LIGHT, VIEW).sum().backward()
    step, numbers = 1e-6, torch.tensor([0.2, 0.6], dtype=torch.float64)
    for which in range(2):
        move = step * torch.eye(2, dtype=torch.float64)[which]
        above, below = (material.with_maps(masking=numbers + sign * move).shade(LIGHT, VIEW).detach().sum() for sign in (1, -1))
        assert abs(float(material.maps["masking"].grad[which]) - float(above - below) / (2 * step)) < 1e-6


def test_reciprocity_and_rotation_with_the_surface():
    material = masked(0.3, 0.3, diffuse=plane(0.1, 0.2, 0.3))
    assert_same(material.shade(LIGHT, VIEW) / LIGHT[:, 2:], material.shade(VIEW, LIGHT) / VIEW[:, 2:], 1e-11)
    cosine, sine = math.cos(0.7), math.sin(0.7)
    turn = torch.tensor([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]], dtype=torch.float64)
    turned = [torch.einsum("ij,njhw->nihw", turn, d) for d in (LIGHT, VIEW)]
    assert_same(material.shade(*turned), material.shade(LIGHT, VIEW), 1e-11)


@pytest.mark.parametrize("alpha", [(0.0, 0.0), (1e-3, 1.0), (0.3, 0.3), (1.0, 1.0), (5.0, 0.0)])
@pytest.mark.parametrize("tilt_deg", [0, 70, 89.9])
def test_cases_1_2_3_7_directions_and_roughness_at_their_ends(alpha, tilt_deg, dtype):
    normal = polar(tilt_deg, 77)
    material = masked(*alpha, dtype, normal=normal, specular=random_table(), fresnel=plane(0.0), rotation=plane(0.0, 1.0))
    pole = polar(0, 0, dtype)
    low = [polar(90 - math.degrees(1e-4), azimuth, dtype) for azimuth in (0, 77, 257)]
    for light, view in ((pole, pole), *((one, other) for one in low for other in (*low, pole))):
        differentiated(material, light, view)
    below = differentiated(material, -pole, pole)
    assert not bool(below.any())


@pytest.mark.parametrize("apart_deg", [0, 60, 130, 180])
@pytest.mark.parametrize("alpha", [(0.05, 0.05), (0.1, 0.5), (1.0, 1.0)])
def test_case_2_value_is_finite_and_continuous_on_every_path_into_grazing(alpha, apart_deg, dtype):
    normal = polar(60)
    material = masked(*alpha, dtype, normal=normal, diffuse=plane(0.1, 0.2, 0.3))
    heights = 0.5 * 1.1 ** -torch.arange(180.0, dtype=torch.float64)
    for cosines in ((heights, heights), (heights**2, heights), (heights, heights**2), (heights / 10, heights)):
        pairs = [_grazing_pair(normal, float(l), float(v), apart_deg, dtype) for l, v in zip(*cosines, strict=True)]
        value = differentiated(material, *(torch.stack(side) for side in zip(*pairs, strict=True)))[:, :, 0, 0]
        # Of a mirror-like surface the value grows as 1 / (2 a); a tenth less of a cosine is a fifth of its square.
        largest = math.pi * max(COLOUR) / (2 * min(alpha))
        assert float((value[1:] - value[:-1]).abs().max()) < 0.12 * largest
        assert float(value[-1].max()) < 1e-2 * largest


@pytest.mark.parametrize("storage", ["png8", "half"])
def test_the_two_numbers_stand_in_the_manifest_and_cost_no_texel_a_byte(storage, tmp_path):
    material = distribution(4, 5, 1, MASKED, storage=storage, relief=True)
    bare = drop_part(material, "masking")
    assert material.bytes_per_texel == bare.bytes_per_texel and material.shared_bytes == bare.shared_bytes + 8
    folder = save_material(material, tmp_path / "m")
    manifest = json.loads((folder / "manifest.json").read_text())
    assert manifest["constants"]["masking"] == material.maps["masking"].tolist() and manifest["version"] == 1
    loaded = load_material(folder)
    assert torch.equal(loaded.maps["masking"], material.maps["masking"]) and loaded.options == material.options
    assert torch.equal(shaded(loaded), shaded(material.as_exported()))


def test_materials_of_earlier_versions_mean_the_printed_formula(tmp_path):
    material = distribution(4, 5, 2, MASKED[:-1])
    folder = save_material(material, tmp_path / "m")
    assert "masking" not in (folder / "manifest.json").read_text()
    assert torch.equal(shaded(load_material(folder)), shaded(material.as_exported()))


def test_without_masking_it_is_the_printed_formula_to_the_bit():
    material = distribution(6, 5, 2, MASKED[:-1])
    again = drop_part(add_part(material, "masking", torch.tensor([0.3, 0.3])), "masking")
    assert torch.equal(shaded(again), shaded(material))


def test_packed_it_comes_back(tmp_path):
    material = distribution(4, 5, 2, MASKED, relief=True)
    assert torch.equal(unpack(pack(material, tmp_path / "p")).maps["masking"], material.maps["masking"])


def test_edits():
    material = distribution(4, 5, 1, MASKED)
    numbers = torch.tensor([0.1, 0.2])
    assert torch.equal(replace_map(material, "masking", numbers).maps["masking"], numbers)
    bent = edit_tilt(material, "gentle")
    assert bent.options["parts"] == ["normal", "specular_mask", "fresnel", "rotation", "tilt"]
    with pytest.raises(RangeError, match="tilt or masking; they hold both"):
        add_part(material, "tilt")
    with pytest.raises(RangeError, match="masking replaces D"):
        neutral_part(material, "masking")
    with pytest.raises(RangeError, match="masking must lie in"):
        replace_map(material, "masking", -numbers)


def test_blends_mix_the_numbers_or_say_what_does_not_fit():
    first, second = (distribution(4, 5, 1, MASKED, seed=seed) for seed in (0, 1))
    half = blend(first, second, 0.5).maps["masking"]
    assert_same(half, (first.maps["masking"] + second.maps["masking"]) / 2)
    with pytest.raises(RangeError, match="weight must be a number"):
        blend(first, second, torch.full((1, 4, 5), 0.5))
    with pytest.raises(RangeError, match="one has Smith's masking, the other D"):
        blend(first, drop_part(second, "masking"), 0.5)


def test_masking_of_a_material_without_lobes_changes_nothing():
    bare = distribution(4, 5, 0, ())
    assert torch.equal(shaded(add_part(bare, "masking", torch.tensor([0.3, 0.3]))), shaded(bare))
    assert default_tilt().shape == (1, 1, 91)
