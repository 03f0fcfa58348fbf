"""`help` answers: every public function and class lists each of its arguments."""

from __future__ import annotations

import inspect

import pytest

import torchmat as tm
from torchmat.docstrings import documented_arguments

ERRORS = {name for name in tm.__all__ if isinstance(getattr(tm, name), type) and issubclass(getattr(tm, name), Exception)}


def undocumented(public) -> set[str]:
    """Return the arguments that a function or class takes and does not explain, or explains and does not take."""
    taken = {name for name in inspect.signature(public).parameters if not name.startswith("_")}
    return taken ^ {name for name, meaning in documented_arguments(public).items() if len(meaning.split()) > 1}


@pytest.mark.parametrize("name", sorted(set(tm.__all__) - ERRORS))
def test_every_public_name_explains_each_of_its_arguments(name):
    public = getattr(tm, name)
    assert undocumented(public) == set()
    first = inspect.getdoc(public).splitlines()[0]
    assert first.endswith((".", ":")) and len(first) < 125


def test_what_is_missing_or_too_much_is_found():
    def function(a, b=1):
        """Do it.

        Args:
            a: what is done
            c: what nobody asks for
        """

    assert undocumented(function) == {"b", "c"}
