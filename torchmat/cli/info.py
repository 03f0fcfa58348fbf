"""torchmat info."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, ClassVar

import tyro

from torchmat.cli.arguments import SAMPLE, DataArguments


@dataclass
class Info:
    """Describe any input: a folder, zip or file of images, a material folder, a shading map, a measured BRDF, a texture set,
    or a mesh."""

    reads: ClassVar = ("path",)

    path: Annotated[str, tyro.conf.Positional] = SAMPLE
    """What to describe; coefficients of RTI programs (.ptm, .rti, a folder with info.json) are materials."""
    plot: Path | None = None
    """Where to write a picture of lights and views (BTFs only; default: none is written)."""
    no_plot: bool = False
    """Print only, as without --plot."""
    read: Annotated[DataArguments, tyro.conf.arg(name="")] = field(default_factory=DataArguments)

    def run(self) -> None:
        from torchmat.brdf import is_brdf_file
        from torchmat.btf.lambert import lambert_of
        from torchmat.create.textures import is_texture_set
        from torchmat.rendering.mesh_file import is_mesh
        from torchmat.report.describe import describe_brdf, describe_btf, describe_material, describe_textures, is_material
        from torchmat.report.lights import lambert_text

        if is_material(self.path):
            print(describe_material(self.path))
            return
        if is_brdf_file(self.path):
            print(describe_brdf(self.path))
            return
        if is_mesh(self.path):
            from torchmat.report.describe import describe_own_material
            from torchmat.report.describe_mesh import describe_mesh

            print(describe_mesh(self.path) + describe_own_material(self.path))
            return
        if is_texture_set(self.path):
            print(describe_textures(self.path))
            return
        btf = self.read.load(self.path)
        print(describe_btf(btf))
        for line in lambert_text(lambert_of(btf)):
            print(line)
        if self.plot is not None and not self.no_plot:
            from torchmat.report.pictures import directions_picture

            print(f"picture    {directions_picture(btf, self.plot)}")
