"""A height from many views and lights: against the relief that NumPy rendered, in scale and offset, and on flat surfaces."""

from __future__ import annotations

import functools
import hashlib
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from tests.fitting.reference_scene import Scene, glossy_scene, relief_scene
from tests.support import all_pairs, hemisphere

import torchmat as tm
from torchmat import Btf, FitError, RangeError
from torchmat.fitting import recover_geometry
from torchmat.fitting.relief.recover import recover_relief
from torchmat.fitting.training import make_training
from torchmat.solvers.clock import Watch
from torchmat.solvers.stop_reasons import BUDGET

# 28 samples of 24 x 100 texels: longer than the 96 that views are compared at.
LONG = {
    "rows": 24, "columns": 100, "depth": 0.03, "views": ((0, 1), (35, 3), (60, 3)), "lights": ((15, 1), (45, 3)),
}
# What is rendered, and the measured correlation, slope of the regression on the truth, offset and worst texel (the last
# two in shares of the relief's range). The loss of 3 to 5 % of scale is that of bilinear pictures of 24 texels; at 100
# texels there are 28 samples only.
CASES = {
    "square": ({}, (0.99977, 0.967, 0.0005, 0.021)),
    "wide": ({"rows": 20, "columns": 28}, (0.99970, 0.964, 0.0007, 0.024)),
    "tall": ({"rows": 28, "columns": 20}, (0.99979, 0.967, 0.0011, 0.022)),
    "below the plane": ({"offset": -0.2}, (0.99985, 0.964, 0.0027, 0.026)),
    "open border": ({"tiles": False}, (0.99858, 0.960, 0.0046, 0.038)),
    "open border, wide": ({"rows": 20, "columns": 28, "tiles": False}, (0.99950, 0.955, 0.0085, 0.038)),
    "fine to coarse": (LONG, (0.99358, 0.913, 0.0175, 0.111)),
}


@functools.lru_cache(maxsize=None)
def of_case(name: str):
    """Return a case's scene and what is recovered from it."""
    scene = relief_scene(**CASES[name][0])
    return scene, recover_geometry(scene.btf(), tiles=scene.tiles)


def compared(scene: Scene, height: torch.Tensor) -> tuple[float, float, float, float]:
    """Return correlation with the truth, slope of the regression on it, |mean| and worst difference over its range."""
    found, truth = height[0].double().numpy(), scene.height
    correlation = float(np.corrcoef(found.ravel(), truth.ravel())[0, 1])
    slope = float(np.polyfit(truth.ravel(), found.ravel(), 1)[0])
    return correlation, slope, float(abs(found.mean() - truth.mean()) / np.ptp(truth)), float(np.abs(found - truth).max() / np.ptp(truth))


@pytest.mark.parametrize("name", CASES)
def test_the_height_is_recovered_with_its_scale_and_offset(name):
    correlation, slope, offset, worst = CASES[name][1]
    scene, recovered = of_case(name)
    found = compared(scene, recovered.relief.height)
    assert recovered.relief.height.shape == (1, *scene.height.shape)
    assert 1 - found[0] < 1.3 * (1 - correlation)
    assert abs(found[1] - 1) < 1.3 * abs(1 - slope)
    assert found[2] < offset + 0.003
    assert found[3] < 1.3 * worst
    figures = recovered.figures()
    assert figures["disagreement"] < 0.5 * figures["disagreement_flat"]


def test_comparing_can_fail():
    scene = relief_scene()
    right = compared(scene, scene.true_height)
    assert right[0] > 1 - 1e-9 and abs(right[1] - 1) < 1e-9 and max(right[2:]) < 1e-9
    lower = compared(scene, 0.5 * scene.true_height)
    assert abs(lower[1] - 0.5) < 1e-9 and lower[2] > 0.1 and lower[3] > 0.3


def test_normals_are_those_of_the_surface():
    scene = relief_scene(depth=0.07)
    normal = recover_geometry(scene.btf()).relief.normal.double()
    assert float((normal.norm(dim=0) - 1).abs().max()) < 1e-5
    rise = (np.roll(scene.height, -1, 1) - np.roll(scene.height, 1, 1)) * scene.height.shape[1] / 2
    # Central differences of 24 texels against the slopes of photometric stereo: measured 0.021 of 0.37.
    assert float((-normal[0] / normal[2] - torch.from_numpy(rise)).abs().max()) < 0.03


def test_a_flat_glossy_surface_comes_out_exactly_flat():
    found = recover_geometry(glossy_scene().btf())
    relief, figures = found.relief, found.figures()
    assert torch.equal(relief.height, torch.zeros(1, 24, 24))
    assert torch.equal(relief.normal, torch.tensor([0.0, 0.0, 1.0])[:, None, None].expand(3, 24, 24))
    assert figures["scale"] == 0.0 and figures["offset"] == 0.0
    assert figures["disagreement"] == figures["disagreement_flat"]


def noisy_gloss(seed: int) -> Btf:
    scene = glossy_scene()
    noise = np.random.default_rng(seed).normal(0, 0.02, scene.images.shape)
    return Btf.from_tensors((scene.images + noise).clip(0).astype(np.float32), scene.light, scene.view)


@pytest.mark.parametrize("seed", [0, 1])
def test_noise_does_not_raise_a_flat_glossy_surface(seed):
    assert torch.equal(recover_geometry(noisy_gloss(seed)).relief.height, torch.zeros(1, 24, 24))


@pytest.mark.parametrize(
    "views", [((0, 1), (35, 4)), ((0, 1), (8, 6))], ids=["five views", "seven views near the normal"]
)
def test_without_parallax_it_is_photometric_stereo_of_mean_zero(views):
    scene = relief_scene(depth=0.1, views=views)
    found = recover_geometry(scene.btf())
    relief, figures = found.relief, found.figures()
    assert abs(float(relief.height.mean())) < 1e-7
    assert figures["method"] == "photometric stereo" and "too few views" in figures["scale_from"]
    assert figures["offset"] == 0.0 and figures["scale"] == 1.0
    assert compared(scene, relief.height)[0] > 0.9998  # measured 0.99993


def test_few_samples_are_photometric_stereo_too():
    scene = relief_scene()
    rows = np.flatnonzero(np.arange(len(scene.light)) < 10)  # all lights under the first view
    rows = np.concatenate((rows, np.arange(10, len(scene.light), 8)))[:23]
    assert len({tuple(row) for row in scene.view[rows].round(6)}) >= 6
    figures = recover_geometry(Btf.from_tensors(scene.images[rows].astype(np.float32), scene.light[rows], scene.view[rows])).figures()
    assert "too few views" in figures["scale_from"]


def test_views_that_are_all_oblique_are_refused_with_the_angle():
    scene = relief_scene(views=((60, 6),))
    with pytest.raises(FitError, match=r"view within 45 degrees.*at 60 degrees"):
        recover_geometry(scene.btf())
    with pytest.raises(FitError, match="60 degrees"):
        tm.fit(scene.btf(), "texture", geometry="recover")


def test_coplanar_lights_are_refused_with_what_stays_open():
    line = np.stack((np.sin(np.linspace(-1, 1, 9)), np.zeros(9), np.cos(np.linspace(-1, 1, 9))), axis=1)
    light, view = all_pairs(line, hemisphere(((0, 1), (35, 4), (60, 4))))
    images = np.random.default_rng(0).uniform(0.1, 1, (81, 3, 6, 6)).astype(np.float32)
    with pytest.raises(RangeError, match=r"span 2 of 3.*\(0\.00, 1\.00, 0\.00\) stays undetermined"):
        recover_geometry(Btf.from_tensors(images, light, view))


def same_bits(first, second) -> bool:
    return torch.equal(first.relief.height, second.relief.height) and torch.equal(first.relief.normal, second.relief.normal)


SMALL = {**LONG, "rows": 24, "columns": 24}


def bits(options: dict) -> str:
    """Return a digest of what is recovered from a scene."""
    recovered = recover_geometry(relief_scene(**options).btf())
    content = b"".join(value.numpy().tobytes() for value in recovered.relief)
    return hashlib.sha256(content + repr(recovered.figures).encode()).hexdigest()


def test_one_and_two_threads_give_the_same_bits_in_any_process():
    here = Path(__file__).resolve()
    code = (
        "import sys, importlib.util, torch; sys.path.insert(0, sys.argv[1])\n"
        "spec = importlib.util.spec_from_file_location('recover', sys.argv[2])\n"
        "module = importlib.util.module_from_spec(spec); spec.loader.exec_module(module)\n"
        "torch.set_num_threads(2)\n"
        "print(module.bits(module.SMALL), module.bits(module.LONG))\n"
    )
    # Threads that wait sleep: where another program uses the second core they would spin for seconds.
    environment = {**os.environ, "OMP_WAIT_POLICY": "passive"}
    done = subprocess.run(
        [sys.executable, "-c", code, str(here.parents[2]), str(here)], capture_output=True, text=True, timeout=120,
        env=environment,
    )
    assert done.returncode == 0, done.stderr
    before = torch.get_num_threads()
    try:
        torch.set_num_threads(1)
        found = [bits(SMALL), bits(LONG)]
        assert done.stdout.split() == found
        assert bits(SMALL) == found[0]
    finally:
        torch.set_num_threads(before)


def test_held_out_samples_are_never_looked_at():
    scene = relief_scene()
    held_out = torch.arange(3, len(scene.light), 5)
    kept = torch.ones(len(scene.light), dtype=torch.bool)
    kept[held_out] = False
    poisoned = scene.images.astype(np.float32)
    poisoned[held_out.numpy()] = 1e6
    found = []
    for images in (scene.images.astype(np.float32), poisoned):
        btf = Btf.from_tensors(images, scene.light, scene.view)
        training = make_training(btf, kept.nonzero()[:, 0], 0, True, torch.float32, False)
        found.append(recover_relief(training))
    assert same_bits(*found)
    assert found[0].figures() == found[1].figures()
    seen = recover_geometry(Btf.from_tensors(poisoned, scene.light, scene.view))
    assert not same_bits(found[0], seen)  # the poison does show where it is looked at


def test_a_fit_with_recovery_never_looks_at_held_out_samples():
    scene = relief_scene(rows=12, columns=12)
    split = tm.split_samples(scene.btf(), 0.2, "pair", 4)
    poisoned = scene.images.astype(np.float32)
    poisoned[split.held_out.numpy()] = 1e6
    results = [
        tm.fit(Btf.from_tensors(images, scene.light, scene.view), "lambert", seed=4, geometry="recover", measure=False)
        for images in (scene.images.astype(np.float32), poisoned)
    ]
    assert torch.equal(results[0].split.held_out, split.held_out)
    assert set(results[0].material.maps) == {"albedo", "height", "ambient"}
    for name, value in results[0].material.maps.items():
        assert torch.equal(value, results[1].material.maps[name])


def test_samples_without_weight_may_hold_anything():
    scene = relief_scene()
    weight = np.random.default_rng(0).random((len(scene.light), 24, 24)) > 0.05
    images = np.where(weight[:, None], scene.images, np.nan).astype(np.float32)
    relief = recover_geometry(Btf.from_tensors(images, scene.light, scene.view, weight)).relief
    correlation, slope, offset, worst = compared(scene, relief.height)
    # Measured 0.9998, 0.969, 0.002, 0.021.
    assert correlation > 0.9996 and 0.95 < slope < 1.03 and offset < 0.005 and worst < 0.03


def test_double_precision_finds_the_same():
    scene, single = of_case("square")
    double = recover_geometry(scene.btf(np.float64), dtype=torch.float64)
    assert double.relief.height.dtype == double.relief.normal.dtype == torch.float64
    # Views are compared in float32 either way; slopes differ by rounding: measured 1.4e-6 of the range.
    assert float((double.relief.height - single.relief.height).abs().max()) < 1e-5 * np.ptp(scene.height)
    long = relief_scene(**LONG)
    assert recover_geometry(long.btf(np.float64), dtype=torch.float64).relief.height.dtype == torch.float64


def test_the_brightness_of_the_images_does_not_matter():
    scene, bright = of_case("square")
    dim = Btf.from_tensors((scene.images * 1e-3).astype(np.float32), scene.light, scene.view)
    dark = recover_geometry(dim)
    # Rounding alone differs: measured 1e-6 of the range.
    assert float((bright.relief.height - dark.relief.height).abs().max()) < 1e-5 * np.ptp(scene.height)


class Ticking(Watch):
    """A watch that is a second later whenever one looks."""

    def __init__(self, limit: float) -> None:
        super().__init__(limit)
        self.looks = 0

    @property
    def seconds(self) -> float:
        self.looks += 1
        return float(self.looks)


def recovered_within(scene: Scene, limit: float):
    watch = Ticking(limit)
    training = make_training(scene.btf(), torch.arange(len(scene.light)), 0, True, torch.float32, False, watch)
    return recover_relief(training), watch


def test_seconds_that_end_before_an_offset_is_found_leave_a_flat_surface():
    scene = relief_scene()
    found, watch = recovered_within(scene, 20)  # of which half, and there are 13 offsets to try
    assert found.stop_reason == BUDGET and found.scale == 0
    assert torch.equal(found.relief.height, torch.zeros(1, 24, 24)) and watch.looks < 15


def test_seconds_that_end_later_leave_the_coarse_height():
    scene, whole = of_case("square")
    assert whole.stop_reason == "converged"
    found, watch = recovered_within(scene, 60)
    assert found.stop_reason == BUDGET and watch.looks < 40
    correlation, slope, offset, worst = compared(scene, found.relief.height)
    # Measured 0.99992, 0.947, 0.007, 0.040: the shape of photometric stereo with the scale and offset found, not refined.
    assert correlation > 0.9998 and abs(slope - 1) < 0.07 and offset < 0.01 and worst < 0.05
    assert not same_bits(found, whole)


def test_a_fit_counts_the_recovery_as_its_time():
    scene = relief_scene()
    result = tm.fit(scene.btf(), "lambert", geometry="recover", seconds=0.01, measure=False)
    assert result.stop_reason == BUDGET and result.report["stop_reason"] == BUDGET
    assert result.report["figures"]["geometry"]["stop_reason"] == BUDGET
    assert result.report["figures"]["geometry"]["chosen"] == "flat" and "height" not in result.material.maps
    ample = tm.fit(scene.btf(), "lambert", geometry="recover", seconds=600.0, measure=False)
    assert ample.stop_reason == "converged" and ample.report["figures"]["geometry"]["chosen"] == "recover"
