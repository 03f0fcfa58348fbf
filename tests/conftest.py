"""Fixtures that all tests see."""

from __future__ import annotations

import dataclasses
import itertools
import os
from importlib import import_module

import pytest
import torch
from tests.support import all_pairs, hemisphere, plausible_images

from torchmat import Btf

# Stored bits are those of the plain road, which every machine has; `tests/fast` takes the other one.
os.environ["TORCHMAT_FAST"] = "0"

# For tests of other things: enough to tell a flat surface from a relief that is right.
_QUICK = {"distribution": 0.015, "microfacet": 0.015, "neural": 0.01}
# Files whose tests say which parts a fit chooses, or what its bits are: a trial of a part takes there what steps it takes for users.
_WHOLE_TRIALS = {"tests.fitting.test_distribution", "tests.fitting.test_microfacet", "tests.hard_cases.test_digests"}
_WHOLE_COMPARISONS = {"tests.fitting.test_geometry_asked"}


@pytest.fixture(scope="session")
def caches(tmp_path_factory):
    """Return one place after the other, none of which exists yet, for the caches of tests that write no files."""
    room = tmp_path_factory.mktemp("caches")
    return (room / str(number) for number in itertools.count())


@pytest.fixture(autouse=True)
def own_cache(request, caches, monkeypatch):
    """Keep decoded images away from the user's cache folder.

    Most tests never decode one: a folder is made for those alone that ask for one.
    """
    asked = "tmp_path" in request.fixturenames
    place = request.getfixturevalue("tmp_path") / "torchmat-cache" if asked else next(caches)
    monkeypatch.setenv("TORCHMAT_CACHE", str(place))


@pytest.fixture(autouse=True)
def seeded():
    """Start every test from the same random state, that of the processor: what there is for others would note the whole stack."""
    torch.default_generator.manual_seed(0)


@pytest.fixture(scope="session")
def hurried_recipes():
    """Return recipes whose comparison of flat with relief takes few steps, and so the network that a choice tries last."""
    from torchmat.fitting.recipe import RECIPES

    found = {name: dataclasses.replace(RECIPES[name], quick={**RECIPES[name].quick, "effort": effort}) for name, effort in _QUICK.items()}
    network = found["neural"]
    rungs = tuple(dataclasses.replace(rung, options={**rung.options, "effort": 0.004}) for rung in network.rungs)
    return found | {"neural": dataclasses.replace(network, rungs=rungs)}


@pytest.fixture(autouse=True)
def hurried(request, monkeypatch, hurried_recipes):
    """Let what ends a fit take a few steps, and so trials of a part, what tells flat from relief, and the network of a choice.

    Hardly a test is about them. The tests of the finish itself take all of its steps, those of what parts a fit chooses, and of
    stored bits, all of a trial's, and those of what a surface is taken for all of that comparison's.
    """
    from torchmat.fitting import finish
    from torchmat.fitting.models.distribution import choose
    from torchmat.fitting.models.microfacet import fit as microfacet
    from torchmat.fitting.recipe import RECIPES
    from torchmat.geometry import form_factors

    module = request.module.__name__
    monkeypatch.setattr(import_module("torchmat.fitting.evaluate"), "_SHADED", 2)  # the package has a function of that name
    if module not in _WHOLE_TRIALS:
        monkeypatch.setattr(choose, "_SHORTEST", 4)
        monkeypatch.setattr(microfacet, "_FEWEST", 4)
    if module.rpartition(".")[2] in ("test_finish", "test_form_factors", "test_indirect"):
        return
    monkeypatch.setattr(finish, "_STEPS", 10)
    monkeypatch.setattr(form_factors, "DIRECTIONS", 24)
    for name, recipe in hurried_recipes.items():
        if module not in _WHOLE_COMPARISONS or name == "neural":
            monkeypatch.setitem(RECIPES, name, recipe)


@pytest.fixture(params=[torch.float32, torch.float64], ids=["float32", "float64"])
def dtype(request):
    """Run a test in both precisions."""
    return request.param


@pytest.fixture
def small_btf() -> Btf:
    """A BTF of 22 lights x 22 views and 5 x 4 texels, made by NumPy."""
    light, view = all_pairs(hemisphere(), hemisphere())
    return Btf.from_tensors(plausible_images(light, view), light, view)


@pytest.fixture(scope="module")
def variant():
    """Mitsuba as tests use it, one ray at a time in plain RGB; what was chosen before comes back."""
    import mitsuba as mi

    before = mi.variant()
    mi.set_variant("scalar_rgb")
    yield
    if before is not None:
        mi.set_variant(before)
