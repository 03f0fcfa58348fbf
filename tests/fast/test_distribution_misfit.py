"""The misfit of the compiled part, value, display, loss and all gradients in one pass, against plain torch."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from tests.fast.conftest import on_both_roads, with_threads
from tests.fast.test_distribution import CASES, EVERY, agree, directions, maps_for

import torchmat as tm
from torchmat import fast
from torchmat.fast.distribution_misfit import Samples
from torchmat.fitting.models.distribution.fit import roughness_of
from torchmat.fitting.objective import DISPLAY_POWER, shown
from torchmat.models import Distribution

pytestmark = pytest.mark.usefixtures("compiled")
MEASURED, LIGHTS = 11, 4


def samples_for(rows, columns, count, dtype, power=DISPLAY_POWER, relief=True):
    """Return samples of a surface: black ones, bright ones, some of each flag, lights that do not come everywhere."""
    pixels = torch.rand(MEASURED, 3, rows, columns, dtype=dtype)
    pixels[0], pixels[1, :, 0], pixels[2] = 0, 1e4, pixels[2] * 1e-6
    flags = torch.randint(0, 3, (MEASURED, rows, columns)).to(torch.uint8)
    lit = torch.rand(LIGHTS, 1, rows, columns, dtype=dtype)
    lit[0], lit[1, :, 0] = 0, 1
    return Samples(
        pixels, flags, torch.randint(0, MEASURED, (count,)), torch.tensor([1.0, 0.3, 0.0], dtype=dtype), lit if relief else None,
        torch.randint(0, LIGHTS, (count,)) if relief else None, 0.1 * torch.rand(3, rows, columns, dtype=dtype) if relief else None,
        0.003, power,
    )


def plainly(material, light, view, samples):
    """Return what the misfit is by its definition."""
    found = material.value(light, view)
    if samples.lit is not None:
        found = found * samples.lit[samples.lit_rows] + samples.ambient
    target, weight = samples.pixels[samples.rows], samples.weights[samples.flags[samples.rows].long()][:, None]
    if samples.power:
        found, target = shown(found, samples.darkest), shown(target, samples.darkest)
    return (weight * (found - target).square()).sum()


def misfit_and_pulls(material, maps, light, view, samples, exponent):
    leaves = {name: value.clone().requires_grad_() for name, value in maps.items()}
    rise = None if exponent is None else torch.tensor([exponent], dtype=light.dtype, requires_grad=True)
    ambient = None if samples.ambient is None else samples.ambient.clone().requires_grad_()
    own = material.sharing(leaves)
    own, given = own if rise is None else own.with_rise(rise), replace(samples, ambient=ambient)
    found = own.misfit(light, view, given) if fast.library() is not None else plainly(own, light, view, given)
    (1.7 * found).backward()
    pulls = {name: leaf.grad for name, leaf in leaves.items()}
    return {"misfit": found.detach(), "exponent": None if rise is None else rise.grad, "ambient": None if ambient is None else ambient.grad, **pulls}


@pytest.mark.parametrize("relief, power", [(True, DISPLAY_POWER), (False, DISPLAY_POWER), (True, 0.0)])
@pytest.mark.parametrize("lobes, parts, channels, spacing, size", CASES)
def test_misfit_and_gradients_are_those_of_plain_torch(lobes, parts, channels, spacing, size, relief, power, dtype):
    maps = maps_for(lobes, parts, channels, size, dtype)
    material = Distribution(maps, lobes=lobes, parts=parts, mask_channels=channels, specular_spacing=spacing)
    light, view = directions(dtype)
    if dtype == torch.float32:  # where a half vector lies on a texel's very edge, rounding says on which side
        light, view = light[:6], view[:6]
    samples = samples_for(*material.size, len(light), dtype, power, relief)
    exponent = 4.2 if "fresnel" in parts else None
    plain, found = on_both_roads(lambda: misfit_and_pulls(material, maps, light, view, samples, exponent))
    agree(plain, found, 3e-5 if dtype == torch.float32 else 1e-12)


def test_powers_are_those_of_the_library(dtype):
    """What a display shows of values over all of a precision's range, read off the misfit of a black material."""
    size = 4000
    maps = {"diffuse": torch.zeros(3, 1, size, dtype=dtype), "specular": torch.zeros(3, 2, 2, dtype=dtype), "masking": torch.ones(2, dtype=dtype)}
    material = Distribution(maps, parts=("masking",))
    range_ = torch.logspace(-12, 15, size, dtype=torch.float64).to(dtype)
    up = torch.tensor([[0.0, 0.0, 1.0]], dtype=dtype)[:, :, None, None]
    samples = samples_for(1, size, 1, dtype, relief=False)
    darkest, flags = 1e-14, torch.full((1, 1, size), 2, dtype=torch.uint8)
    for at in range(0, size, 97):  # one texel counts at a time
        flags[0, 0, at] = 0
        pixels = range_[None, None, None].expand(1, 3, 1, size).contiguous()
        given = replace(samples, pixels=pixels, flags=flags, rows=torch.zeros(1, dtype=torch.long), darkest=darkest)
        found = float(material.misfit(up, up, given).detach())
        expected = 3 * (float(range_[at] + darkest) ** DISPLAY_POWER - darkest**DISPLAY_POWER) ** 2
        assert abs(found - expected) <= (1e-5 if dtype == torch.float32 else 2e-14) * expected
        flags[0, 0, at] = 2


def test_what_is_undefined_or_infinite_shows_in_the_misfit():
    for name in ("diffuse", "fresnel", "specular_mask", "specular", "masking", "normal"):
        for wrong in (torch.nan, torch.inf):
            maps = maps_for(1, EVERY, 1, 6, torch.float32, 3, 2)
            material, (light, view) = Distribution(maps, parts=EVERY), directions(torch.float32)
            samples = replace(samples_for(3, 2, 3, torch.float32), flags=torch.zeros(MEASURED, 3, 2, dtype=torch.uint8))
            spoilt = {**maps, name: torch.full_like(maps[name], wrong)}
            found = material.sharing(spoilt).misfit(light[:3], view[:3], samples).detach()
            # Infinite roughness hides a lobe, as in plain torch.
            assert not torch.isfinite(found) or (name, wrong) == ("masking", torch.inf), (name, wrong)


def test_bits_do_not_depend_on_threads():
    maps = maps_for(2, EVERY, 1, 8, torch.float32, 40, 50)
    material, (light, view) = Distribution(maps, lobes=2, parts=EVERY), directions(torch.float32)
    samples = samples_for(40, 50, len(light), torch.float32)
    found = [with_threads(count, lambda: misfit_and_pulls(material, maps, light, view, samples, 4.0)) for count in (1, 2, 4)]
    for one in found[1:]:
        assert all(torch.equal(one[name], found[0][name]) for name in one)


def test_without_gradients_and_with_them_it_is_the_same():
    maps = maps_for(1, EVERY, 1, 6, torch.float32)
    material, (light, view) = Distribution(maps, parts=EVERY), directions(torch.float32)
    samples = samples_for(*material.size, len(light), torch.float32)
    with torch.no_grad():
        alone = float(material.misfit(light, view, samples))
    assert alone == float(misfit_and_pulls(material, maps, light, view, samples, None)["misfit"])


def test_what_it_does_not_serve_is_for_plain_torch():
    maps = maps_for(1, EVERY, 1, 6, torch.float32)
    light, view = (one[:6] for one in directions(torch.float32))
    samples = samples_for(9, 15, 6, torch.float32)
    printed = Distribution({name: value for name, value in maps.items() if name != "masking"}, parts=EVERY[:-1])
    assert printed.misfit(light, view, samples) is None
    material = Distribution(maps, parts=EVERY)
    wide = light.expand(-1, -1, 9, 15), view.expand(-1, -1, 9, 15)
    assert material.misfit(*wide, samples) is None
    assert material.misfit(light.clone().requires_grad_(), view, samples) is None
    assert material.misfit(light.double(), view.double(), samples) is None
    fast.use(False)
    assert material.misfit(light, view, samples) is None


@pytest.mark.parametrize("shape", [(3, 8, 9), (6, 1, 5), (3, 4, 1), (3, 1, 1)])
def test_roughness_is_that_of_plain_torch(shape, dtype):
    planes = torch.randn(shape, dtype=dtype) * 5
    planes[:, 0] = planes[:, -1]

    def made():
        leaf = planes.clone().requires_grad_()
        found = roughness_of(leaf)
        (3 * found).backward()
        return torch.cat((found.detach()[None], leaf.grad.flatten()))

    plain, found = on_both_roads(made)
    assert float((plain - found).abs().max()) <= (1e-6 if dtype == torch.float32 else 1e-14) * float(plain.abs().max().clamp(min=1))


@pytest.mark.parametrize("geometry", ["flat", "given"])
@pytest.mark.parametrize("objective", ["display", "linear"])
def test_a_fit_takes_the_same_steps_by_either_road(geometry, objective):
    light, view = (one[:, :, 0, 0] for one in directions(torch.float64))
    above = (light[:, 2] > 0) & (view[:, 2] > 0)
    light, view = light[above][:40], view[above][:40]
    images = torch.rand(len(light), 3, 5, 7, dtype=torch.float64) * light[:, 2, None, None, None]
    btf = tm.Btf.from_tensors(images, light, view)
    height = torch.linspace(0, 0.05, 35, dtype=torch.float64).reshape(1, 5, 7)

    def fitted():
        shape = "flat" if geometry == "flat" else height
        options = {"geometry": shape, "objective": objective, "specular_size": 6, "lobes": 2, "rotation": True, "fresnel": True}
        return tm.fit(btf, "distribution", **options, effort=0.01, dtype=torch.float64, holdout=0.0, finish=False, measure="none", progress=False).material

    plain, found = on_both_roads(fitted)
    for name, expected in plain.maps.items():
        assert float((expected - found.maps[name]).detach().abs().max()) < 1e-9 * float(expected.detach().abs().max()), name
