"""torchmat pack."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import tyro

from torchmat.cli.export import Export
from torchmat.cli.known import PACK_DEPTHS


@dataclass
class Pack:
    """Join the maps of a distribution material into few textures for a shader: the same as `export --to packed`."""

    reads: ClassVar = ("material",)
    words: ClassVar = {"depth": PACK_DEPTHS}

    material: Annotated[str, tyro.conf.Positional]
    """Material folder of a distribution material."""
    out: Path = Path("packed")
    """Folder to write; packed textures that are there are replaced."""
    force: bool = False
    """Replace them even if they were changed since, and keep them as NAME.backup-1."""
    depth: int = 8
    """8 or 16 bits a channel; specular maps are half floats and the tilt has 16 bits in both."""

    def run(self) -> None:
        Export(self.material, to="packed", out=self.out, force=self.force, set=[f"depth={self.depth}"]).run()
