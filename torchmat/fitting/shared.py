"""What all texels of one material have in common: found on some of them, known to the fits of the others."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from torch import Tensor

from torchmat.models import Material


@dataclass(frozen=True)
class Shared:
    """What is known of all texels; a model that knows more derives from it and names the class in its recipe.

    `tables` are maps of the material that are no texel's own, by name, as it holds them. `usual_ambient`, a number, is
    on a relief the share of the light that reaches a texel in shadow. Fields of derived classes are tensors, numbers or
    None.
    """

    tables: Mapping[str, Tensor] = field(default_factory=dict)
    usual_ambient: Tensor | None = None

    def moved_to(self, material: Material) -> Shared:
        """Return the same with the tables of `material`, in their own precision."""
        moved = {name: material.maps[name].detach().to(value.dtype) for name, value in self.tables.items()}
        return dataclasses.replace(self, tables=moved)

    def pieces(self) -> tuple[dict[str, Tensor], dict[str, float]]:
        """Return all of it as named tensors and numbers, which `from_pieces` puts together again."""
        own = {one.name: getattr(self, one.name) for one in dataclasses.fields(self) if one.name != "tables"}
        tensors = {name: value for name, value in own.items() if isinstance(value, Tensor)}
        numbers = {name: value for name, value in own.items() if value is not None and name not in tensors}
        return tensors | {f"tables.{name}": value for name, value in self.tables.items()}, numbers

    @classmethod
    def from_pieces(cls, tensors: Mapping[str, Tensor], numbers: Mapping[str, float]) -> Shared:
        """Return what `pieces` took apart."""
        tables = {name.removeprefix("tables."): one for name, one in tensors.items() if name.startswith("tables.")}
        own: dict[str, Any] = {name: one for name, one in tensors.items() if not name.startswith("tables.")}
        return cls(tables=tables, **own | dict(numbers))
