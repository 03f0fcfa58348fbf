"""Fits of sphere images: the linear algebra against dense matrices, what is recovered, and what is gained."""

from __future__ import annotations

import math
from statistics import mean

import numpy as np
import pytest
import torch
from tests.support import all_pairs, assert_close, hemisphere, shared_path

import torchmat as tm
from torchmat import Btf
from torchmat.brdf import AnalyticBrdf, load_brdf
from torchmat.errors import FitError, RangeError
from torchmat.fitting.models.spheres.curves import CurvePrior, Derivative, GaussNewton, curve_prior
from torchmat.fitting.models.spheres.points import highlight_error, sphere_errors, sphere_points, unseen_lights
from torchmat.fitting.models.spheres.problem import Shape, SphereProblem
from torchmat.fitting.models.spheres.to_brdf import fewest_angles, fit_sphere_images
from torchmat.models import SphereImages
from torchmat.models.sphere_images import constant_turn, paper_turn

ANGLES = (0.0, 60.0, 120.0)
GLOSSY = AnalyticBrdf("ggx", diffuse=(0.3, 0.2, 0.1), specular=0.08, roughness=0.3, dtype=torch.float64)
MATTE = AnalyticBrdf("lambert", diffuse=(0.5, 0.4, 0.3), dtype=torch.float64)


def a_shape(rows: int = 4, samples: int = 5, seed: int = 0) -> Shape:
    """Return pictures at three angles and curves that are not the paper's."""
    generator = torch.Generator().manual_seed(seed)
    turn = 0.3 + 0.5 * torch.rand(1, rows, samples, dtype=torch.float64, generator=generator)
    return Shape(torch.deg2rad(torch.tensor(ANGLES, dtype=torch.float64)), turn)


def a_problem(size: int = 6, count: int = 150, brdf=GLOSSY) -> SphereProblem:
    points = sphere_points(brdf, (20.0, 50.0, 80.0, 130.0), count, 3)
    return SphereProblem(points.light, points.view, points.value, points.weight, size)


def random_pictures(problem: SphereProblem, count: int = 3) -> torch.Tensor:
    return torch.rand(problem.black(count).shape, dtype=torch.float64, generator=torch.Generator().manual_seed(5))


def as_material(images: torch.Tensor, shape: Shape) -> SphereImages:
    count = len(shape.angles)
    maps = {"images": images[0].unflatten(1, (count, -1)).transpose(0, 1).flatten(0, 1), "turn": shape.turn,
            "tint": images.new_ones(3, 1, 1)}
    return SphereImages(maps, angles_deg=torch.rad2deg(shape.angles).tolist())


@pytest.mark.parametrize("rows", [1, 4])
def test_the_problem_looks_up_what_the_material_shades(rows):
    problem, shape = a_problem(), a_shape(rows)
    images = random_pictures(problem)
    points = sphere_points(GLOSSY, (20.0, 50.0, 80.0, 130.0), 150, 3)
    shaded = as_material(images, shape).shade_at(torch.zeros(2, 1, points.light.shape[2]), points.light, points.view)
    lit = points.light[2, 0] > 0
    assert_close(problem.look(shape).apply(images)[:, lit], shaded[:, 0, lit], 1e-10)


def test_the_transpose_is_the_transpose():
    problem, shape = a_problem(), a_shape()
    looked_up = problem.look(shape)
    images = random_pictures(problem)
    values = torch.rand(problem.value.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(6))
    one, other = (looked_up.apply(images) * values).sum(), (images * looked_up.transpose(values)).sum()
    assert_close(one, other, 1e-12)


def test_conjugate_gradients_solve_the_normal_equations():
    problem, shape = a_problem(size=5), a_shape()
    looked_up = problem.look(shape)
    system = problem.system(looked_up, 0.01)
    size = problem.black(3)[0, 0].numel()
    units = torch.eye(size, dtype=torch.float64)
    units = [unit.reshape(1, 1, 15, 5).expand(1, 3, -1, -1).contiguous() for unit in units]
    columns = [system.apply(unit)[0, 0].flatten() for unit in units]
    matrix = torch.stack(columns, dim=1)
    assert_close(matrix, matrix.T, 1e-12)
    right = looked_up.transpose(problem.weight * problem.value)[0].flatten(1)
    expected = torch.linalg.solve(matrix, right.T).T
    found = problem.solve(looked_up, problem.black(3), 400, 0.01)
    assert_close(found[0].flatten(1), expected, 1e-8)


def test_smoothness_alone_settles_what_no_point_sees():
    problem, shape = a_problem(size=9, count=40), a_shape()
    seen = problem.look(shape).transpose(torch.ones_like(problem.value))
    assert bool((seen == 0).any())
    images = problem.solve(problem.look(shape), problem.black(3), 300)
    assert bool(torch.isfinite(images).all()) and float(images[seen == 0].abs().max()) > 0
    faded = problem.solve(problem.look(shape), problem.black(3), 300, 1e-3, 5.0)
    assert float(faded[seen == 0].abs().mean()) < float(images[seen == 0].abs().mean())


@pytest.mark.parametrize(("bend", "place"), [(True, True), (True, False), (False, True)])
def test_the_derivative_is_that_of_the_values(bend, place):
    problem, shape = a_problem(size=12), a_shape()
    images = random_pictures(problem)
    with torch.no_grad():
        looked_up = problem.look(shape, differentiable=True)
        derivative = Derivative(problem, looked_up, images, shape, bend, place)
        knots = shape.turn.numel() if bend else 0
        assert derivative.total == knots + (2 if place else 0)
        step, root = 1e-7, problem.weight.sqrt()
        for number in range(derivative.total):
            unit = torch.zeros(derivative.total, dtype=torch.float64)
            unit[number] = 1
            moved = []
            for sign in (1, -1):
                turn, angles = shape.turn.clone(), shape.angles.clone()
                if number < knots:
                    turn.view(-1)[number] += sign * step
                else:
                    angles[1 + number - knots] += sign * step
                moved.append(problem.look(Shape(angles, turn)).apply(images))
            expected = root * (moved[0] - moved[1]) / (2 * step)
            # A look-up is bilinear: where a step crosses a texel's edge differences and derivative may disagree.
            apart = (derivative.apply(unit) - expected).abs() > 1e-5 * float(expected.abs().max() + 1e-3)
            assert float(apart.double().mean()) < 0.01
            values = torch.linspace(-1, 1, problem.value.numel(), dtype=torch.float64).reshape(problem.value.shape)
            assert_close(derivative.transpose(values)[number], (derivative.apply(unit) * values).sum(), 1e-9)
        units = torch.eye(derivative.total, dtype=torch.float64)
        dense = torch.stack([derivative.apply(unit).flatten() for unit in units])
        assert_close(derivative.normal(), dense @ dense.T, 1e-9)


def test_the_prior_costs_bends_and_distance_and_nothing_else():
    turn = paper_turn(torch.float64)
    prior = curve_prior(torch.cat((turn, turn), dim=1), True, 2)
    assert isinstance(prior, CurvePrior) and prior.matrix.shape == (8, 8)
    assert not bool(prior.matrix[6:].any()) and not bool(prior.matrix[:3, 3:6].any())
    flat, bent = torch.tensor([1.0, 1, 1, 0, 0, 0, 0, 0]).double(), torch.tensor([1.0, -1, 1, 0, 0, 0, 0, 0]).double()
    assert float(flat @ prior.matrix @ flat) == pytest.approx(0.1 * 3)  # three samples, each for a length of 1
    assert float(bent @ prior.matrix @ bent) == pytest.approx(0.1 * 3 + 1e-2 * 16)


def test_curves_and_angles_are_recovered_from_pictures_of_the_model():
    # The values are those of sphere images with other curves and angles; smooth pictures, as a picture of a sphere is.
    problem = a_problem(size=16, count=1500)
    true = Shape(torch.deg2rad(torch.tensor((0.0, 64.0, 117.0), dtype=torch.float64)),
                 torch.tensor([[[0.9, 0.6, 0.8]]], dtype=torch.float64))
    narrow = random_pictures(a_problem(size=4)).unflatten(2, (3, 4))[0]
    wide = torch.nn.functional.interpolate(narrow, size=(16, 16), mode="bicubic")
    images = wide.clamp(min=0).reshape(1, 3, 48, 16)
    problem.value = problem.look(true).apply(images)
    start = Shape(torch.deg2rad(torch.tensor(ANGLES, dtype=torch.float64)), paper_turn(torch.float64))
    solver = GaussNewton(problem, start, True, True, math.radians(3))
    state = solver.begin(start, problem.black(3), 100)
    first = state.error
    for _ in range(12):
        found = solver.step(state)
        if found is None:
            break
        assert found.error < state.error
        state = found
    assert state.error < 0.02 * first
    assert_close(state.shape.angles, true.angles, 0.02)


@pytest.fixture(scope="module")
def fitted():
    return fit_sphere_images(GLOSSY, ANGLES, 48, samples=9, lights=9, steps=4)


def test_a_fit_is_better_at_unseen_lights_than_the_paper(fitted):
    lights = unseen_lights(ANGLES, 8)
    paper = SphereImages.from_brdf(GLOSSY, ANGLES, 48)
    before, after = (mean(sphere_errors(m, GLOSSY, lights, 4000)) for m in (paper, fitted.material))
    assert after < 0.3 * before
    assert fitted.history[-1][1] == pytest.approx(after, rel=0.5)


def test_curves_and_angles_gain_over_pictures_alone(fitted):
    pictures = fit_sphere_images(GLOSSY, ANGLES, 48, lights=9, curves="paper", place=False)
    assert pictures.material.options["angles_deg"] == list(ANGLES)
    assert torch.equal(pictures.material.maps["turn"], paper_turn(torch.float64))
    assert fitted.history[-1][1] < 0.9 * pictures.history[-1][1]


def test_what_a_fit_may_move_is_what_moves(fitted):
    assert fitted.material.maps["turn"].shape == (1, 4, 9)
    assert fitted.material.options["angles_deg"] != list(ANGLES)
    one = fit_sphere_images(GLOSSY, ANGLES, 16, samples=5, lights=5, steps=1, curves="one", place=False).material
    assert one.maps["turn"].shape == (1, 1, 5) and one.options["angles_deg"] == list(ANGLES)
    assert not torch.equal(one.maps["turn"], paper_turn(torch.float64))
    moved = fit_sphere_images(GLOSSY, ANGLES, 16, lights=5, steps=2, curves="paper").material
    assert torch.equal(moved.maps["turn"], paper_turn(torch.float64)) and moved.options["angles_deg"] != list(ANGLES)


def test_a_fit_is_repeatable_and_seeds_choose_the_points():
    options = {"size": 12, "samples": 3, "lights": 4, "steps": 1}
    first, again, other = (fit_sphere_images(GLOSSY, ANGLES, seed=seed, **options).material for seed in (0, 0, 1))
    assert all(torch.equal(value, again.maps[name]) for name, value in first.maps.items())
    assert not torch.equal(first.maps["images"], other.maps["images"])


def test_fewest_angles():
    found = fewest_angles(GLOSSY, 0.01, 16, lights=6, samples=3, steps=1)
    reached = found.figures["error_at_unseen_lights"]
    count = len(found.material.options["angles_deg"])
    assert list(reached) == list(range(2, count + 1)) and count > 2
    assert reached[count] <= 0.01 < reached[count - 1]
    with pytest.raises(FitError, match=r"at most 2 pictures; the least is .* of 2 pictures of 16 x 16"):
        fewest_angles(GLOSSY, 1e-6, 16, most=2, lights=5, samples=3, steps=1)


def test_points_stand_for_the_area_of_the_disc():
    points = sphere_points(MATTE, (0.0, 40.0), 3000)
    assert sum(points.counts) == points.value.shape[1]
    # Lambert lit along the view: the energy is 2 pi times the integral of r (1 - r^2), which is pi / 2.
    plain = sphere_points(GLOSSY, (0.0,), 3000)
    area = plain.weight * float((plain.value[0] * 0 + 1).sum()) / len(plain.weight)
    shares = area / area.sum()
    z_squared = plain.view[2, 0].square()
    assert float((shares * z_squared).sum()) == pytest.approx(0.5, abs=0.02)
    assert_close(points.per_picture(points.value), torch.ones(2, dtype=torch.float64))


def test_the_error_of_the_truth_is_zero_and_of_its_double_one():
    doubled = AnalyticBrdf("lambert", diffuse=(1.0, 0.8, 0.6), dtype=torch.float64)
    assert sphere_errors(MATTE, MATTE, (10.0, 100.0), 500) == [0.0, 0.0]
    assert sphere_errors(doubled, MATTE, (10.0, 100.0), 500) == pytest.approx([1.0, 1.0])


def test_a_sphere_lit_from_behind_counts_but_not_without_end():
    points = sphere_points(GLOSSY, (60.0, 180.0), 500)
    assert bool(torch.isfinite(points.weight).all())
    assert float(points.per_picture(points.value)[1]) == 0
    black = sphere_points(AnalyticBrdf("lambert", diffuse=0.0, dtype=torch.float64), (60.0,), 100)
    assert bool(torch.isfinite(black.weight).all())


def test_the_place_of_a_highlight():
    sharp = AnalyticBrdf("ggx", diffuse=0.1, specular=0.1, roughness=0.1, dtype=torch.float64)
    assert highlight_error(sharp, sharp, 40.0) == 0
    paper = SphereImages.from_brdf(sharp, size=192)
    # Texels are half a degree there; with k = 1 a quarter of 45 degrees lies between either half and the truth.
    assert highlight_error(paper, sharp, 67.5) < 0.5
    assert highlight_error(paper.with_maps(turn=constant_turn(1, torch.float64)), sharp, 67.5) > 5
    with pytest.raises(RangeError, match=r"light_deg must lie in \[0, 150\]"):
        highlight_error(sharp, sharp, 170)


def test_unseen_lights_are_not_the_pictures():
    assert unseen_lights((0, 13.5, 135), 5) == pytest.approx([40.5, 67.5, 94.5, 121.5])
    assert unseen_lights((0, 40), 2, 100) == pytest.approx([25, 75])


@pytest.mark.parametrize(("options", "name"), [
    ({"size": 0}, "size"), ({"samples": 2.5}, "samples"), ({"lights": True}, "lights"), ({"curves": "both"}, "curves"),
    ({"angles_deg": (0,)}, "angles_deg"), ({"angles_deg": (5, 50)}, "angles_deg"),
])
def test_bad_options_are_named(options, name):
    with pytest.raises(RangeError, match=f"{name} must"):
        fit_sphere_images(GLOSSY, **options)


def test_anisotropic_brdfs_are_refused():
    with pytest.raises(RangeError, match="fit_sphere_images: the BRDF must be isotropic"):
        fit_sphere_images(AnalyticBrdf("ward", roughness_along=0.1, roughness_across=0.4), size=8)


def test_a_tinted_btf_is_recovered():
    light, view = all_pairs(hemisphere(), hemisphere(((0, 1), (30, 5), (60, 5))))
    planes = [torch.from_numpy(rows)[:, :, None, None] for rows in (light, view)]
    tint = np.random.default_rng(0).uniform(0.2, 1.8, (3, 4, 5))
    tint /= tint.mean(axis=(1, 2), keepdims=True)
    images = GLOSSY.shade(*planes).numpy() * tint
    result = tm.fit(Btf.from_tensors(images.astype(np.float32), light, view), "sphere_images", storage="float")
    assert result.report["held_out"]["relative_error"] < 3e-3
    assert_close(result.material.maps["tint"], torch.from_numpy(tint).float(), 0.02)
    assert result.material.isotropic and result.report["figures"]["lobe"]["specular_r"] == pytest.approx(0.08, abs=0.02)


def test_the_correction_holds_what_the_lobe_does_not():
    light, view = all_pairs(hemisphere(), hemisphere(((0, 1), (30, 5), (60, 5))))
    half = light + view
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    # Two lobes and a sheen: no formula of the fit.
    value = 0.3 * light[:, 2] + 0.5 * half[:, 2] ** 200 + 0.2 * half[:, 2] ** 8 + 0.3 * (1 - view[:, 2]) ** 3
    images = np.broadcast_to(value[:, None, None, None], (len(light), 3, 2, 2)).astype(np.float32)
    btf = Btf.from_tensors(images, light, view)
    reports = [tm.fit(btf, "sphere_images", storage="float", smoothness=s).report for s in (0.3, 1e9)]
    with_it, without = (report["train"]["relative_error"] for report in reports)
    assert with_it < 0.2 * without


def test_a_measured_brdf_gains_as_much_as_the_formulas():
    brdf = load_brdf(shared_path("real/rgl/satin_rosaline_rgb.bsdf"))
    lights = unseen_lights((0, 45, 90, 135), 9)
    paper = SphereImages.from_brdf(brdf, size=96)
    found = fit_sphere_images(brdf, size=96, curves="paper", place=False, lights=14).material
    before, after = (mean(sphere_errors(m, brdf, lights, 4000)) for m in (paper, found))
    # Measured: 0.10 times.
    assert after < 0.3 * before


@pytest.mark.parametrize("angles", [(0, 2, 90), (0, 3, 90)])
def test_angles_that_stand_close_do_not_hold_the_fit_up(angles):
    fitted = fit_sphere_images(GLOSSY, angles, 16, samples=5, lights=5, steps=2)
    held = fit_sphere_images(GLOSSY, angles, 16, curves="paper", place=False, lights=5)
    assert len(fitted.history) > 2  # a step was taken, and made it better
    assert fitted.figures["error_at_fitted_lights"] < held.figures["error_at_fitted_lights"]
