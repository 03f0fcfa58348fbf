"""glTF 2.0 and GLB: the triangles that the nodes of a file's scene show.

trimesh takes normalised integers raw, passes over sparse accessors, texture coordinates without a material and
extensions that a file requires, and pygltflib returns the tree without its numbers. What a mesh needs of the
specification fits into this module, `mesh_gltf_tree` and `mesh_accessors`, which refuse by name what they do not know.
Skins and morphs stay at rest.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from torchmat.rendering.mesh_accessors import DRACO, Accessors, packed_error
from torchmat.rendering.mesh_gltf_tree import TRANSFORM, tree_of
from torchmat.rendering.triangles import Triangles, check_corners, moved, of_vertices, together

_MOST_TRIANGLES = 50_000_000  # a few bytes can ask for more: nodes that all show the same
_TEXTURES = ("baseColorTexture", "normalTexture", "metallicRoughnessTexture", "occlusionTexture", "emissiveTexture")
_INSTANCES = "EXT_mesh_gpu_instancing"


def read_gltf(data: bytes, path: Path, binary: bool) -> tuple[Triangles | None, set[str]]:
    """Return the triangles of a glTF's bytes, None when its scene shows none, and what else it shows.

    Of several scenes the one that the file begins with counts, or else the first; without any, every mesh whose node
    has no parent. Texture coordinates are those of the base colour's texture, moved as KHR_texture_transform says.
    Raises DataError for what is cut short, broken, compressed, or needs an extension that is not known here.
    """
    tree, chunk = tree_of(data, str(path), binary)
    accessors = Accessors(tree, chunk, path)
    scene = _Scene(accessors, tree)
    parts, total = [], 0
    for mesh, transform in scene.placed():
        for part in scene.parts(mesh):
            total += len(part.faces)
            if total > _MOST_TRIANGLES:
                raise accessors.error("the scene", f"show at most {_MOST_TRIANGLES} triangles", "its nodes show more")
            with np.errstate(invalid="ignore", over="ignore"):  # of NaN and Inf, which are looked for afterwards
                parts.append(moved(part, transform))
    return together(parts) if parts else None, scene.others


class _Scene:
    """The nodes, meshes and materials of a tree."""

    def __init__(self, accessors: Accessors, tree: dict[str, Any]) -> None:
        self._accessors, self._tree = accessors, tree
        self._parts: dict[int, list[Triangles]] = {}
        self.others: set[str] = set()

    def _list(self, item: dict[str, Any], key: str, what: str) -> list:
        found = item.get(key, [])
        if not isinstance(found, list):
            raise self._accessors.error(f"{key} of {what}", "be a list", f"it is a {type(found).__name__}")
        return found

    def placed(self) -> list[tuple[int, np.ndarray]]:
        """Return (mesh, transform [4, 4]) of every node of the scene that has one."""
        scenes, nodes = self._list(self._tree, "scenes", "the file"), self._list(self._tree, "nodes", "the file")
        if scenes:
            number = self._tree.get("scene", 0)
            listed = self._list(self._accessors.item("scenes", number), "nodes", f"scene {number!r:.60}")
        else:
            listed = list(range(len(nodes)))
        # What hangs from another node of the scene is where that one puts it, though some files list both.
        below = self._below(listed)
        roots = [number for number in listed if number not in below]
        if listed and not roots:
            raise self._accessors.error("nodes", "hang from a root", "each of the scene's hangs from another")
        found, seen = [], set()
        waiting = [(number, np.eye(4)) for number in reversed(roots)]
        while waiting:
            number, above = waiting.pop()
            node = self._accessors.item("nodes", number)
            if number in seen:
                raise self._accessors.error(f"node {number}", "have one parent", "it has more, or is its own")
            seen.add(number)
            with np.errstate(all="ignore"):  # of NaN and Inf, which are looked for afterwards
                transform = above @ self._transform(node, f"node {number}")
            if "mesh" in node:
                self._check_instances(node, f"node {number}")
                found.append((node["mesh"], transform))
            waiting += [(child, transform) for child in reversed(self._list(node, "children", f"node {number}"))]
        return found

    def _below(self, roots: list) -> set[int]:
        """Return all nodes that hang from some nodes."""
        found: set[int] = set()
        waiting = list(roots)
        while waiting:
            number = waiting.pop()
            for child in self._list(self._accessors.item("nodes", number), "children", f"node {number}"):
                self._accessors.item("nodes", child)
                if child not in found:
                    found.add(child)
                    waiting.append(child)
        return found

    def _check_instances(self, node: dict[str, Any], what: str) -> None:
        extensions = node.get("extensions")
        if isinstance(extensions, dict) and _INSTANCES in extensions:
            step = "Turn instances into nodes with 'gltf-transform uninstance in.glb out.glb'."
            raise self._accessors.error(what, "show its mesh once", f"it uses {_INSTANCES}", step)

    def _transform(self, node: dict[str, Any], what: str) -> np.ndarray:
        if "matrix" in node:
            return self._vector(node, "matrix", 16, what).reshape(4, 4).T
        result = np.eye(4)
        x, y, z, w = self._vector(node, "rotation", 4, what, (0, 0, 0, 1))
        length = math.sqrt(x * x + y * y + z * z + w * w)
        if not 0 < length < math.inf:
            raise self._accessors.error(f"rotation of {what}", "be a unit quaternion", f"its length is {length}")
        x, y, z, w = x / length, y / length, z / length, w / length
        turn = np.array([
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ])
        result[:3, :3] = turn * self._vector(node, "scale", 3, what, (1, 1, 1))
        result[:3, 3] = self._vector(node, "translation", 3, what, (0, 0, 0))
        return result

    def _vector(self, item: dict[str, Any], key: str, count: int, what: str, default: tuple = ()) -> np.ndarray:
        given = item.get(key, default)
        numbers = isinstance(given, list | tuple) and len(given) == count
        if not numbers or not all(isinstance(k, int | float) and not isinstance(k, bool) for k in given):
            raise self._accessors.error(f"{key} of {what}", f"be {count} numbers", f"it is {given!r:.80}")
        try:
            found = np.array([float(k) for k in given])
        except OverflowError:
            found = np.array([math.inf])
        if not np.isfinite(found).all():
            raise self._accessors.error(f"{key} of {what}", "be finite", f"it is {given!r:.80}")
        return found

    def parts(self, number: Any) -> list[Triangles]:
        """Return the triangles of each primitive of a mesh."""
        mesh = self._accessors.item("meshes", number)
        if number not in self._parts:
            primitives = self._list(mesh, "primitives", f"mesh {number}")
            read = [self._primitive(item, f"primitive {k} of mesh {number}") for k, item in enumerate(primitives)]
            self._parts[number] = [part for part in read if part is not None]
        return self._parts[number]

    def _primitive(self, item: Any, what: str) -> Triangles | None:
        accessors = self._accessors
        attributes = item.get("attributes") if isinstance(item, dict) else None
        if not isinstance(attributes, dict):
            raise accessors.error(what, "have attributes", "it has none")
        mode = item.get("mode", 4)
        if mode in (0, 1, 2, 3) and not isinstance(mode, bool):
            self.others.add("points" if mode == 0 else "lines")
            return None
        if mode not in (4, 5, 6) or isinstance(mode, bool):
            raise accessors.error(f"mode of {what}", "be 0 to 6", f"it is {mode!r:.60}")
        if "POSITION" not in attributes:
            return None  # as the specification says of those without
        self._check_packed(item, attributes, what)
        position = accessors.read(attributes["POSITION"], ("VEC3",)).astype(np.float64)
        if "indices" in item:
            corners = accessors.read(item["indices"], ("SCALAR",))
            if corners.dtype.kind != "u":
                raise accessors.error(f"indices of {what}", "be unsigned integers", f"they are {corners.dtype}")
            corners = corners[:, 0].astype(np.int64)
        else:
            corners = np.arange(len(position))
        faces = _faces(corners, mode)
        if mode == 4 and len(corners) % 3:
            raise accessors.error(f"the corners of {what}", "be three for each triangle", f"they are {len(corners)}")
        if not len(faces):
            return None
        check_corners(faces, len(position), accessors.where)
        tables = {}
        name, transform, materials = self._material(item, what)
        for key, widths in (("NORMAL", ("VEC3",)), (name, ("VEC2",))):
            if key in attributes:
                tables[key] = accessors.read(attributes[key], widths).astype(np.float64)
                if len(tables[key]) != len(position):
                    fact = f"there are {len(tables[key])} of {len(position)}"
                    raise accessors.error(f"{key} of {what}", "be there for each vertex", fact)
        uv = tables.get(name)
        if uv is not None:
            with np.errstate(invalid="ignore", over="ignore"):
                uv = uv @ transform[:2, :2].T + transform[:2, 2]
            uv = uv * (1, -1) + (0, 1)  # glTF's v runs down
        part = of_vertices(position, faces, tables.get("NORMAL"), uv, materials)
        return Triangles(**{**vars(part), "unit": "m"})

    def _check_packed(self, item: dict[str, Any], attributes: dict[str, Any], what: str) -> None:
        """Raise DataError for a primitive whose numbers are in Draco's own form alone."""
        extensions = item.get("extensions")
        if isinstance(extensions, dict) and DRACO in extensions:
            position = self._accessors.item("accessors", attributes["POSITION"])
            if "bufferView" not in position and "sparse" not in position:
                raise packed_error(self._accessors.where, DRACO, f"{what} has no other numbers")

    def _material(self, item: dict[str, Any], what: str) -> tuple[str, np.ndarray, tuple[str, ...]]:
        """Return which texture coordinates a primitive's material takes, how it moves them [3, 3], and its name."""
        if "material" not in item:
            return "TEXCOORD_0", np.eye(3), ()
        number = item["material"]
        material = self._accessors.item("materials", number)
        name = material.get("name")
        names = (name if isinstance(name, str) and name else f"material {number}",)
        layers = material.get("pbrMetallicRoughness")
        textures = {**(layers if isinstance(layers, dict) else {}), **material}
        texture: dict[str, Any] = next((textures[key] for key in _TEXTURES if isinstance(textures.get(key), dict)), {})
        extensions = texture.get("extensions")
        change = extensions.get(TRANSFORM) if isinstance(extensions, dict) else None
        where = f"the texture of material {number}"
        if not isinstance(change, dict):
            return f"TEXCOORD_{self._accessors.whole(texture, 'texCoord', 0, where)}", np.eye(3), names
        set_number = self._accessors.whole({**texture, **change}, "texCoord", 0, where)
        (x, y), (u, v) = self._vector(change, "offset", 2, where, (0, 0)), self._vector(change, "scale", 2, where, (1, 1))
        angle = self._vector({"rotation": [change.get("rotation", 0)]}, "rotation", 1, where)[0]
        cosine, sine = math.cos(angle), math.sin(angle)
        matrix = np.array([[cosine * u, sine * v, x], [-sine * u, cosine * v, y], [0, 0, 1]])
        return f"TEXCOORD_{set_number}", matrix, names


def _faces(corners: np.ndarray, mode: int) -> np.ndarray:
    """Return the triangles [F, 3] of a list (4), a strip (5) or a fan (6)."""
    if mode == 4:
        return corners[:len(corners) // 3 * 3].reshape(-1, 3)
    if len(corners) < 3:
        return np.zeros((0, 3), dtype=np.int64)
    if mode == 6:
        return np.stack((np.broadcast_to(corners[0], len(corners) - 2), corners[1:-1], corners[2:]), axis=1)
    faces = np.stack((corners[:-2], corners[1:-1], corners[2:]), axis=1)
    faces[1::2] = faces[1::2][:, [1, 0, 2]]
    return faces
