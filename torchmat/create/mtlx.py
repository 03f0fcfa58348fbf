"""What a MaterialX document beside a texture set says of its files: which input of the surface each of them feeds."""

from __future__ import annotations

import io
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

from torchmat.errors import DataError, message
from torchmat.text_file import read_text

SUFFIX = ".mtlx"
_SURFACES = ("standard_surface", "open_pbr_surface", "gltf_pbr", "UsdPreviewSurface", "disney_principled", "disney_brdf_2012")
_KINDS = {
    "base_color": "color", "baseColor": "color", "diffuseColor": "color", "specular_roughness": "roughness", "roughness": "roughness",
    "metalness": "metalness", "base_metalness": "metalness", "metallic": "metalness", "normal": "normalgl",
    "geometry_normal": "normalgl", "opacity": "opacity", "geometry_opacity": "opacity", "alpha": "opacity",
    "occlusion": "ambientocclusion", "displacement": "displacement",
}
_CHANNELS = {name: place for place, names in enumerate(("outr outx", "outg outy", "outb outz", "outa outw")) for name in names.split()}
_DEEPEST, _MOST_NODES = 32, 10_000
_FLOATING = (".exr", ".hdr")
_RESTORE = "Restore the document, or move it elsewhere: the files' names then say what they are."


class Named(NamedTuple):
    """A file that a document names, and which of its channels: None for all."""

    path: Path
    channel: int | None = None


class MtlxFiles(NamedTuple):
    """What a document says: the file of each kind of map (`texture_names.KINDS`), all that it names, and those whose names
    must tell, for they feed one input together."""

    document: Path
    kinds: dict[str, Named]
    every: frozenset[Path]
    open: frozenset[Path] = frozenset()


def document_of(folder: Path) -> Path | None:
    """Return the one MaterialX document of a folder; None where there is none, or where several leave open which counts."""
    found = [path for path in sorted(folder.iterdir()) if path.suffix.lower() == SUFFIX and path.is_file()]
    return found[0] if len(found) == 1 else None


def files_of_mtlx(document: Path) -> MtlxFiles:
    """Return the files that feed the inputs of a document's surface: standard_surface, OpenPBR, glTF's or UsdPreviewSurface.

    An input that several files feed, such as a colour times an occlusion, is left to the files' names. Raises DataError, which
    names the document, when it is damaged, or names a file that is not there or lies outside of its folder.
    """
    return _Document(document).files()


class _Document:
    def __init__(self, path: Path) -> None:
        self.path = path
        self.root = _parsed(path)
        self.named: set[Path] = set()
        self.spaces: dict[Path, str] = {}

    def _error(self, name: str, requirement: str, fact: str) -> DataError:
        return DataError(message(str(self.path), name, requirement, fact, _RESTORE))

    def files(self) -> MtlxFiles:
        """Return what the document says of its files."""
        kinds: dict[str, Named] = {}
        together: set[Path] = set()
        shaders = [node for node in self.root if node.tag in (*_SURFACES, "displacement")]
        for shader in shaders:
            for one in shader.findall("input"):
                kind = _KINDS.get(one.get("name", ""))
                if kind is None or kind in kinds:
                    continue
                found = self._fed_by(one, self.root)
                if len(found) == 1:
                    kinds[kind] = found.pop()
                together |= {named.path for named in found} if len(found) > 1 else set()
        self._check_colour(kinds.get("color"))
        for scope in (self.root, *self.root.findall("nodegraph")):
            for node in scope:
                for one in node.findall("input"):
                    if one.get("type") == "filename" and (one.get("value") or one.get("interfacename")):
                        self.named.add(self._file(one, scope))
        return MtlxFiles(self.path, kinds, frozenset(self.named), frozenset(together))

    def _check_colour(self, colour: Named | None) -> None:
        """Raise DataError for a colour that is said to be linear where pictures are read as sRGB."""
        space = "" if colour is None else self.spaces[colour.path]
        if colour is not None and space.startswith(("lin", "raw")) and colour.path.suffix.lower() not in _FLOATING:
            raise self._error(f"the colour space of {colour.path.name}", "be sRGB in whole numbers", f"it is {space!r:.40}")

    def _fed_by(self, link: ElementTree.Element, scope: ElementTree.Element) -> set[Named]:
        """Return the files, with their channels, from which an input's value is made."""
        found: set[Named] = set()
        seen: set[tuple[int, int | None]] = set()
        waiting: list[tuple[ElementTree.Element, ElementTree.Element, int | None]] = [(link, scope, None)]
        while waiting:
            link, scope, channel = waiting.pop()
            if len(seen) > _MOST_NODES:
                raise self._error("the graph", f"have at most {_MOST_NODES} links", "it has more")
            if (id(link), channel) in seen:
                continue
            seen.add((id(link), channel))
            channel = _CHANNELS.get(link.get("output", ""), channel)
            link, scope = self._through_graph(link, scope)
            node = self._by_name(scope, link.get("nodename"))
            if node is None:
                continue
            picture = next((one for one in node.findall("input") if one.get("name") == "file"), None)
            if picture is not None:
                found.add(Named(self._file(picture, scope), channel))
                continue
            if node.tag == "extract":
                channel = self._index(node)
            waiting += [(one, scope, channel) for one in node.findall("input")]
        return found

    def _through_graph(self, link: ElementTree.Element, scope: ElementTree.Element) -> tuple[ElementTree.Element, ElementTree.Element]:
        """Return the output of a node graph that a link leads to, and the graph; the link itself where it leads to none."""
        graph = self._by_name(self.root, link.get("nodegraph"))
        if graph is None:
            return link, scope
        outputs = graph.findall("output")
        wanted = [one for one in outputs if one.get("name") == link.get("output")] or (outputs if len(outputs) == 1 else [])
        if not wanted:
            raise self._error(f"the output {link.get('output')!r:.60}", f"be one of {link.get('nodegraph')!r:.60}", "it is not")
        return wanted[0], graph

    def _by_name(self, scope: ElementTree.Element, name: str | None) -> ElementTree.Element | None:
        return None if name is None else next((node for node in scope if node.get("name") == name), None)

    def _index(self, node: ElementTree.Element) -> int | None:
        value = next((one.get("value") for one in node.findall("input") if one.get("name") == "index"), None)
        return int(value) if value is not None and value in ("0", "1", "2", "3") else 0

    def _file(self, picture: ElementTree.Element, scope: ElementTree.Element) -> Path:
        """Return the path of an input that names a file, which lies in the document's folder and is there."""
        interface = picture.get("interfacename")
        if interface is not None:
            picture = next((one for one in scope.findall("input") if one.get("name") == interface), picture)
        name = picture.get("value", "")
        prefix = picture.get("fileprefix") or scope.get("fileprefix") or self.root.get("fileprefix") or ""
        folder = self.path.parent
        try:
            path = folder / (prefix + name).replace("\\", "/")
            inside = path.resolve().is_relative_to(folder.resolve())
            there = inside and path.is_file()
        except (OSError, ValueError, RuntimeError) as error:
            raise self._error(f"the file {name!r:.80}", "have a name that can be read", str(error)) from error
        if not name or not inside or not there:
            fact = "it has no name" if not name else "it is not there" if inside else "it leads elsewhere"
            raise self._error(f"the file {name!r:.80}", "lie in the document's folder", fact)
        self.spaces[path] = picture.get("colorspace", "")
        return path


def _parsed(path: Path) -> ElementTree.Element:
    text = read_text(path, "the MaterialX document")
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        fact = "it declares entities or a type, which MaterialX has not"
        raise DataError(message(str(path), "the MaterialX document", "be plain XML", fact, _RESTORE))
    depth, root = 0, None
    try:
        for event, element in ElementTree.iterparse(io.BytesIO(text.encode()), events=("start", "end")):
            depth += 1 if event == "start" else -1
            root = element if root is None else root
            if depth > _DEEPEST:
                raise DataError(message(str(path), "the MaterialX document", f"be at most {_DEEPEST} deep", "it is deeper", _RESTORE))
    except DataError:
        raise
    except (ElementTree.ParseError, ValueError, LookupError) as error:  # LookupError: an encoding that is none
        raise DataError(message(str(path), "the MaterialX document", "be XML", str(error), _RESTORE)) from error
    if root is None or root.tag != "materialx":
        fact = "it is empty" if root is None else f"its root is {root.tag!r:.60}"
        raise DataError(message(str(path), "the MaterialX document", "have the root materialx", fact, _RESTORE))
    return root
