"""Fits of the distribution material by Smith's denominator, and by the ones that the thesis has."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tests.fitting.test_add_a_model import ggx_value
from tests.support import all_pairs, hemisphere

import torchmat as tm
from torchmat import RangeError
from torchmat.fitting.models.distribution.parameters import DistributionShared

LIGHT, VIEW = all_pairs(hemisphere(((10, 4), (30, 6), (55, 8), (74, 8))), hemisphere(((0, 1), (25, 4), (55, 6), (74, 6))))
ALPHA, QUICK = 0.5, {"geometry": "flat", "lobes": 1, "fresnel": False, "rotation": False, "normal": False, "specular_size": 24}


@pytest.fixture(scope="module")
def metal():
    """Rough metal by an oracle of its own: 2 x 2 texels of one GGX lobe."""
    rows = zip(LIGHT.astype(float), VIEW.astype(float), strict=True)
    value = np.array([[ggx_value(0.02, f0, ALPHA, light, view) for f0 in (0.9, 0.7, 0.4)] for light, view in rows])
    return tm.Btf.from_tensors(np.broadcast_to(value[:, :, None, None], (len(value), 3, 2, 2)).astype(np.float32).copy(), LIGHT, VIEW)


def fitted(btf, **options):
    return tm.fit(btf, "distribution", progress=False, **{**QUICK, "effort": 0.1, **options})


def test_masking_is_what_makes_rough_metal_true_at_grazing_angles(metal):
    smith, printed = (fitted(metal, denominator=one) for one in ("smith", "ashikhmin"))
    assert smith.material.options["parts"] == ["specular_mask", "masking"] and printed.material.options["parts"] == ["specular_mask"]
    errors = [one.report["held_out"]["relative_error"] for one in (smith, printed)]
    assert errors[0] < 0.15 * errors[1]  # measured 0.012 of 0.144; 0.0105 of 0.148 after four times the steps


@pytest.mark.parametrize(("options", "part"), [
    ({}, "masking"), ({"denominator": "smith"}, "masking"), ({"denominator": "ashikhmin"}, None), ({"denominator": "tilt"}, "tilt"),
    ({"tilt": True}, "tilt"), ({"denominator": "ashikhmin", "tilt": True}, "tilt"),
])
def test_each_denominator_is_asked_for_by_its_name(metal, options, part):
    result = fitted(metal, effort=0.005, measure=False, **options)
    assert [one for one in result.material.options["parts"] if one in ("tilt", "masking")] == ([] if part is None else [part])
    again = tm.fit(metal, "distribution", progress=False, measure=False, **{**QUICK, "effort": 0.005, **options})
    assert all(torch.equal(again.material.maps[name], value) for name, value in result.material.maps.items())


def test_what_has_no_lobes_has_no_denominator(metal):
    assert fitted(metal, lobes=0, effort=0.005, measure=False).material.options["parts"] == []
    with pytest.raises(RangeError, match="denominator must be left out without lobes"):
        fitted(metal, lobes=0, denominator="tilt")
    with pytest.raises(RangeError, match="it is 'smit'"):
        fitted(metal, denominator="smit")


def test_tiles_share_the_two_numbers(metal):
    whole = DistributionShared(log_masking=torch.zeros(2))
    assert set(whole.parameters) == {"masking"}
    tensors, numbers = whole.pieces()
    assert torch.equal(DistributionShared.from_pieces(tensors, numbers).log_masking, torch.zeros(2))
    tiled = fitted(metal, tile_size=1, effort=0.01, measure=False, specular_mask=False)
    assert tiled.report["figures"]["tiles"]["count"] == 4 and "masking" in tiled.material.maps
