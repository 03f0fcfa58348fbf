"""Compiled shading agrees with the plain one, flat and on a relief; without a compiler the material stays as it is."""

import pytest
import torch
from tests.models.examples import directions, make, per_image

from torchmat.models import can_compile, compilation, compiled

# torch's compiler warns of what torch does itself.
pytestmark = pytest.mark.filterwarnings("ignore")
HEIGHT, WIDTH = 8, 8
ROUNDING = 2e-6  # of the largest value, float32


@pytest.fixture
def compiler():
    if not can_compile():
        pytest.skip("no C++ compiler, or no Python headers")


def agree(actual: torch.Tensor, expected: torch.Tensor) -> None:
    assert actual.shape == expected.shape and actual.dtype == expected.dtype
    assert float((actual - expected).abs().max()) <= ROUNDING * float(expected.abs().max())


def test_values_agree_to_rounding_flat_and_on_a_relief(compiler):
    plain = make("lambert", {}, HEIGHT, WIDTH, torch.float32).on_relief(0.02 * torch.rand(1, HEIGHT, WIDTH))
    fast = compiled(plain)
    assert fast is not plain and fast._compiled is not None and fast.surface()._compiled is not None
    light, view = (per_image(directions(2, torch.float32, seed=seed)) for seed in (1, 2))
    with torch.no_grad():
        agree(fast.shade(light, view), plain.shade(light, view))
        agree(fast.surface().shade(light, view), plain.surface().shade(light, view))


def test_gradients_pass_and_what_is_made_of_a_compiled_material_shows_its_own_maps(compiler):
    plain = make("texture", {}, HEIGHT, WIDTH, torch.float32)
    fast = compiled(plain)
    light = per_image(directions(1, torch.float32))
    gradients = [torch.autograd.grad(one.shade(light, light).square().sum(), list(one.maps.values())) for one in (plain, fast)]
    for expected, actual in zip(*gradients, strict=True):
        agree(actual, expected)
    darker = fast.with_maps(**{name: value / 2 for name, value in fast.maps.items()})
    assert darker._compiled is None
    agree(2 * darker.shade(light, light).detach(), fast.shade(light, light).detach())


def test_without_a_compiler_the_material_itself_comes_back(monkeypatch):
    monkeypatch.setattr(compilation, "can_compile", lambda: False)
    plain = make("texture", {}, HEIGHT, WIDTH, torch.float32)
    assert compiled(plain) is plain
