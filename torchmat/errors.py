"""The package's errors, and the checks that raise them.

Every message reads ``{where}: {name} must {requirement}; {measured fact}. {next step}``, so that whoever
meets one knows which file or argument is meant and what to do about it.
"""

from __future__ import annotations

import difflib
import math
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import torch

_LONGEST = 600  # letters of a fact; more is the content of a damaged file


class TorchmatError(Exception):
    """Base of all errors that the package raises on purpose; `map` names the map of a material that is at fault."""

    def __init__(self, *arguments: object, map: str | None = None) -> None:
        super().__init__(*arguments)
        self.map = map


@contextmanager
def about_map(name: str) -> Iterator[None]:
    """Let errors that are raised in the block say that they are about the map `name`."""
    try:
        yield
    except TorchmatError as error:
        error.map = error.map or name
        raise


class ShapeError(TorchmatError, ValueError):
    """A tensor or image has the wrong shape."""


class RangeError(TorchmatError, ValueError):
    """A value, an option or a direction lies outside what is allowed."""


class DataError(TorchmatError, ValueError):
    """A file or folder cannot be used as it is."""


class NotMeasuredError(TorchmatError, KeyError):
    """A figure is asked for that was not measured."""

    __str__ = Exception.__str__  # a KeyError would put it in quotation marks


class FitError(TorchmatError, RuntimeError):
    """A fit cannot be carried out on the given data."""


class Notice(UserWarning):
    """Something was taken otherwise than it stood there, or done without: the result holds, and this says how."""


def notice(where: str, fact: str) -> None:
    """Warn that something about the file or argument `where` was taken otherwise than it stood there."""
    warnings.warn(f"{where}: {fact}", Notice, stacklevel=3)


def _short(text: str) -> str:
    """Leave out the middle of what a file says at great length."""
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST // 2]} ... {text[-_LONGEST // 4 :]}"


def message(where: str, name: str, requirement: str, fact: str, next_step: str = "") -> str:
    """Return an error text in the package's one form."""
    text = f"{where}: {_short(name)} must {requirement}; {_short(fact)}."
    return f"{text} {next_step}" if next_step else text


def check_option(where: str, name: str, value: object, choices: Iterable[object]) -> None:
    """Raise RangeError unless `value` is one of `choices`; suggest the nearest one."""
    choices = list(choices)
    if value in choices:
        return
    near = difflib.get_close_matches(str(value), [str(c) for c in choices], n=1, cutoff=0.5)
    hint = f"Did you mean {near[0]!r}?" if near else ""
    listed = ", ".join(repr(c) for c in choices)
    raise RangeError(message(where, name, f"be one of {listed}", f"it is {value!r}", hint))


def check_positive(where: str, name: str, value: float, next_step: str = "") -> None:
    """Raise RangeError unless `value` is above 0 and finite."""
    if not 0 < value < math.inf:
        raise RangeError(message(where, name, "be positive and finite", f"it is {value}", next_step))


def check_known_keys(
    where: str, given: Iterable[str], known: Iterable[str], place: Callable[[str], str] | None = None
) -> None:
    """Raise RangeError for the first key that is not known; say its right `place` where that says one, else the nearest."""
    known = list(known)
    for key in given:
        if key in known:
            continue
        near = difflib.get_close_matches(key, known, n=1, cutoff=0.4)
        hint = (place(key) if place else "") or (f"Did you mean {near[0]!r}?" if near else "")
        listed = ", ".join(known) if known else "none"
        raise RangeError(message(where, f"key {key!r}", f"be one of: {listed}", "it is unknown", hint))


def check_finite(where: str, name: str, value: torch.Tensor, next_step: str = "") -> None:
    """Raise RangeError when `value` holds NaN or Inf; name how many and the first index."""
    # The two ends show NaN and Inf, in a fraction of the time and without a tensor beside this one.
    if value.is_floating_point() and value.numel() and all(end.isfinite() for end in value.aminmax()):
        return
    bad = ~value.isfinite()
    count = int(bad.sum())
    if count:
        first = tuple(bad.nonzero()[0].tolist())
        fact = f"{count} of {value.numel()} values are NaN or Inf, first at index {first}"
        raise RangeError(message(where, name, "be finite", fact, next_step))


def check_unit(where: str, name: str, value: torch.Tensor, next_step: str = "", tolerance: float = 1e-3) -> None:
    """Raise RangeError unless every row of `value` [n, 3] is finite and has length 1 within `tolerance`."""
    check_finite(where, name, value, next_step)
    length = value.double().norm(dim=-1)
    bad = (length - 1).abs() > tolerance
    if bool(bad.any()):
        first = int(bad.nonzero()[0, 0])
        fact = f"{int(bad.sum())} of {len(value)} are not, first at row {first} with length {float(length[first]):.6g}"
        raise RangeError(message(where, name, "be unit vectors", fact, next_step))
