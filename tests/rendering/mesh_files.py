"""Mesh files as the formats' descriptions have them, written by hand, and what meshes are held to."""

from __future__ import annotations

import base64
import json
import struct
from pathlib import Path

import numpy as np

from torchmat.rendering.mesh import Mesh

# A tilted square of two triangles, counter-clockwise seen from +z, in the plane z = x.
SQUARE = np.array([[0, 0, 0], [1, 0, 1], [1, 1, 1], [0, 1, 0]], dtype=np.float64)
SQUARE_UV = np.array([[0, 0], [0.5, 0], [0.5, 0.25], [0, 0.25]])
TWO = np.array([[0, 1, 2], [0, 2, 3]])
CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=np.float64)
CUBE_FACES = np.array([
    [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
    [1, 5, 7], [1, 7, 3],
])


def bumpy(rows: int = 6, columns: int = 7, amplitude: float = 0.6, seed: int = 0):
    """A height field with some edges above and some below the crease; uv sheared, and mirrored on its right half."""
    random = np.random.default_rng(seed)
    row, column = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    position = np.stack((column, row, amplitude * random.uniform(-1, 1, row.shape)), axis=-1).reshape(-1, 3)
    first = (row * columns + column)[:-1, :-1].reshape(-1)
    faces = np.concatenate((
        np.stack((first, first + 1, first + columns + 1), axis=1),
        np.stack((first, first + columns + 1, first + columns), axis=1),
    ))
    u = np.abs(column - 3) + 0.3 * row + 0.1 * random.uniform(-1, 1, row.shape)
    uv = np.stack((u, row + 0.1 * random.uniform(-1, 1, row.shape)), axis=-1).reshape(-1, 2)
    return position.astype(np.float32).astype(np.float64), faces, uv.astype(np.float32).astype(np.float64)


def put_obj(path: Path, position, faces, uv=None, normal=None, before: str = "") -> Path:
    """Write an OBJ; faces name position, uv and normal by one number."""
    lines = [before] + ["v " + " ".join(repr(float(k)) for k in row) for row in position]
    lines += ["vt " + " ".join(repr(float(k)) for k in row) for row in (() if uv is None else uv)]
    lines += ["vn " + " ".join(repr(float(k)) for k in row) for row in (() if normal is None else normal)]
    for face in faces:
        words = []
        for vertex in np.asarray(face) + 1:
            middle = "" if uv is None else vertex
            words.append(f"{vertex}/{middle}/{vertex}" if normal is not None else f"{vertex}/{middle}".rstrip("/"))
        lines.append("f " + " ".join(words))
    path.write_text("\n".join(lines) + "\n")
    return path


def put_ply(path: Path, position, faces, uv=None, normal=None, binary: bool = False) -> Path:
    """Write a PLY with float32 vertices and int32 faces."""
    columns, names = [position], ["x", "y", "z"]
    if normal is not None:
        columns, names = [*columns, normal], [*names, "nx", "ny", "nz"]
    if uv is not None:
        columns, names = [*columns, uv], [*names, "s", "t"]
    rows = np.hstack(columns).astype("<f4")
    head = [
        "ply", f"format {'binary_little_endian' if binary else 'ascii'} 1.0", f"element vertex {len(rows)}",
        *[f"property float {name}" for name in names], f"element face {len(faces)}",
        "property list uchar int vertex_indices", "end_header",
    ]
    data = ("\n".join(head) + "\n").encode()
    if binary:
        data += rows.tobytes() + b"".join(struct.pack("<B3i", 3, *face) for face in faces)
    else:
        data += "".join(" ".join(repr(float(k)) for k in row) + "\n" for row in rows).encode()
        data += "".join("3 " + " ".join(map(str, face)) + "\n" for face in faces).encode()
    path.write_bytes(data)
    return path


def put_stl(path: Path, position, faces) -> Path:
    """Write a binary STL; its normals are left 0, as the format allows."""
    data = b"written by a test".ljust(80) + struct.pack("<I", len(faces))
    for face in faces:
        data += struct.pack("<12fH", 0, 0, 0, *np.asarray(position)[face].reshape(-1), 0)
    path.write_bytes(data)
    return path


def glb_of(parts: list[dict], nodes: list[dict], **more) -> bytes:
    """Return a GLB of meshes {position, faces, uv (v down), normal, material, mode} and nodes."""
    views, accessors, meshes, body = [], [], [], b""

    def accessor(values: np.ndarray, component: int, kind: str) -> int:
        nonlocal body
        raw = values.astype({5126: "<f4", 5125: "<u4"}[component]).tobytes()
        views.append({"buffer": 0, "byteOffset": len(body), "byteLength": len(raw)})
        accessors.append({
            "bufferView": len(views) - 1, "componentType": component, "count": len(values), "type": kind,
            **({"min": values.min(0).tolist(), "max": values.max(0).tolist()} if kind == "VEC3" else {}),
        })
        body += raw
        return len(accessors) - 1

    for part in parts:
        attributes = {"POSITION": accessor(np.asarray(part["position"]), 5126, "VEC3")}
        if "normal" in part:
            attributes["NORMAL"] = accessor(np.asarray(part["normal"]), 5126, "VEC3")
        if "uv" in part:
            attributes["TEXCOORD_0"] = accessor(np.asarray(part["uv"]), 5126, "VEC2")
        primitive = {"attributes": attributes, "mode": part.get("mode", 4)}
        if "faces" in part:
            primitive["indices"] = accessor(np.asarray(part["faces"]).reshape(-1), 5125, "SCALAR")
        if "material" in part:
            primitive["material"] = part["material"]
        meshes.append({"primitives": [primitive]})
    tree = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": list(range(len(nodes)))}], "nodes": nodes,
        "meshes": meshes, "accessors": accessors, "bufferViews": views, "buffers": [{"byteLength": len(body)}], **more,
    }
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    body += b"\0" * (-len(body) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(body), 0x004E4942) + body
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


_COMPONENTS = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
_KINDS = {1: "SCALAR", 2: "VEC2", 3: "VEC3"}


class Gltf:
    """A glTF put together by hand, its numbers in the text."""

    def __init__(self, **tree) -> None:
        self.body, self.tree = b"", {"asset": {"version": "2.0"}, "accessors": [], "bufferViews": [], **tree}

    def view(self, values, stride: int = 0, before: int = 0) -> int:
        rows = [np.asarray(row).tobytes() for row in values]
        size = len(rows[0])
        raw = b"\7" * before + b"".join(row.ljust(max(stride, size), b"\7") for row in rows)
        self.tree["bufferViews"].append({"buffer": 0, "byteOffset": len(self.body), "byteLength": len(raw)})
        self.tree["bufferViews"][-1] |= {"byteStride": stride} if stride else {}
        self.body += raw + b"\0" * (-len(raw) % 4)
        return len(self.tree["bufferViews"]) - 1

    def accessor(self, values, code: str, stride: int = 0, before: int = 0, **more) -> int:
        values = np.asarray(values).astype(f"<{code}")
        values = values[:, None] if values.ndim == 1 else values
        item = {"componentType": _COMPONENTS[code], "count": len(values), "type": _KINDS[values.shape[1]]}
        item |= {"bufferView": self.view(values, stride, before)} | ({"byteOffset": before} if before else {}) | more
        self.tree["accessors"].append(item)
        return len(self.tree["accessors"]) - 1

    def put(self, folder, attributes: dict, indices: int | None = None, **primitive):
        primitive = {"attributes": attributes} | ({} if indices is None else {"indices": indices}) | primitive
        tree = {"meshes": [{"primitives": [primitive]}], "nodes": [{"mesh": 0}], "scenes": [{"nodes": [0]}], **self.tree}
        uri = "data:application/octet-stream;base64," + base64.b64encode(self.body).decode()
        tree["buffers"] = [{"byteLength": len(self.body), "uri": uri}]
        path = folder / "a.gltf"
        path.write_text(json.dumps(tree))
        return path


def corners(mesh: Mesh, values: str) -> np.ndarray:
    """Return a quantity of the vertices at the corners of triangles, [F, 3, n] float64."""
    return getattr(mesh, values).double().numpy()[mesh.faces.numpy()]


def assert_frames_hold(mesh: Mesh) -> None:
    """Assert that all is finite, in its type and shape, and that normal and tangent are perpendicular unit vectors."""
    count = len(mesh.position)
    shapes = {name: (count, 3) for name in ("position", "normal", "tangent")}
    shapes |= {"uv": (count, 2), "handedness": (count,)}
    for name, shape in shapes.items():
        values = getattr(mesh, name)
        assert tuple(values.shape) == shape and str(values.dtype) == "torch.float32", name
        assert np.isfinite(values.numpy()).all(), name
    assert str(mesh.faces.dtype) == "torch.int64"
    assert set(np.unique(mesh.faces.numpy())) == set(range(count)), "some vertex belongs to no triangle"
    normal, tangent = mesh.normal.double(), mesh.tangent.double()
    assert float((normal.norm(dim=1) - 1).abs().max()) < 2e-7
    assert float((tangent.norm(dim=1) - 1).abs().max()) < 2e-7
    assert float((normal * tangent).sum(dim=1).abs().max()) < 2e-7
    assert set(mesh.handedness.tolist()) <= {1.0, -1.0}


def edge_counts(mesh: Mesh) -> dict[tuple[bytes, bytes], int]:
    """Return how often each edge is gone along from its first to its second position, positions told apart by bits."""
    where = [row.tobytes() for row in (mesh.position.numpy() + 0.0)]
    counts: dict[tuple[bytes, bytes], int] = {}
    for face in mesh.faces.tolist():
        for start, end in zip(face, face[1:] + face[:1], strict=True):
            edge = (where[start], where[end])
            counts[edge] = counts.get(edge, 0) + 1
    return counts


def open_edges(mesh: Mesh) -> list[tuple[bytes, bytes]]:
    """Return the edges that only one triangle has; assert that no other is gone along twice one way."""
    counts = edge_counts(mesh)
    assert max(counts.values()) == 1, "two triangles go the same way along an edge"
    return [edge for edge in counts if edge[::-1] not in counts]
