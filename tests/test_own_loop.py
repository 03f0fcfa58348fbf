"""A loop of one's own over a material's parameters: gradients through `shade` and `tm.render`, and the script that shows it."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest
import torch
from tests.models.distributions import ALL_PARTS, distribution
from tests.models.examples import make

import torchmat as tm

SCRIPT = Path(__file__).parents[1] / "scripts" / "own_loop.py"


@pytest.fixture(scope="module")
def script():
    spec = importlib.util.spec_from_file_location("own_loop", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_maps_are_parameters_that_an_optimiser_finds():
    material = distribution(4, 5, 2, ALL_PARTS)
    assert {id(value) for value in material.parameters()} == {id(value) for value in material.maps.values()}
    assert all(value.requires_grad and value.is_leaf for value in material.parameters())


MATERIALS = {
    "ptm": lambda: make("ptm", {}, 6, 6, dtype=torch.float64),
    "distribution on a relief": lambda: distribution(6, 6, 2, ALL_PARTS, relief=True, dtype=torch.float64),
}


@pytest.mark.parametrize("mesh", ["sphere", "patch"])
@pytest.mark.parametrize("kind", list(MATERIALS))
def test_the_gradient_of_a_picture_is_that_of_differences(kind, mesh):
    material = MATERIALS[kind]()
    # 5 pixels for 6 texels: smaller copies of the maps are seen too.
    asked = {"mesh": mesh, "lights": [(0.3, 0.2, 0.9), (-0.5, 0.1, 0.7)], "size": 5, "gradient": True}
    weight = torch.linspace(0.5, 1.5, 75, dtype=torch.float64)

    def loss(one):
        return (tm.render(one, **asked).flatten() * weight).sum()

    loss(material).backward()
    names = ["polynomial"] if kind == "ptm" else ["diffuse", "specular_mask", "specular", "ambient"]
    for name in names:
        value, generator = material.maps[name].detach(), torch.Generator().manual_seed(1)
        way = torch.randn(value.shape, generator=generator, dtype=torch.float64) * value.abs().clamp(max=1)
        ahead, behind = (loss(material.with_maps(**{name: value + step * way})) for step in (1e-6, -1e-6))
        along = float((material.maps[name].grad * way).sum())
        assert along == pytest.approx(float((ahead - behind).detach()) / 2e-6, rel=1e-5, abs=1e-8), name
        assert abs(along) > 1e-4


def test_a_picture_has_no_gradient_unless_it_is_asked_for_and_the_same_bits_either_way():
    material = make("ptm", {}, 6, 6)
    for mesh in ("sphere", "patch"):
        plain, traced = tm.render(material, mesh, size=7), tm.render(material, mesh, size=7, gradient=True)
        assert not plain.requires_grad and traced.requires_grad and torch.equal(plain, traced.detach())


def test_the_script_trains_and_saves(script, tmp_path, capsys):
    script.main(["--steps", "9", "--size", "24", "--out", str(tmp_path / "own")])
    said = capsys.readouterr().out.splitlines()
    assert said[0].startswith("shade ") and "9 steps" in said[0] and said[1].startswith("shade and render") and "3 steps" in said[1]
    assert tm.load_material(tmp_path / "own").name == "lambert"


def test_its_losses_fall_below_those_of_the_grey_start(script):
    btf = tm.load_btf(tm.sample_path(), cache=False, crop=(0, 0, 12, 12), progress=False)
    split = tm.split_samples(btf)
    material = script.grey(btf)
    rows = split.held_out[:200]
    with torch.no_grad():
        start = float(script.loss_of_images(material, btf, rows))
    losses = script.train(material, btf, split.train, 60, 0.02)
    with torch.no_grad():
        found = float(script.loss_of_images(material, btf, rows))
    assert len(losses) == 60 and found < 0.8 * start
    pictures = script.pictures_of(btf, 20)
    with torch.no_grad():
        before = sum(float(script.loss_of_picture(material, *one)) for one in pictures)
    script.train(material, btf, split.train, 20, 0.005, pictures)
    with torch.no_grad():
        assert sum(float(script.loss_of_picture(material, *one)) for one in pictures) < before
    for spec in material.specs():
        assert spec.low is None or float(material.maps[spec.name].detach().min()) >= spec.low
