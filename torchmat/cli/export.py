"""torchmat export."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, ClassVar

import tyro

from torchmat.cli.arguments import check_apart, options_of, provenance_of
from torchmat.progress import phase


@dataclass
class Export:
    """Write a material in another form, and say which of its parts come back exactly, nearly, or not at all."""

    reads: ClassVar = ("material",)

    material: Annotated[str, tyro.conf.Positional]
    """Material folder, shading map (.3pm), or coefficients of RTI programs (.ptm, .rti, a folder with info.json)."""
    to: str | None = None
    """folder (torchmat's own, with --set storage=png8), 3pm (a shading map's slices), packed (few textures for a shader),
    relight, openlime, ptm, rti (for RTI viewers), ktx2 (half floats for renderers), or another exporter's name (default: as
    the suffix of --out says)."""
    out: Path | None = None
    """File or folder to write (default: called as the material, in the current folder). An earlier export there is
    replaced. The losses are written into the folder (loss.json) or beside the file (NAME.loss.json)."""
    force: bool = False
    """Replace it even if it was changed since, and keep it as NAME.backup-1."""
    set: Annotated[list[str], tyro.conf.UseAppendAction] = field(default_factory=list)
    """Option of the exporter, for example --set depth=16; may be repeated."""

    def check_names(self) -> None:
        from torchmat.cli.known import known_exporters
        from torchmat.errors import check_option

        if self.to is not None:
            check_option("export", "to", self.to, known_exporters())

    def run(self) -> None:
        from torchmat import export, load_material
        from torchmat.material_io.exporter import chosen_exporter, loss_file

        exporter = chosen_exporter(self.out or "", self.to)
        out = self.out or Path(Path(self.material).resolve().stem + (exporter.suffix or f"_{exporter.name}"))
        check_apart("export", out, self.material)
        with phase(f"writing {out.name}"):
            losses = export(
                load_material(self.material), out, exporter.name, provenance=self._provenance(), force=self.force,
                **options_of(self.set),
            )
        print(losses)
        print()
        print(f"{exporter.name:10s} {out}")
        print(f"losses     {loss_file(out, exporter)}")

    def _provenance(self) -> dict:
        return {**provenance_of(self.material), "exported_from": Path(self.material).resolve().name}
