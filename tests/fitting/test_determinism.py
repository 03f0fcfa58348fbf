"""One seed, one machine: the same bits, whatever the number of threads and in any process."""

from __future__ import annotations

import hashlib
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
import torch
from tests.support import all_pairs, hemisphere, plausible_images

import torchmat as tm
from torchmat import Btf

CASES = {
    "texture": ("texture", {}), "lambert": ("lambert", {}), "ptm": ("ptm", {}), "lptm": ("lptm", {}),
    "hsh4": ("hsh", {"terms": 4}), "hsh9": ("hsh", {"terms": 9}), "hsh16": ("hsh", {"terms": 16}),
    "distribution": ("distribution", {"geometry": "flat", "lobes": 2, "fresnel": True, "rotation": True, "specular_size": 12, "effort": 0.01}),
    "sphere_images": ("sphere_images", {}), "shading_map": ("shading_map", {}), "pca": ("pca", {}), "rbf": ("rbf", {}), "local_pca": ("local_pca", {"clusters": 4, "components": 4}),
    **{
        f"phong_srf_{residual}_{way}_{base}": ("phong_srf", {"residual": residual, "phong": way, "base": base})
        for residual, way, base in (
            ("half", "mean_brdf", "phong"), ("half_light", "per_light", "phong"), ("quadratic", "mean_brdf", "phong"),
            ("half", "per_light", "ashikhmin_shirley"),
        )
    },
    "neural": ("neural", {"geometry": "flat", "hidden": 12, "effort": 0.002}),
    "microfacet": ("microfacet", {
        "geometry": "flat", "effort": 0.01, "normal": True, "anisotropy": True, "rolloff": True,
        **dict.fromkeys(("coat", "sheen", "f90", "layered"), False),
    }),
    "phong_srf_no_ridge": ("phong_srf", {"residual": "half_light", "ridge": 0.0}),
}


def make(kind):
    """Return a Btf whose products are large enough for libraries to split them among threads."""
    light, view = all_pairs(hemisphere(), hemisphere(((0, 1), (30, 5), (60, 5))))
    images = plausible_images(light, view, 40, 37).astype(np.float32)
    weight = np.random.default_rng(0).random((len(light), 40, 37)) > 0.1 if kind == "masked" else None
    return Btf.from_tensors(images, light, view, weight)


def bits(btf, case):
    model, options = CASES[case]
    result = tm.fit(btf, model, seed=5, measure=False, **options)
    content = b"".join(value.detach().contiguous().numpy().tobytes() for value in result.material.maps.values())
    return hashlib.sha256(content).hexdigest()


@pytest.fixture(scope="module", params=["whole", "masked"])
def btf(request):
    return make(request.param)


@pytest.mark.parametrize("case", CASES)
def test_one_and_two_threads_give_the_same_bits(case, btf):
    before = torch.get_num_threads()
    found = set()
    try:
        for threads in (2, 1):  # what two threads give now so, now so, is not what one gives
            torch.set_num_threads(threads)
            found.add(bits(btf, case))
    finally:
        torch.set_num_threads(before)
    assert len(found) == 1


def test_the_number_of_threads_is_left_as_it_was(btf):
    before = torch.get_num_threads()
    bits(btf, "local_pca")
    assert torch.get_num_threads() == before


def test_a_fresh_process_gives_the_same_bits():
    cases = ["phong_srf_half_mean_brdf_phong", "hsh9", "pca", "local_pca"]
    btf = make("masked")
    expected = [bits(btf, case) for case in cases]
    code = (
        "import sys, importlib.util; sys.path.insert(0, sys.argv[1])\n"
        "spec = importlib.util.spec_from_file_location('determinism', sys.argv[2])\n"
        "module = importlib.util.module_from_spec(spec); spec.loader.exec_module(module)\n"
        "btf = module.make('masked')\n"
        "print(*[module.bits(btf, case) for case in sys.argv[3:]])\n"
    )
    here = Path(__file__).resolve()
    done = subprocess.run(
        [sys.executable, "-c", code, str(here.parents[2]), str(here), *cases], capture_output=True, text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == expected


def test_a_fit_gives_no_warnings(btf):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        bits(btf, "phong_srf_half_per_light_ashikhmin_shirley")
