"""Shapes that need no file: quad, cube, sphere, torus and teapot, centred on the origin, y up."""

from __future__ import annotations

import inspect
from collections.abc import Callable

import numpy as np

from torchmat.errors import RangeError, check_known_keys, check_option, message
from torchmat.rendering import teapot
from torchmat.rendering.mesh import Mesh, of_arrays

_MOST_SEGMENTS = 2048


def grid_faces(rows: int, columns: int, closed_top: bool = False, closed_bottom: bool = False) -> np.ndarray:
    """Return the triangles [F, 3] of a grid of rows x columns cells, vertex ``row * (columns + 1) + column``.

    Row 0 is at v = 0, column 0 at u = 0, and triangles run counter-clockwise with u to the right and v up.
    `closed_bottom` and `closed_top` leave out the triangle of each cell that has no area where row 0 or the last row
    is a single point.
    """
    row, column = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    first = row * (columns + 1) + column
    lower = np.stack((first, first + 1, first + columns + 2), axis=-1)
    upper = np.stack((first, first + columns + 2, first + columns + 1), axis=-1)
    lower, upper = lower[1 if closed_bottom else 0:], upper[: rows - 1 if closed_top else rows]
    return np.concatenate((lower.reshape(-1, 3), upper.reshape(-1, 3)))


def _quad() -> Mesh:
    """The unit square in the plane z = 0, facing +z; one texture covers it."""
    uv = np.array([[0, 0], [1, 0], [0, 1], [1, 1]], dtype=np.float64)
    flat = np.zeros((4, 1))
    ones = np.ones(4)
    return of_arrays(
        np.hstack((uv - 0.5, flat)), grid_faces(1, 1), np.tile([0.0, 0, 1], (4, 1)), uv, np.tile([1.0, 0, 0], (4, 1)),
        ones, "quad", "shape",
    )


def _cube() -> Mesh:
    """The cube of edge 1; one texture covers each side, upright on the four walls, as if looked at from outside."""
    # tangent and bitangent of +z, +x, -z, -x, +y, -y
    tangent = np.array([[1, 0, 0], [0, 0, -1], [-1, 0, 0], [0, 0, 1], [1, 0, 0], [1, 0, 0]], dtype=np.float64)
    bitangent = np.array([[0, 1, 0]] * 4 + [[0, 0, -1], [0, 0, 1]], dtype=np.float64)
    normal = np.cross(tangent, bitangent)
    uv = np.array([[0, 0], [1, 0], [0, 1], [1, 1]], dtype=np.float64)
    offset = uv - 0.5
    position = normal[:, None] / 2 + tangent[:, None] * offset[:, :1] + bitangent[:, None] * offset[:, 1:]
    faces = (grid_faces(1, 1)[None] + 4 * np.arange(6)[:, None, None]).reshape(-1, 3)
    normal, tangent = np.repeat(normal, 4, axis=0), np.repeat(tangent, 4, axis=0)
    return of_arrays(position.reshape(-1, 3), faces, normal, np.tile(uv, (6, 1)), tangent, np.ones(24), "cube", "shape")


def _whole_turn(angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return cosine and sine, with the last equal to the first to the bit: the seam of a whole turn has no crack."""
    cosine, sine = np.cos(angle), np.sin(angle)
    cosine[-1], sine[-1] = cosine[0], sine[0]
    return cosine, sine


def _of_grid(
    position: np.ndarray, normal: np.ndarray, uv: np.ndarray, tangent: np.ndarray, faces: np.ndarray, name: str
) -> Mesh:
    """Return a Mesh of vertices in any number of dimensions before the last; those that no face uses are left out."""
    used, corners = np.unique(faces, return_inverse=True)
    parts = [part.reshape(-1, part.shape[-1])[used] for part in (position, normal, uv, tangent)]
    return of_arrays(
        parts[0], corners.reshape(-1, 3), parts[1], parts[2], parts[3], np.ones(len(used)), name, "shape"
    )


def _sphere(segments: int = 256) -> Mesh:
    """The unit sphere; u runs 0..4 round the equator from +z toward +x, v 0..2 from the south pole to the north pole.

    So one texture fits a quarter of the equator and is not stretched there. `segments`, an even number, go round the
    equator, half as many from pole to pole. With 256 the picture's normals, seen from afar, are within 0.02 degrees of
    the exact ones up to 65 degrees from the centre.
    """
    if _checked("segments", segments, 4) % 2:
        raise RangeError(message("make_mesh", "segments", "be even for the sphere", f"it is {segments}"))
    rows = segments // 2
    turn, rise = np.arange(segments + 1) / segments, np.arange(rows + 1) / rows
    latitude = (rise - 0.5) * np.pi
    height, ring = np.sin(latitude), np.cos(latitude)
    ring[[0, -1]] = 0
    u, v = np.meshgrid(4 * turn, 2 * rise)
    cosine, sine = _whole_turn(2 * np.pi * turn)
    position = np.stack((np.outer(ring, sine), np.outer(height, np.ones_like(turn)), np.outer(ring, cosine)), axis=-1)
    # The one triangle of each column that meets a pole has a corner of its own there, in the middle of the column, so
    # that tangents lie evenly about the pole.
    u[0] += 2 / segments
    u[-1] -= 2 / segments
    tangent = np.stack((np.cos(u * np.pi / 2), np.zeros_like(u), -np.sin(u * np.pi / 2)), axis=-1)
    faces = grid_faces(rows, segments, closed_bottom=True, closed_top=True)
    return _of_grid(position, position, np.stack((u, v), axis=-1), tangent, faces, "sphere")


def _torus(segments: int = 240) -> Mesh:
    """The torus about the y axis, radii 3/4 and 1/4; u runs 0..3 along it from +z toward +x, v 0..1 round the tube.

    v rises on the outside; its ends meet on the inside. A texture is as high as the sphere's and not stretched at the
    tube's top and bottom. `segments` go along it, a third as many round the tube.
    """
    rows = _checked("segments", segments, 9) // 3
    turn, rise = np.arange(segments + 1) / segments, np.arange(rows + 1) / rows
    cosine, sine = _whole_turn(2 * np.pi * turn)
    out, up = _whole_turn(2 * np.pi * (rise - 0.5))
    up[[0, -1]] = 0
    flat = np.ones_like(turn)
    normal = np.stack((np.outer(out, sine), np.outer(up, flat), np.outer(out, cosine)), axis=-1)
    ring = 0.75 + 0.25 * out
    position = np.stack((np.outer(ring, sine), np.outer(0.25 * up, flat), np.outer(ring, cosine)), axis=-1)
    tangent = np.broadcast_to(np.stack((cosine, np.zeros_like(turn), -sine), axis=-1), position.shape)
    uv = np.stack(np.meshgrid(3 * turn, rise), axis=-1)
    return _of_grid(position, normal, uv, tangent, grid_faces(rows, segments), "torus")


def _teapot(segments: int = 32) -> Mesh:
    """Newell's teapot, 2 wide, spout toward +x, on the plane y = -0.4896; one texture covers each of its 32 patches.

    `segments` is the number of steps along each side of a patch.
    """
    patches = teapot.patches(_checked("segments", segments, 1))
    open_ended = grid_faces(segments, segments)
    closed = grid_faces(segments, segments, closed_top=True)
    offsets = (segments + 1) ** 2 * np.arange(teapot.PATCHES)
    faces = np.concatenate([
        (closed if number in teapot.WITH_POLE else open_ended) + offset for number, offset in enumerate(offsets)
    ])
    return _of_grid(*patches, faces, "teapot")


def _checked(name: str, value: int, least: int) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or not least <= value <= _MOST_SEGMENTS:
        raise RangeError(
            message("make_mesh", name, f"be a whole number from {least} to {_MOST_SEGMENTS}", f"it is {value!r}")
        )
    return value


_BUILDERS: dict[str, Callable[..., Mesh]] = {
    "quad": _quad, "cube": _cube, "sphere": _sphere, "torus": _torus, "teapot": _teapot,
}
SHAPES = tuple(_BUILDERS)


def make_mesh(name: str, **options: int) -> Mesh:
    """Return one of SHAPES: "quad", "cube", "sphere", "torus" or "teapot", with exact normals and tangents.

    All are centred on the origin. The only option, of the round ones, is `segments`: how finely they are cut into
    triangles (sphere and torus: round the whole; teapot: along a patch). Raises RangeError for an unknown name, option
    or number.
    """
    check_option("make_mesh", "name", name, SHAPES)
    builder = _BUILDERS[name]
    check_known_keys(f"make_mesh({name!r})", options, inspect.signature(builder).parameters)
    return builder(**options)
