"""Cutout: the part of a larger texture that a material's maps cover."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import torch
from torch import Tensor

from torchmat.errors import RangeError, message


@dataclass(frozen=True)
class Cutout:
    """Rows from `top` and columns from `left` of a texture of `whole_height` x `whole_width` texels, `repeats` or not.

    The numbers only say where the part lies: the maps themselves may be of any resolution. Texture coordinates stay
    those of the whole; outside of the part its border goes on. Raises RangeError for a part not within the whole.
    """

    top: int
    left: int
    height: int
    width: int
    whole_height: int
    whole_width: int
    repeats: bool = True

    def __post_init__(self) -> None:
        rows, columns = (self.top, self.height, self.whole_height), (self.left, self.width, self.whole_width)
        sides = {"rows": rows, "columns": columns}
        for name, (first, length, whole) in sides.items():
            numbers = all(isinstance(n, int) and not isinstance(n, bool) for n in (first, length, whole))
            if not numbers or not (0 <= first and 0 < length and first + length <= whole):
                fact = f"they are {first!r} to {first!r} + {length!r} of {whole!r}"
                raise RangeError(message("Cutout", name, "be whole numbers within the texture", fact))

    @property
    def is_whole(self) -> bool:
        """Whether it covers all of the texture."""
        return (self.height, self.width) == (self.whole_height, self.whole_width)

    def place(self, uv: Tensor) -> Tensor:
        """Return coordinates [2, h, w] of the whole texture as coordinates of the part."""
        if self.is_whole:
            return uv
        u, v = uv % 1 if self.repeats else uv
        u = (u * self.whole_width - self.left) / self.width
        v = 1 - ((1 - v) * self.whole_height - self.top) / self.height
        return torch.stack((u, v))

    def whole_size(self, size: tuple[int, int]) -> tuple[int, int]:
        """Return the size in texels of a whole texture whose part is stored in `size` texels."""
        rows, columns = size[0] * self.whole_height / self.height, size[1] * self.whole_width / self.width
        return max(1, round(rows)), max(1, round(columns))

    def as_table(self) -> dict[str, Any]:
        """Return what a manifest holds."""
        return asdict(self)

    @classmethod
    def of_table(cls, table: Mapping[str, Any]) -> Cutout:
        """Return the cutout of a manifest; raises TypeError or RangeError for what is none."""
        return cls(**table)
