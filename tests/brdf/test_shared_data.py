"""The files of the RGL database as they are, where this machine has them."""

from __future__ import annotations

import math

import pytest
import torch
from tests.brdf.directions import planes, random_directions
from tests.support import shared_path

from torchmat import load_brdf
from torchmat.brdf import tabulate
from torchmat.brdf.albedo import directional_albedo

FILES = {
    "acrylic_felt_purple": "Purple acrylic felt (Edukit A4)",
    "cardboard": "Brown corrugated cardboard, smooth surface",
    "cc_iris_purple_gem": "TeckWrap vinyl wrapping film (Iris Purple Gem RD03)",
    "chm_mint": "TeckWrap vinyl wrapping film (Mint CHM16E)",
    "irid_flake_paint2": None,
    "leaf_maple": "Maple leaf sample (collected in Lausanne on June 1, 2018)",
    "satin_rosaline": None,
    "vch_golden_yellow": None,
}


@pytest.mark.parametrize("name", FILES)
def test_files_are_isotropic_and_reflect_less_than_they_receive(name):
    brdf = load_brdf(shared_path(f"real/rgl/{name}_rgb.bsdf"))
    assert brdf.isotropic and brdf.measured_as == "RGB"
    assert brdf.resolution == (1, 8, 3, 32, 32)
    assert FILES[name] in (None, brdf.description)
    for polar_deg in (0, 45, 75):
        albedo = directional_albedo(brdf, math.radians(polar_deg), steps=96)
        # A value that lacked pi or a cosine would leave this; the satin's largest at 75 degrees is 1.005 as measured.
        assert 0.1 < float(albedo.max()) < 1.02


def test_a_file_as_a_table_of_the_other_kind():
    felt = load_brdf(shared_path("real/rgl/acrylic_felt_purple_rgb.bsdf"))
    table = tabulate(felt, (30, 30, 30))
    light, view = (planes(random_directions(500, seed, 0.3), torch.float32) for seed in (1, 2))
    both = (felt.reflectance(light, view) + felt.reflectance(view, light)) / 2
    error = float((table.reflectance(light, view) - both).square().sum() / both.square().sum())
    assert error < 1e-3
