"""torchmat export."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, ClassVar

import tyro

from torchmat.cli.arguments import SAMPLE, check_apart, options_of, provenance_of
from torchmat.progress import phase


@dataclass
class Export:
    """Write a material in another form, and say which of its parts come back exactly, nearly, or not at all."""

    reads: ClassVar = ("material", "btf")

    material: Annotated[str, tyro.conf.Positional]
    """Material folder, shading map (.3pm), GLB (.glb), or coefficients of RTI programs (.ptm, .rti, a folder with info.json)."""
    to: str | None = None
    """folder (torchmat's own, with --set storage=png8), 3pm (a shading map's slices), packed (few textures for a shader),
    gltf (GLB), orm (a texture set, with --set vendor=unity), materialx, mitsuba, blender, relight, openlime, ptm, rti (for RTI
    viewers), ktx2 (half floats), tiled (textures in tiles and levels), html (one page that shows it, moving, in any browser), or another exporter's name (default:
    as the suffix of --out says)."""
    out: Path | None = None
    """File or folder to write (default: called as the material, in the current folder). An earlier export there is
    replaced. The losses are written into the folder (loss.json) or beside the file (NAME.loss.json)."""
    force: bool = False
    """Replace it even if it was changed since, and keep it as NAME.backup-1."""
    mesh: str | None = None
    """glTF and html: what shows the material, a mesh file or quad, cube, sphere, torus, teapot (default: quad; html: teapot)."""
    btf: str | None = None
    """Folder, zip or file of images on which what the form holds is measured: on those that the material's fit held out."""
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
        options = options_of(self.set) | self._mesh(exporter.name) | self._report(exporter.options)
        measured = self._samples()
        with phase(f"writing {out.name}"):
            losses = export(
                load_material(self.material), out, exporter.name, provenance=self._provenance(), force=self.force,
                **measured, **options,
            )
        print(losses)
        print()
        print(f"{exporter.name:10s} {out}")
        print(f"losses     {loss_file(out, exporter)}")

    def _report(self, known: dict[str, Any]) -> dict[str, Any]:
        """Return the report that stands beside the material, for a form that shows its errors."""
        from torchmat.text_file import read_json

        path = Path(self.material) / "report.json"
        return {"report": read_json(path, "report.json", "be the report of a fit")} if "report" in known and path.is_file() else {}

    def _mesh(self, form: str) -> dict[str, Any]:
        """Return the mesh that a GLB or a page shows; shapes that it has itself by their names."""
        from torchmat.rendering.mesh import load_mesh
        from torchmat.rendering.shapes import SHAPES, make_mesh

        if self.mesh is None or self.mesh == "quad" or (form == "html" and self.mesh in SHAPES):
            return {} if self.mesh is None else {"mesh": self.mesh}
        with phase(f"reading {Path(self.mesh).name}"):
            return {"mesh": make_mesh(self.mesh) if self.mesh in SHAPES else load_mesh(self.mesh)}

    def _samples(self) -> dict[str, Any]:
        """Return the images that the form is measured on, and which of them the fit never saw."""
        from torchmat import load_btf, sample_path, split_samples

        if self.btf is None:
            return {}
        provenance = provenance_of(self.material)
        data = provenance.get("data")
        where = sample_path() if self.btf == SAMPLE and not Path(self.btf).exists() else self.btf
        with phase(f"reading {Path(self.btf).name}"):
            btf = load_btf(where, **(data if isinstance(data, dict) else {}))
        split: dict[str, Any] = {"holdout": 0.2, "holdout_by": "pair", "seed": 0}
        split |= {name: provenance[name] for name in split if name in provenance}
        found = split_samples(btf, split["holdout"], split["holdout_by"], split["seed"])
        return {"btf": btf, "samples": found.held_out if len(found.held_out) else None}

    def _provenance(self) -> dict:
        return {**provenance_of(self.material), "exported_from": Path(self.material).resolve().name}
