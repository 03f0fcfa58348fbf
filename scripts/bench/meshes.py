"""The benchmark suite of large meshes: reading a file, and one picture of it, by number of triangles and by format."""

from __future__ import annotations

import json
import struct
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from measure import in_fresh_process, median_of

_ASIDE = (1000, 500)  # cells along each side of a torus: two triangles each
_READ = """
import json, time
import numpy as np
import torch, trimesh
import torchmat as tm
from torchmat.machine import peak_memory_mb
from torchmat.rendering import Camera
from torchmat.rendering.mesh import load_mesh
from torchmat.rendering.visibility import see
held = peak_memory_mb()
clocks = time.perf_counter, time.process_time
start = [clock() for clock in clocks]
mesh = load_mesh({path!r})
read = [clock() for clock in clocks]
see(mesh, Camera.framing(mesh.centre, mesh.radius, (0.3, 0.25, 1.0)), 512, 1)
seen = [clock() for clock in clocks]
# What the normals of a torus are: away from the circle in the middle of its tube.
place = mesh.position.double()
ring = torch.nn.functional.normalize(place * torch.tensor([1.0, 0.0, 1.0]), dim=1)
exact = torch.nn.functional.normalize(place - 0.75 * ring, dim=1)
wrong = torch.rad2deg(torch.arccos((exact * mesh.normal).sum(dim=1).clamp(-1, 1)))
print(json.dumps(dict(
    read=read[0] - start[0], read_cpu=read[1] - start[1], picture=seen[0] - read[0], picture_cpu=seen[1] - read[1],
    memory_mb=peak_memory_mb() - held, triangles=len(mesh.faces), dropped=mesh.dropped, normal_deg=float(wrong.max()),
)))
"""


def _torus(cells: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return position, uv and faces of a closed torus of `cells` x `cells` quads, radii 3/4 and 1/4."""
    turn = np.arange(cells) / cells
    along, around = np.meshgrid(2 * np.pi * turn, 2 * np.pi * turn, indexing="ij")
    ring = 0.75 + 0.25 * np.cos(around)
    position = np.stack((ring * np.sin(along), 0.25 * np.sin(around), ring * np.cos(along)), axis=-1).reshape(-1, 3)
    uv = np.stack((along, around), axis=-1).reshape(-1, 2) / (2 * np.pi)
    here, after = np.arange(cells), (np.arange(cells) + 1) % cells
    sides = ((here, here), (after, here), (after, after), (here, after))
    a, b, c, d = (row[:, None] * cells + column for row, column in sides)
    quads = np.concatenate((np.stack((a, b, c), axis=-1).reshape(-1, 3), np.stack((a, c, d), axis=-1).reshape(-1, 3)))
    return position.astype("<f4"), uv.astype("<f4"), quads


def _put_glb(path: Path, position: np.ndarray, uv: np.ndarray, faces: np.ndarray) -> None:
    parts = [position.tobytes(), uv.tobytes(), faces.astype("<u4").tobytes()]
    starts = np.cumsum([0, *map(len, parts)]).tolist()
    kinds = ((5126, len(position), "VEC3"), (5126, len(uv), "VEC2"), (5125, faces.size, "SCALAR"))
    text = json.dumps({
        "asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "indices": 2}]}],
        "accessors": [{"bufferView": k, "componentType": c, "count": n, "type": t} for k, (c, n, t) in enumerate(kinds)],
        "bufferViews": [
            {"buffer": 0, "byteOffset": at, "byteLength": len(part)} for at, part in zip(starts[:-1], parts, strict=True)
        ],
        "buffers": [{"byteLength": starts[-1]}],
    }).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", starts[-1], 0x004E4942) + b"".join(parts)
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)


def _put_ply(path: Path, position: np.ndarray, uv: np.ndarray, faces: np.ndarray) -> None:
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(position)}\n"
    head += "".join(f"property float {name}\n" for name in "xyz")
    head += f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    rows = np.rec.fromarrays([np.full(len(faces), 3, "u1"), *faces.T.astype("<i4")])
    path.write_bytes(head.encode() + position.tobytes() + rows.tobytes())


def _put_obj(path: Path, position: np.ndarray, uv: np.ndarray, faces: np.ndarray) -> None:
    with path.open("w", encoding="ascii") as stream:
        np.savetxt(stream, position, "v %.7f %.7f %.7f")
        np.savetxt(stream, uv, "vt %.6f %.6f")
        np.savetxt(stream, np.repeat(faces + 1, 2, axis=1), "f %d/%d %d/%d %d/%d")


def meshes(repeats: int = 5) -> list[dict[str, Any]]:
    """A torus of 2,000,000 and one of 500,000 triangles: with texture coordinates, and without any (PLY)."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for cells in _ASIDE:
            shape = _torus(cells)
            for suffix, put in (("glb", _put_glb), ("obj", _put_obj), ("ply", _put_ply)):
                path = Path(folder) / f"torus.{suffix}"
                put(path, *shape)
                runs = in_fresh_process(_READ.format(path=str(path)), repeats)
                row: dict[str, Any] = {"format": suffix, "triangles": runs[0]["triangles"], "dropped": runs[0]["dropped"]}
                row |= {key: median_of(runs, key) for key in ("read", "read_cpu", "picture", "picture_cpu")}
                row |= {"memory_mb": max(run["memory_mb"] for run in runs), "normal_deg": runs[0]["normal_deg"]}
                rows.append(row)
                print(
                    f"{suffix} {row['triangles']:8d} triangles: read {row['read']['seconds']:.2f} s, processor "
                    f"{row['read_cpu']['seconds']:.2f} s; picture {row['picture']['seconds']:.2f} s, processor "
                    f"{row['picture_cpu']['seconds']:.2f} s; {row['memory_mb']:.0f} MB; {runs[0]['normal_deg']:.4f} degrees",
                    flush=True,
                )
    return rows
