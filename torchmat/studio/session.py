"""A material that is looked at and changed: what of a studio needs torch. Plain calls, of which the server makes one at a time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from torchmat.create.edits import EDITS, edited, without
from torchmat.errors import DataError, RangeError, TorchmatError, check_known_keys, message
from torchmat.material_io import change_material
from torchmat.material_io.change_folder import unchanged
from torchmat.material_io.choose_file import choose_file
from torchmat.material_io.read_folder import load_material, read_manifest, reread
from torchmat.models import Material
from torchmat.models.blend import blend
from torchmat.studio.pictured import Pictured
from torchmat.studio.place import check_links
from torchmat.studio.quick import quick_map
from torchmat.studio.reported import report_in
from torchmat.studio.textures import textures_of
from torchmat.swap import signature_of
from torchmat.web.errors import error_table
from torchmat.web.payload import TRANSFER, describe, describe_pictured, has_shader, map_of

if TYPE_CHECKING:
    from torchmat.studio.measured import Measured

Map = tuple[dict[str, Any], bytes]


class Session:
    """The material of a `folder`, as its textures held it when they were last read whole.

    `others` are folders of materials that it may be blended with, `btf` the images that it is compared with.
    """

    def __init__(self, folder: str, others: Sequence[str] = (), btf: str | None = None) -> None:
        self.folder = Path(folder)
        self._measured = None if btf is None else _measured(btf, self.folder)
        self._others = list(others)
        self._material: Material | None = None
        self._manifest: dict[str, Any] = {}
        self._maps: dict[str, Map] = {}  # as a page has them
        self._read_as: dict[str, Any] = {}
        self._stale: set[str] = set()  # maps that were saved since the material was read
        self._blended: dict[int, Material] = {}
        self._pictured = Pictured()

    @property
    def material(self) -> Material:
        """The material; it is read when it is first asked for."""
        if self._material is None:
            self.load()
        assert self._material is not None
        return self._material

    def load(self) -> dict[str, Any]:
        """Read the whole folder; return `description` and `buffers`, and which `textures` (file by name) it has.

        Raises DataError when a file cannot be used; the material then stays what it was.
        """
        manifest = read_manifest(self.folder)
        check_links(self.folder, list(textures_of(manifest).values()))
        self._material, self._manifest = load_material(self.folder), manifest
        self._stale.clear()
        self._maps = {}
        found = self.shown(self._material)
        self._maps = {entry["name"]: (entry, found["buffers"][entry["name"]]) for entry in found["description"]["maps"]}
        return found

    def now(self) -> dict[str, Any]:
        """Return what a page needs of the material as it was last read."""
        return self.shown(self.current())

    def shown(self, material: Material) -> dict[str, Any]:
        """Return what a page needs of a material; what of it is the same as in the folder is not encoded again."""
        if has_shader(material):
            payload = describe(material, self._known(material))
        else:
            payload = describe_pictured(material, self._known(material))
            payload.description["errors"] = error_table(report_in(self.folder))
        return {"description": payload.description, "buffers": payload.buffers, "textures": textures_of(self._manifest)}

    def _known(self, material: Material) -> dict[str, Map]:
        if self._material is None:
            return {}
        same = unchanged(self._material, material) & self._maps.keys() - self._stale
        follows = {"height", material.diffuse_map} & material.maps.keys()
        if TRANSFER.name in self._maps and follows <= same:
            same.add(TRANSFER.name)
        return {name: self._maps[name] for name in same}

    def read(self, names: Sequence[str]) -> dict[str, Any]:
        """Read some maps again, and nothing else; return `maps` by name, and in `failed` what is wrong with others.

        A map with a file that is not whole, or is being written, stays what it was.
        """
        found: dict[str, Map] = {}
        failed: dict[str, str] = {}
        for name in names:
            textures = [entry for entry in self._manifest.get("textures", ()) if entry["map"] == name]
            files = [entry["file"] for entry in textures]
            try:
                check_links(self.folder, files)
                before = [signature_of(self.folder / file) for file in files]
                quick = quick_map(self.folder, textures, self._maps[name][0]) if name in self._maps else None
                if quick is None:
                    self._material = reread(self.folder, self._manifest, self.material, name)
                if before != [signature_of(self.folder / file) for file in files]:
                    raise DataError(message(str(self.folder / files[0]), "the texture", "be whole", "it is being written"))
                found |= self._followed(name, quick)
            except TorchmatError as error:
                failed[name] = str(error)
        return {"maps": found, "failed": failed}

    def _followed(self, name: str, quick: Map | None) -> dict[str, Map]:
        """Return a map that was read, and those that follow from it; with `quick` it is read for edits when one needs it."""
        if quick is None:
            self._stale.discard(name)
            found = {name: map_of(self.material, name)}
        else:
            self._stale.add(name)
            found = {name: quick}
        if TRANSFER.name in self._maps and name in ("height", self.material.diffuse_map):
            found[TRANSFER.name] = map_of(self.current(), TRANSFER.name)
        self._maps |= found
        return found

    def current(self) -> Material:
        """Return the material with all that was saved since it was read."""
        for name in sorted(self._stale):
            self._material = reread(self.folder, self._manifest, self.material, name)
            self._stale.discard(name)
        return self.material

    def preview(self, edits: Mapping[str, Mapping[str, Any]], drop: Sequence[str] = ()) -> dict[str, Any]:
        """Return what the material looks like after edits (`create.edits.EDITS`), without writing anything."""
        return self.shown(self._edited(self.current(), edits, drop))

    def _edited(self, material: Material, edits: Mapping[str, Mapping[str, Any]], drop: Sequence[str]) -> Material:
        check_known_keys("studio", edits, [name for name in EDITS if name != "without"])
        for name in drop:
            material = without(material, name)
        try:
            return edited(material, {name: dict(keywords) for name, keywords in edits.items()})
        except (TypeError, ValueError) as error:
            if isinstance(error, TorchmatError):
                raise
            raise RangeError(message("studio", "the edit", "be one that there is", str(error))) from error

    def apply(self, edits: Mapping[str, Mapping[str, Any]], drop: Sequence[str] = ()) -> dict[str, Any]:
        """Write edits into the folder, as `torchmat edit` does; return what the page needs then and which maps are `changed`."""
        record = {**({"without": list(drop)} if drop else {}), **edits}
        return self._write(lambda material: self._edited(material, edits, drop), record)

    def _write(self, change: Any, record: dict[str, Any]) -> dict[str, Any]:
        done = change_material(self.folder, change, record)
        backup = None if done.backup is None else str(done.backup)
        return {**self.load(), "changed": list(done.maps), "backup": backup}

    def choose(self, texture: str, file: str) -> dict[str, Any]:
        """Let another file of the folder be a texture of the material, from now on and for every command."""
        choose_file(self.folder, texture, file)
        return {**self.load(), "changed": [texture], "backup": None}

    def blended(self, other: int, weight: float) -> dict[str, Any]:
        """Return what the material looks like on its way, `weight` (0 to 1), to another one of `others`."""
        return self.shown(blend(self.current(), self._other(other), weight))

    def apply_blend(self, other: int, weight: float) -> dict[str, Any]:
        """Write the blend into the folder."""
        target = self._other(other)
        record = {"blend": {"with": Path(self._others[other]).name, "weight": weight}}
        return self._write(lambda material: blend(material, target, weight), record)

    def _other(self, number: int) -> Material:
        if not isinstance(number, int) or isinstance(number, bool) or not 0 <= number < len(self._others):
            fact = f"it is {number!r}, and there are {len(self._others)}"
            raise RangeError(message("studio", "the other material", "be one of those that were named", fact))
        if number not in self._blended:
            self._blended[number] = load_material(self._others[number])
        return self._blended[number]

    def picture(self, **look: Any) -> bytes:
        """Return a picture of the material with all that was saved (`Pictured.picture`)."""
        return self._pictured.picture(self.current(), **look)

    def beside(self, light: Sequence[float], view: Sequence[float]) -> dict[str, Any]:
        """Return the measured pair nearest to two directions beside the material in the folder (`Measured.beside`)."""
        assert self._measured is not None
        return self._measured.beside(self._whole(), light, view)

    def held_out(self) -> dict[str, Any]:
        """Return the figures of the material in the folder on the pairs that its fit held out (`Measured.held_out`)."""
        assert self._measured is not None
        return self._measured.held_out(self._whole())

    def _whole(self) -> Material:
        """Return the material in the folder, read anew if anything in it changed."""
        manifest = read_manifest(self.folder)
        state = {name: signature_of(self.folder / name) for name in ("manifest.json", *textures_of(manifest).values())}
        if state != self._read_as:
            self._material, self._manifest, self._read_as = load_material(self.folder), manifest, state
            self._stale.clear()
        return self.material

    def take_over(self, folder: str, maps: Sequence[str], record: dict[str, Any]) -> dict[str, Any]:
        """Write some maps of another material folder, such as a refit gave, into this one."""
        source = load_material(folder)

        def change(material: Material) -> Material:
            return material.with_maps(**{name: source.maps[name].detach() for name in maps})

        return self._write(change, record)


def _measured(btf: str, folder: Path) -> Measured:
    from torchmat.studio.measured import Measured  # all that fits and reports with it, for which a first picture need not wait

    return Measured(btf, folder)
