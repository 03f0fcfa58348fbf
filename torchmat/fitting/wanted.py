"""What a fit is asked to reach, and what it may cost."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from torch import Tensor

from torchmat.errors import RangeError, check_known_keys, message

TARGET_KEYS = ("error", "psnr", "bytes", "seconds", "highlights")


@dataclass(frozen=True)
class Target:
    """The wanted error on samples never seen, and budgets; None is no wish.

    `error` is the relative error, `psnr` in dB, both after export; `bytes` a texel, shared tables included; `seconds` of
    fitting. `highlights` is the relative error on highlights that is kept besides (None: 0.1), unless `error` is wanted,
    which they dominate; from 1 on they are let go. Raises RangeError for numbers that cannot be, and when both `error` and `psnr` are given.
    """

    error: float | None = None
    psnr: float | None = None
    bytes: float | None = None
    seconds: float | None = None
    highlights: float | None = None

    def __post_init__(self) -> None:
        for name in TARGET_KEYS:
            value = getattr(self, name)
            if value is None:
                continue
            number = isinstance(value, int | float) and not isinstance(value, bool)
            if not number or not 0 < value < math.inf:
                raise RangeError(message("fit", name, "be a positive number", f"it is {value!r}"))
        if self.error is not None and self.psnr is not None:
            fact = f"they are {self.error} and {self.psnr}"
            step = "Give the one that matters; the report holds both."
            raise RangeError(message("fit", "error and psnr", "not be wanted together", fact, step))
        if self.error is not None and self.highlights is not None:
            fact, step = f"error is {self.error}", "Leave highlights out: the relative error is mostly theirs."
            raise RangeError(message("fit", "highlights", "be wanted beside psnr, bytes or seconds", fact, step))


def make_target(where: str, table: Mapping[str, Any]) -> Target:
    """Return the Target of a table; unknown keys are errors that suggest the nearest one."""
    check_known_keys(where, table, TARGET_KEYS)
    return Target(**table)


def beside_mask(target: Target, mask: Tensor | None) -> Target:
    """Return the target of the maps beside an object's `mask`, which takes a byte a texel of what is allowed."""
    if mask is None or target.bytes is None:
        return target
    if target.bytes <= 1:
        fact = f"it is {target.bytes:.3g} a texel, of which the mask takes 1"
        raise RangeError(message("fit auto", "bytes", "hold a material and its object mask", fact, "Give more, or mask=\"none\"."))
    return replace(target, bytes=target.bytes - 1)
