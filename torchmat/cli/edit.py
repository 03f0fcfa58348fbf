"""torchmat edit."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, ClassVar

import tyro

from torchmat.progress import phase


@dataclass
class Edit:
    """Change maps of a material that exists, by the controls that `create` has: only their files are written, whole or not
    at all, and a painted one stays in a backup."""

    reads: ClassVar = ("material",)

    material: Annotated[str, tyro.conf.Positional]
    """Material folder."""
    height_scale: float | None = None
    """Height from black to white in texture widths; 0 makes the surface flat."""
    normal_strength: float | None = None
    """Factor on the slopes of the normals, up to 8; 1 leaves them, and the height stays."""
    mask: tuple[float, float] | None = None
    """Brightness and contrast that make the specular mask of the diffuse luminance; 0 1 leave it as it is."""
    fresnel: tuple[float, float] | None = None
    """The same for the reflectance at normal incidence, for example -0.43 0.1."""
    source: str = "diffuse"
    """What --mask and --fresnel change: the luminance of the diffuse map, or the map itself (itself)."""
    darken: float | None = None
    """Share of the diffuse light to take away, 0 to 1."""
    tilt: str | None = None
    """default, velvet, gentle or flat, or points DEGREES:TILT,... as 0:0,30:0.1,90:1."""
    centre: Annotated[list[tuple[float, float]], tyro.conf.UseAppendAction] = field(default_factory=list)
    """Draw 360: u and v (0 to 1, v up) about which the specular map turns; may be repeated."""
    region: tuple[float, float, float, float] | None = None
    """Draw 360 within left, bottom, right and top only (u and v); about its middle, unless --centre is given."""
    specular: list[str] = field(default_factory=list)
    """Specular maps, one for each there is: glossy, soft, rim, anisotropic or noise, as glossy:width=0.1; keep leaves one
    as it is."""
    index: int | None = None
    """Lay so many specular maps on the colours of the diffuse map, dark to light."""
    softness: float = 0.0
    """With --index: how softly its colours pass into each other, in Lab units."""
    seed: int = 0
    """With --index: seed of the search for its colours."""
    without: list[str] = field(default_factory=list)
    """Maps to leave out: normal, specular_mask, fresnel, rotation, tilt."""
    file: list[str] = field(default_factory=list)
    """Another file of the folder for a texture, from now on: diffuse=diffuse_blue.png; with a number where a map has several."""
    tiles: bool | None = None
    """Whether the surface repeats at its borders."""
    out: Path | None = None
    """Another folder for the result (default: the material itself is changed)."""
    force: bool = False
    """With --out: replace what was painted there too, and keep it as NAME.backup-1."""

    def run(self) -> None:
        from torchmat.create.edits import edited, without
        from torchmat.errors import RangeError, message
        from torchmat.material_io import change_material

        edits = self._edits()
        if self.file:
            self._choose()
        if not edits and not self.without:
            if self.file:
                return
            step = "For example --height-scale 0.02; torchmat edit --help lists them."
            raise RangeError(message("edit", "the edits", "be at least one", "there is none", step))

        def change(material):
            for name in self.without:
                material = without(material, name)
            return edited(material, edits)

        record = {**({"without": self.without} if self.without else {}), **edits}
        with phase(f"changing {Path(self.material).name}"):
            done = change_material(self.material, change, record, self.out, self.force)
        print(f"changed    {', '.join(done.maps) or 'no map'}")
        for name in done.files:
            print(f"written    {done.folder / name}")
        if done.backup is not None:
            print(f"backup     {done.backup}")
        print(f"material   {done.folder}")

    def _choose(self) -> None:
        """Let other files of the folder be textures."""
        from torchmat.errors import RangeError, message
        from torchmat.material_io.choose_file import choose_file

        if self.out is not None:
            raise RangeError(message("edit", "--file", "change the material itself", "--out names another", "Leave --out out."))
        for text in self.file:
            texture, _, file = text.partition("=")
            choose_file(self.material, texture, file)
            print(f"texture    {texture} is {Path(self.material) / file}")

    def _edits(self) -> dict[str, dict[str, Any]]:
        """Return the edits that were asked for, by name, with what they are given."""
        found: dict[str, dict[str, Any]] = {}
        if self.index is not None:
            found["index"] = {"lobes": self.index, "softness": self.softness, "seed": self.seed}
        if self.specular:
            found["specular"] = {"maps": self.specular}
        if self.height_scale is not None:
            found["height_scale"] = {"scale": self.height_scale}
        if self.normal_strength is not None:
            found["normal_strength"] = {"strength": self.normal_strength}
        for name in ("mask", "fresnel"):
            given = getattr(self, name)
            if given is not None:
                found[name] = {"brightness": given[0], "contrast": given[1], "source": self.source}
        if self.darken is not None:
            found["darken"] = {"share": self.darken}
        if self.tilt is not None:
            found["tilt"] = {"curve": self.tilt}
        if self.centre or self.region is not None:
            found["rotation"] = {"centres": self.centre, "region": self.region}
        if self.tiles is not None:
            found["tiles"] = {"repeats": self.tiles}
        return found
