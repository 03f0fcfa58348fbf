"""The numbers of a glTF file: buffers, views of them, and accessors as the specification (2.0, 3.6) defines them."""

from __future__ import annotations

import base64
import binascii
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from torchmat.errors import DataError, message
from torchmat.rendering.triangles import CHECK_FILE

_TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_MOST = 1 << 31  # numbers of an accessor; one without a view needs no bytes for them
DRACO = "KHR_draco_mesh_compression"
MESHOPT = ("EXT_meshopt_compression", "KHR_meshopt_compression")
_UNPACK = {
    DRACO: "Decompress it with 'gltf-transform copy in.glb out.glb', or export it from Blender without compression.",
    **dict.fromkeys(MESHOPT, "Decompress it with 'gltf-transform copy in.glb out.glb', or export it without."),
}


class Accessors:
    """Reads the accessors of a glTF's `tree`; `chunk` is a GLB's own buffer, other files lie beside `path`.

    Errors are DataErrors that name the file and the accessor, view or buffer.
    """

    def __init__(self, tree: dict[str, Any], chunk: bytes | None, path: Path) -> None:
        self._tree, self._chunk, self._path, self.where = tree, chunk, path, str(path)
        self._buffers: dict[int, bytes] = {}

    def item(self, kind: str, number: object) -> dict[str, Any]:
        """Return one of the tree's lists' items, as {"accessors", 3} names it."""
        items = self._tree.get(kind, [])
        items = items if isinstance(items, list) else []
        if isinstance(number, int) and not isinstance(number, bool) and 0 <= number < len(items):
            item = items[number]
            if isinstance(item, dict):
                return item
        raise self.error(f"number {number!r:.60} of its {kind}", "be there", f"there are {len(items)}")

    def error(self, what: str, requirement: str, fact: str, step: str = CHECK_FILE) -> DataError:
        """Return an error about the file."""
        return DataError(message(self.where, what, requirement, fact, step))

    def whole(self, item: dict[str, Any], key: str, default: int | None, what: str) -> int:
        """Return a whole number from 0 of an item; one that is absent and has no default is an error."""
        value = item.get(key, default)
        if isinstance(value, float) and value.is_integer():
            value = int(value)
        if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < 1 << 53:
            raise self.error(f"{key} of {what}", "be a whole number from 0", f"it is {value!r:.60}")
        return value

    def read(self, number: object, widths: tuple[str, ...]) -> np.ndarray:
        """Return the numbers [count, width] of an accessor of one of the types `widths`.

        Integers that are marked as normalised stand for 0..1, or -1..1 where they have a sign; others stay as they
        are. What a sparse accessor replaces is replaced, and one without a view is zero elsewhere. Floats come as
        float32, what was normalised as float64.
        """
        item, what = self.item("accessors", number), f"accessor {number}"
        kind, component = item.get("type"), item.get("componentType")
        if not isinstance(kind, str) or kind not in widths:
            raise self.error(f"the type of {what}", f"be {' or '.join(widths)}", f"it is {kind!r:.60}")
        if not isinstance(component, int) or component not in _TYPES:
            known = ", ".join(map(str, _TYPES))
            raise self.error(f"componentType of {what}", f"be one of {known}", f"it is {component!r:.60}")
        width, dtype, count = _WIDTHS[kind], np.dtype(_TYPES[component]), self.whole(item, "count", None, what)
        if count * width > _MOST:
            raise self.error(f"count of {what}", "fit into memory", f"it is {count}")
        if "bufferView" in item:
            offset = self.whole(item, "byteOffset", 0, what)
            values = self._strided(item["bufferView"], offset, count, width, dtype, what)
        elif "sparse" not in item:
            self._check_packed(what)
            values = np.broadcast_to(np.zeros(width, dtype), (count, width))
        else:
            values = np.zeros((count, width), dtype)
        if "sparse" in item:
            values = self._replaced(values, item["sparse"], what)
        if item.get("normalized") is True and dtype.kind in "iu":
            return np.maximum(values / float(np.iinfo(dtype).max), -1.0)
        return values

    def _check_packed(self, what: str) -> None:
        """Raise DataError when a file that uses compression has an accessor without numbers."""
        used = self._tree.get("extensionsUsed")
        for name in (DRACO, *MESHOPT):
            if isinstance(used, list) and name in used:
                raise packed_error(self.where, name, f"{what} has no numbers of its own")

    def _replaced(self, values: np.ndarray, sparse: object, what: str) -> np.ndarray:
        what = f"the sparse part of {what}"
        sparse = sparse if isinstance(sparse, dict) else {}
        indices, replacing = sparse.get("indices"), sparse.get("values")
        if not isinstance(indices, dict) or not isinstance(replacing, dict):
            raise self.error(what, "have indices and values", "it has not")
        count = self.whole(sparse, "count", None, what)
        component = indices.get("componentType")
        if component not in (5121, 5123, 5125):
            raise self.error(f"the indices of {what}", "be unsigned", f"componentType is {component!r:.60}")
        offsets = [self.whole(part, "byteOffset", 0, what) for part in (indices, replacing)]
        rows = self._strided(indices.get("bufferView"), offsets[0], count, 1, np.dtype(_TYPES[component]), what)[:, 0]
        if count and int(rows.max()) >= len(values):
            raise self.error(f"the indices of {what}", f"be below {len(values)}", f"one is {int(rows.max())}")
        given = self._strided(replacing.get("bufferView"), offsets[1], count, values.shape[1], values.dtype, what)
        values = np.array(values)
        values[rows] = given
        return values

    def _strided(
        self, number: object, offset: int, count: int, width: int, dtype: np.dtype, what: str
    ) -> np.ndarray:
        """Return `count` rows of numbers out of a view of a buffer."""
        view, size = self.item("bufferViews", number), width * dtype.itemsize
        name = f"bufferView {number}"
        stride = self.whole(view, "byteStride", 0, name) or size
        begin = self.whole(view, "byteOffset", 0, name)
        length = self.whole(view, "byteLength", None, name)
        if stride < size or stride > 1 << 16:
            raise self.error(f"byteStride of {name}", f"hold the {size} bytes of {what}", f"it is {stride}")
        if not count:
            return np.zeros((0, width), dtype)
        needed = offset + (count - 1) * stride + size
        if needed > length:
            raise self.error(what, f"lie inside of {name}", f"it ends at byte {needed} of {length}")
        buffer = self._buffer(view, name)
        if begin + needed > len(buffer):
            raise self.error(what, "lie inside of its buffer", f"it ends at byte {begin + needed} of {len(buffer)}")
        return np.ndarray((count, width), dtype, buffer, begin + offset, (stride, dtype.itemsize))

    def _buffer(self, view: dict[str, Any], name: str) -> bytes:
        number = view.get("buffer", -1)
        item = self.item("buffers", number)
        if number not in self._buffers:
            self._buffers[number] = self._bytes_of(number, item, view, name)
        return self._buffers[number]

    def _bytes_of(self, number: int, item: dict[str, Any], view: dict[str, Any], name: str) -> bytes:
        uri, what = item.get("uri"), f"buffer {number}"
        if uri is None:
            extensions = view.get("extensions")
            for packed in MESHOPT:
                if isinstance(extensions, dict) and packed in extensions and (number or self._chunk is None):
                    raise packed_error(self.where, packed, f"{name} has no other numbers")
            if number != 0 or self._chunk is None:
                raise self.error(what, "have bytes", "it names no file")
            data = self._chunk
        elif not isinstance(uri, str):
            raise self.error(f"the uri of {what}", "be a text", f"it is {uri!r:.60}")
        elif uri.startswith("data:"):
            data = self._decoded(uri, what)
        else:
            data = self._beside(uri, what)
        length = self.whole(item, "byteLength", None, what)
        if len(data) < length:
            raise self.error(what, "be complete", f"it has {len(data)} of its {length} bytes")
        return data

    def _decoded(self, uri: str, what: str) -> bytes:
        head, mark, body = uri.partition(",")
        if not mark or not head.endswith(";base64"):
            raise self.error(what, "be in base64", f"it begins {uri[:40]!r}")
        try:
            return base64.b64decode(unquote(body), validate=True)
        except (ValueError, binascii.Error) as error:
            raise self.error(what, "be in base64", str(error)) from error

    def _beside(self, uri: str, what: str) -> bytes:
        name = unquote(uri)
        path = self._path.parent / name
        inside = not Path(name).is_absolute() and ".." not in Path(name).parts and "://" not in name
        if not inside:
            step = "Keep the .bin file in the folder of the .gltf, or below it."
            raise self.error(f"the file of {what}", "lie beside the .gltf", f"it is {name[:80]!r}", step)
        try:
            if not path.is_file():
                raise self.error(f"the file of {what}", "exist", f"there is no {name[:80]!r}", "Copy it beside the .gltf.")
            return path.read_bytes()
        except (OSError, ValueError) as error:  # ValueError: a NUL in the name
            raise self.error(f"the file of {what}", "be readable", f"{name[:80]!r}: {error}") from error


def packed_error(where: str, name: str, fact: str) -> DataError:
    """Return the error of a file whose geometry is compressed by the extension `name`."""
    kind = "Draco" if name == DRACO else "meshopt"
    fact = f"it needs {name} (it is {kind}-compressed): {fact}"
    return DataError(message(where, "the mesh file", "be uncompressed", fact, _UNPACK[name]))
