"""The tree of a glTF 2.0 or GLB file, and what it must not need: extensions that are unknown here."""

from __future__ import annotations

import json
import struct
from typing import Any

from torchmat.errors import DataError, message
from torchmat.rendering.mesh_accessors import DRACO, MESHOPT, packed_error
from torchmat.rendering.triangles import CHECK_FILE, short_file

TRANSFORM = "KHR_texture_transform"
_JSON_CHUNK, _BINARY_CHUNK = 0x4E4F534A, 0x004E4942
# Extensions that leave triangles as they are, beside those of materials (KHR_materials_...).
_HARMLESS = frozenset({
    "KHR_mesh_quantization", TRANSFORM, "KHR_lights_punctual", "KHR_texture_basisu", "EXT_texture_webp",
    "EXT_texture_avif", "MSFT_texture_dds", "KHR_xmp_json_ld", "KHR_xmp", "EXT_lights_image_based", "EXT_lights_ies",
    "KHR_animation_pointer",
})


def tree_of(data: bytes, where: str, binary: bool) -> tuple[dict[str, Any], bytes | None]:
    """Return the tree of a file's bytes and, of a GLB (`binary`), its own buffer.

    Raises DataError for what is cut short or no glTF 2.0, for compressed geometry, and for unknown extensions that the
    file requires, by their names.
    """
    tree, chunk = _of_glb(data, where) if binary else (_tree(data, where), None)
    _check_version(tree, where)
    _check_required(tree, where)
    return tree, chunk


def _tree(text: bytes, where: str) -> dict[str, Any]:
    try:
        tree = json.loads(text)
    except (ValueError, RecursionError) as error:
        fact = f"{type(error).__name__}: {error}"
        raise DataError(message(where, "the mesh file", "hold glTF's JSON", fact, CHECK_FILE)) from error
    if not isinstance(tree, dict):
        raise DataError(message(where, "the mesh file", "hold glTF's JSON", f"it holds a {type(tree).__name__}", CHECK_FILE))
    return tree


def _of_glb(data: bytes, where: str) -> tuple[dict[str, Any], bytes | None]:
    """Return a GLB's tree and its buffer."""
    if data[:4] != b"glTF" or len(data) < 20:
        raise DataError(message(where, "the mesh file", "start as a GLB does", "it does not", CHECK_FILE))
    version, length = struct.unpack_from("<II", data, 4)
    if len(data) < length:
        raise short_file(where, f"{len(data)} of the {length} bytes")
    if version != 2:
        fact = f"it is of version {version}"
        raise DataError(message(where, "the mesh file", "be glTF 2.0", fact, "Export it as glTF 2.0."))
    chunks: list[tuple[int, int, int]] = []
    place = 12
    while place + 8 <= length and len(chunks) < 2:
        size, kind = struct.unpack_from("<II", data, place)
        if place + 8 + size > length:
            fact = f"the one at byte {place} is longer"
            raise DataError(message(where, "chunks of a GLB", "lie inside of it", fact, CHECK_FILE))
        chunks.append((kind, place + 8, size))
        place += 8 + size
    if not chunks or chunks[0][0] != _JSON_CHUNK:
        raise DataError(message(where, "the first chunk of a GLB", "be JSON", "it is not", CHECK_FILE))
    tree = _tree(data[chunks[0][1]:chunks[0][1] + chunks[0][2]], where)
    if len(chunks) < 2 or chunks[1][0] != _BINARY_CHUNK:
        return tree, None
    return tree, data[chunks[1][1]:chunks[1][1] + chunks[1][2]]


def _check_version(tree: dict[str, Any], where: str) -> None:
    asset = tree.get("asset")
    version = asset.get("version") if isinstance(asset, dict) else None
    if not isinstance(version, str) or version.split(".")[0] != "2":
        fact = f"its asset's version is {version!r:.60}"
        raise DataError(message(where, "the mesh file", "be glTF 2.0", fact, "Export it as glTF 2.0."))


def _check_required(tree: dict[str, Any], where: str) -> None:
    required = tree.get("extensionsRequired", [])
    names = [str(name) for name in required] if isinstance(required, list) else [str(required)]
    for name in names:
        if name in (DRACO, *MESHOPT):
            raise packed_error(where, name, "it needs that to be read")
    unknown = sorted({name for name in names if name not in _HARMLESS and not name.startswith("KHR_materials_")})
    if unknown:
        step = "Export it without, or remove the extension with gltf-transform."
        fact = f"it requires {', '.join(unknown)}"
        raise DataError(message(where, "the mesh file", "need no unknown extension", fact, step))
