"""Photographs of a sphere: cropped, turned back to a light from the right, resampled; and what is refused."""

from __future__ import annotations

import math

import pytest
import torch
from tests.support import assert_close

from torchmat.brdf import AnalyticBrdf
from torchmat.create.from_sphere import sphere_images_from_photographs
from torchmat.errors import RangeError, ShapeError
from torchmat.models.sphere_geometry import directions_on, sphere_normals
from torchmat.models.sphere_images import render_spheres

BRDF = AnalyticBrdf("ggx", diffuse=(0.4, 0.2, 0.1), specular=0.05, roughness=0.4, dtype=torch.float64)
ANGLES = (0.0, 45.0, 90.0, 135.0)
CENTRE, RADIUS = (130.3, 95.7), 80.2


def photographs(azimuths, rows=200, columns=240, centre=CENTRE, radius=RADIUS, background=0.3):
    """Photograph the sphere, pixel by pixel centre, under lights from the given sides."""
    down, across = torch.arange(rows, dtype=torch.float64) + 0.5, torch.arange(columns, dtype=torch.float64) + 0.5
    up, right = torch.meshgrid(-(down - centre[1]) / radius, (across - centre[0]) / radius, indexing="ij")
    inside = right**2 + up**2 < 1
    pictures = []
    for angle, azimuth in zip(ANGLES, azimuths, strict=True):
        cosine, sine = math.cos(math.radians(azimuth)), math.sin(math.radians(azimuth))
        # Seen from the light's side: the normal as it stands to a light from the right.
        x, y = cosine * right + sine * up, cosine * up - sine * right
        normal = torch.stack((x, y, torch.sqrt((1 - x * x - y * y).clamp(min=1e-6))))
        shaded = BRDF.shade(*directions_on(normal, math.radians(angle)))
        pictures.append(torch.where(inside, shaded, torch.full_like(shaded, background)))
    return torch.stack(pictures).float()


@pytest.mark.parametrize("azimuths", [(0, 0, 0, 0), (0, 37, 200, -90)])
@pytest.mark.parametrize("size", [40, 128])
def test_photographs_become_the_pictures_that_rendering_gives(azimuths, size):
    options = {"azimuths_deg": azimuths, "size": size}
    made = sphere_images_from_photographs(photographs(azimuths), ANGLES, CENTRE, RADIUS, **options)
    expected = render_spheres(BRDF, ANGLES, size, samples=4 if size == 40 else 1).float()
    well_inside = sphere_normals(size)[:2].norm(dim=0) < 0.93
    # A photograph is sampled once more, and at 135 degrees the lit part is a crescent: 0.02 of the brightest there.
    assert_close(made.maps["images"][:, well_inside], expected[:, well_inside], 0.03)
    assert made.options["angles_deg"] == list(ANGLES)


def test_the_background_stays_out():
    dark, bright = (
        sphere_images_from_photographs(photographs((0,) * 4, background=b), ANGLES, CENTRE, RADIUS, size=64)
        for b in (0.0, 1e3)
    )
    assert_close(bright.maps["images"], dark.maps["images"])


def test_exposure_divides():
    plain = sphere_images_from_photographs(photographs((0,) * 4), ANGLES, CENTRE, RADIUS, size=32)
    halved = sphere_images_from_photographs(photographs((0,) * 4), ANGLES, CENTRE, RADIUS, size=32, exposure=2.0)
    assert_close(halved.maps["images"] * 2, plain.maps["images"])


def test_bad_input_is_named():
    pictures = photographs((0,) * 4)

    def make(given=pictures, angles=ANGLES, centre=CENTRE, radius=RADIUS, **options):
        return sphere_images_from_photographs(given, angles, centre, radius, **options)

    with pytest.raises(ShapeError, match=r"photographs must be \[n, 3, H, W\]; they are \(4, 1, 200, 240\)"):
        make(pictures[:, :1])
    broken = pictures.clone()
    broken[2, 1, 5, 6] = float("nan")
    with pytest.raises(RangeError, match=r"photographs must be finite; 1 of .* first at index \(2, 1, 5, 6\)"):
        make(broken)
    with pytest.raises(RangeError, match="linear light, 0 or more"):
        make(pictures - 1)
    with pytest.raises(RangeError, match="angles_deg must be 4 finite numbers"):
        make(angles=ANGLES[:3])
    with pytest.raises(RangeError, match="angles_deg must ascend from 0"):
        make(angles=(10, 20, 30, 40))
    with pytest.raises(RangeError, match="azimuths_deg must be 4 finite numbers"):
        make(azimuths_deg=(0, 1, 2, float("inf")))
    with pytest.raises(RangeError, match="sphere must lie inside the photographs; centre 130.3, 95.7 and radius 120"):
        make(radius=120)
    with pytest.raises(RangeError, match="exposure must be positive and finite; it is 0"):
        make(exposure=0)
