"""Near lights and cameras over a relief: recovery, samples on the surface, and models that step."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tests.fitting.near_data import bumps, degrees, dome, lambert, places, scene, towards
from tests.support import assert_close

from torchmat import Btf, fit, recover_geometry
from torchmat.btf.lambert import relief_of_one_view, stereo_of
from torchmat.fitting.relief.surface import ViewSlopes, bring_onto
from torchmat.fitting.training import make_training

SIZE = (12, 16)
HEIGHT, NORMAL = bumps(*SIZE, 0.02)
LIGHTS = dome(24, highest_deg=50)


@pytest.fixture(scope="module")
def rough():
    albedo = 0.4 + 0.3 * np.random.default_rng(2).random((3, *SIZE))
    return scene(lambert(albedo, NORMAL), HEIGHT, NORMAL, LIGHTS)


def test_recovery_is_under_half_as_far_off(rough):
    near, far = (recover_geometry(data, tiles=False, progress=False).relief for data in (rough.btf, rough.far))
    assert degrees(near.normal, NORMAL).mean() < 0.1 * degrees(far.normal, NORMAL).mean()
    found, wrong = ((relief.height[0].double().numpy() - HEIGHT).std() / HEIGHT.std() for relief in (near, far))
    assert found < 0.1 < 1 < wrong


def test_samples_on_the_surface_have_its_directions(rough):
    height = torch.from_numpy(HEIGHT)[None]
    training = make_training(rough.btf, torch.arange(24), 0, False, torch.float64, False)
    surface = bring_onto(training, height)
    assert_close(surface.training.btf.directions(range(24))[0], torch.from_numpy(rough.light), 1e-9)
    assert_close(surface.values(slice(0, 24))[0], rough.btf.images(range(24), torch.float64), 1e-9)  # the view is along z


@pytest.mark.parametrize("model, options", [
    ("lambert", {}), ("microfacet", {"effort": 0.05, "anisotropy": False, "coat": False, "sheen": False, "f90": False, "layered": False, "rolloff": False}),
    ("distribution", {"effort": 0.05, "lobes": 0}),
])
def test_models_on_a_given_height(rough, model, options):
    errors = []
    for data in (rough.btf, rough.far):
        result = fit(data, model, geometry=torch.from_numpy(HEIGHT)[None], tiles=False, relief="fast", measure="quick", progress=False, **options)
        errors.append(result.report["held_out"]["relative_error"])
        assert ("near" in result.report["source"]) == (data is rough.btf)
    assert errors[0] < 0.35 * errors[1], errors


def test_near_cameras_see_what_is_raised_where_their_rays_meet_the_plane():
    camera, raised = np.array([0.2, -0.1, 1.5]), 0.2
    x, y = places(*SIZE)
    image = np.stack((2 + x, 2 + y, np.ones_like(x)))[None]
    btf = Btf.from_tensors(image, np.array([[0.0, 0.0, 1.0]]), None, view_position=camera[None])
    training = make_training(btf, torch.arange(1), 0, False, torch.float64, False)
    surface = bring_onto(training, torch.full((1, *SIZE), raised, dtype=torch.float64))
    found = surface.values(slice(0, 1))[0][0]
    share = raised / (camera[2] - raised)  # a ray goes on so much further below the surface as it has come above it
    over = btf.with_near(btf.near.raised(torch.full((1, *SIZE), raised)))
    slope = ViewSlopes(over, torch.float64).of(torch.tensor([0]))[0] * torch.tensor([1.0, SIZE[0] / SIZE[1]])[:, None, None]
    truth = torch.from_numpy(share * (camera[:2, None, None] - np.stack((x, y))))
    assert_close(raised * slope, truth, 1e-6)
    moved = torch.from_numpy(np.stack((x, y))) - (found[:2] - 2)
    inside = (slice(None), slice(3, -3), slice(3, -3))  # at the border texels go on; cubic interpolation bends lines a little
    assert_close(moved[inside], truth[inside], 0.15)
    view = surface.training.btf.directions([0])[1][0]
    gap = np.stack((camera[0] - x, camera[1] - y, np.full_like(x, camera[2] - raised)))
    assert_close(view, torch.from_numpy(gap / np.linalg.norm(gap, axis=0)), 1e-9)


def test_views_of_near_cameras_are_shaded_as_they_were_made():
    """What a fit shows of a relief under near lights and cameras agrees with images that it was made from."""
    height, normal = bumps(*SIZE, 0.004)
    views = dome(5, 2.0, 30)
    lights = np.repeat(LIGHTS[:8], 5, axis=0)
    light, darker = towards(lights, height)
    point = torch.from_numpy(lambert(np.full((3, *SIZE), 0.5), normal)(light) * darker)
    btf = Btf.from_tensors(point, None, None, light_position=lights, view_position=np.tile(views, (8, 1)))
    result = fit(btf, "lambert", geometry=torch.from_numpy(height)[None], tiles=False, relief="fast", holdout=0.2, dtype=torch.float64)
    assert result.report["held_out"]["relative_error"] < 0.01 and len(btf.views) == 5


def test_an_object_inside_a_mask_stands_on_the_plane():
    x, y = places(24, 32)
    ball = np.sqrt(np.clip(0.4**2 - x * x - y * y, 0, None)) - 0.25
    mask = ball > 0
    up, across = np.gradient(np.where(mask, ball, 0), 1 / 32)
    normal = np.stack((-across, up, np.ones_like(x)))
    normal /= np.linalg.norm(normal, axis=0)
    made = scene(lambert(np.full((3, 24, 32), 0.5), normal), np.where(mask, ball, 0), normal, LIGHTS)
    found = {}
    for name, btf in (("near", made.btf), ("far", made.far)):
        relief = relief_of_one_view(btf.masked(torch.from_numpy(mask)), torch.arange(24), torch.float32)
        found[name] = degrees(relief.normal, normal)[mask].mean()
    plane = degrees(stereo_of(made.btf, torch.arange(24), torch.float32).normal, normal)[mask].mean()
    assert found["near"] < 0.3 * plane and plane < 0.5 * found["far"], (found, plane)
