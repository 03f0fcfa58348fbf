"""The form of messages, and the checks that raise them."""

from __future__ import annotations

import math

import pytest
import torch

from torchmat import errors


def test_message_has_one_form():
    assert errors.message("fit", "seed", "be whole", "it is 1.5") == "fit: seed must be whole; it is 1.5."
    assert errors.message("a", "b", "c", "d", "Do e.") == "a: b must c; d. Do e."


@pytest.mark.parametrize("kind, also", [
    (errors.ShapeError, ValueError), (errors.RangeError, ValueError), (errors.DataError, ValueError),
    (errors.FitError, RuntimeError),
])
def test_errors_can_be_caught_as_the_package_or_as_the_language(kind, also):
    assert issubclass(kind, errors.TorchmatError)
    assert issubclass(kind, also)


def test_check_option():
    errors.check_option("here", "mesh", "sphere", ("patch", "sphere"))
    with pytest.raises(errors.RangeError) as found:
        errors.check_option("here", "mesh", "spere", iter(("patch", "sphere")))
    assert str(found.value) == "here: mesh must be one of 'patch', 'sphere'; it is 'spere'. Did you mean 'sphere'?"
    with pytest.raises(errors.RangeError) as found:
        errors.check_option("here", "terms", 5, (4, 9, 16))
    assert str(found.value) == "here: terms must be one of 4, 9, 16; it is 5."
    with pytest.raises(errors.RangeError):
        errors.check_option("here", "terms", [4], (4, 9))


def test_check_known_keys():
    errors.check_known_keys("config", ["seed"], ["seed", "model"])
    with pytest.raises(errors.RangeError) as found:
        errors.check_known_keys("config", ["seed", "modle"], iter(["seed", "model"]))
    assert str(found.value) == "config: key 'modle' must be one of: seed, model; it is unknown. Did you mean 'model'?"
    with pytest.raises(errors.RangeError, match=r"must be one of: none; it is unknown\.$"):
        errors.check_known_keys("config", ["x"], [])


def test_check_finite_counts_and_names_the_first():
    errors.check_finite("here", "map", torch.zeros(2, 3))
    value = torch.zeros(2, 3)
    value[0, 2] = math.nan
    value[1, 1] = -math.inf
    with pytest.raises(errors.RangeError) as found:
        errors.check_finite("here", "map", value, "Mask them.")
    assert str(found.value) == "here: map must be finite; 2 of 6 values are NaN or Inf, first at index (0, 2). Mask them."


def test_check_unit():
    errors.check_unit("here", "light", torch.tensor([[0.6, 0, 0.8], [0, 0, 1.0005]]))
    with pytest.raises(errors.RangeError) as found:
        errors.check_unit("here", "light", torch.tensor([[0, 0, 1], [0, 0, 2.0], [0, 0, 0]]))
    assert str(found.value) == "here: light must be unit vectors; 2 of 3 are not, first at row 1 with length 2."
    with pytest.raises(errors.RangeError, match="light must be finite"):
        errors.check_unit("here", "light", torch.tensor([[0, 0, math.nan]]))
    errors.check_unit("here", "light", torch.empty(0, 3))
