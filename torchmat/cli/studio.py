"""torchmat studio."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, ClassVar

import tyro


@dataclass
class Studio:
    """See a material move on a page of this machine, and change it there, while its maps are painted in any program (needs
    torchmat[studio])."""

    reads: ClassVar = ("material", "btf", "blend")
    bounds: ClassVar = {"port": ("lie in [1, 65535]", 1, 65535)}

    material: Annotated[str, tyro.conf.Positional]
    """Material folder, or a picture, of which a material is made beside it as `create` makes it."""
    btf: str | None = None
    """Images that the material was made of: to compare it with them, and to fit maps anew."""
    blend: list[str] = field(default_factory=list)
    """Folders of other materials that it may be blended with."""
    port: int | None = None
    """Port of this machine (default: 8473, or the next that is free)."""
    no_browser: bool = False
    """Only print the address."""

    def run(self) -> None:
        from torchmat.studio.serve import open_studio

        open_studio(self.material, self.btf, self.blend, self.port, not self.no_browser)
