"""glTF as its specification has it: normalised integers, sparse accessors, strips, extensions, and scenes."""

from __future__ import annotations

import json
import struct

import numpy as np
import pytest
from tests.rendering.mesh_files import SQUARE, SQUARE_UV, TWO, Gltf, corners, glb_of
from tests.rendering.test_mesh_bad_files import assert_refused

from torchmat.rendering.mesh import load_mesh
from torchmat.rendering.mesh_file import read_triangles

FLIPPED = SQUARE_UV * (1, -1) + (0, 1)  # glTF's v runs down


def square(gltf: Gltf) -> tuple[dict, int]:
    return {"POSITION": gltf.accessor(SQUARE, "f4")}, gltf.accessor(TWO.reshape(-1), "u2")


@pytest.mark.parametrize(("code", "most"), [("u1", 255), ("u2", 65535)])
@pytest.mark.parametrize("layout", [{}, {"stride": 8}, {"stride": 12, "before": 4}])
def test_normalised_texture_coordinates_are_0_to_1(code, most, layout, tmp_path):
    gltf = Gltf()
    attributes, indices = square(gltf)
    attributes["TEXCOORD_0"] = gltf.accessor(np.round(FLIPPED * most), code, normalized=True, **layout)
    mesh = load_mesh(gltf.put(tmp_path, attributes, indices))
    assert mesh.mapping == "file" and mesh.handedness.tolist() == [1] * 4
    assert np.abs(corners(mesh, "uv") - SQUARE_UV[TWO]).max() <= 0.5 / most + 1e-7


def test_integers_that_are_not_normalised_stay_as_they_are(tmp_path):
    gltf = Gltf(extensionsRequired=["KHR_mesh_quantization"], extensionsUsed=["KHR_mesh_quantization"])
    attributes = {"POSITION": gltf.accessor(SQUARE * 100 - 50, "i1", stride=4)}
    attributes["TEXCOORD_0"] = gltf.accessor([[0, 0], [2, 0], [2, 3], [0, 3]], "u2")
    mesh = load_mesh(gltf.put(tmp_path, attributes, gltf.accessor(TWO.reshape(-1), "u1")))
    assert mesh.bounds.tolist() == [[-50] * 3, [50] * 3]
    assert sorted(map(tuple, mesh.uv.tolist())) == [(0, -2), (0, 1), (2, -2), (2, 1)]


@pytest.mark.parametrize(("code", "most"), [("i1", 127), ("i2", 32767)])
def test_quantised_positions_and_normals(code, most, tmp_path):
    gltf = Gltf(extensionsRequired=["KHR_mesh_quantization"])
    gltf.tree["nodes"] = [{"mesh": 0, "scale": [2, 2, 2], "translation": [10, 0, 0]}]
    position = np.round((SQUARE * 2 - 1) * most)
    position[0] = -most - 1  # stands for -1 as well
    normal = np.tile([-0.6, 0, 0.8], (4, 1))
    attributes = {
        "POSITION": gltf.accessor(position, code, stride=8, normalized=True),
        "NORMAL": gltf.accessor(np.round(normal * most), code, stride=8, normalized=True),
    }
    mesh = load_mesh(gltf.put(tmp_path, attributes, gltf.accessor(TWO.reshape(-1), "u2")))
    assert mesh.bounds.tolist() == [[8, -2, -2], [12, 2, 2]]
    assert np.abs(mesh.normal.numpy() - [-0.6, 0, 0.8]).max() < 1 / most


def test_a_sparse_accessor_replaces_some_rows(tmp_path):
    gltf = Gltf()
    sparse = {
        "count": 2, "indices": {"bufferView": gltf.view(np.array([1, 2], "<u2")), "componentType": 5123},
        "values": {"bufferView": gltf.view(np.array([[3, 0, 0], [3, 2, 0]], "<f4"))},
    }
    flat = SQUARE * (1, 1, 0)
    attributes = {"POSITION": gltf.accessor(flat * 2, "f4", sparse=sparse)}
    mesh = load_mesh(gltf.put(tmp_path, attributes, gltf.accessor(TWO.reshape(-1), "u2")))
    points = corners(mesh, "position")
    assert points[0].tolist() == [[0, 0, 0], [3, 0, 0], [3, 2, 0]]  # an area of 6 in all, not 4
    assert points[1].tolist() == [[0, 0, 0], [3, 2, 0], [0, 2, 0]]


def test_a_sparse_accessor_without_a_view_is_zero_elsewhere(tmp_path):
    gltf = Gltf()
    sparse = {
        "count": 3, "indices": {"bufferView": gltf.view(np.array([1, 2, 3], "u1")), "componentType": 5121},
        "values": {"bufferView": gltf.view(SQUARE[1:].astype("<f4"))},
    }
    gltf.tree["accessors"].append({"componentType": 5126, "count": 4, "type": "VEC3", "sparse": sparse})
    mesh = load_mesh(gltf.put(tmp_path, {"POSITION": 0}, gltf.accessor(TWO.reshape(-1), "u4")))
    assert np.array_equal(corners(mesh, "position"), SQUARE[TWO])
    sparse["indices"]["bufferView"] = gltf.view(np.array([1, 2, 4], "u1"))
    words = "indices of the sparse part of accessor 0 must be below 4; one is 4"
    assert_refused(gltf.put(tmp_path, {"POSITION": 0}, 1), words)


@pytest.mark.parametrize(("mode", "numbers"), [(4, [0, 1, 2, 0, 2, 3]), (5, [1, 2, 0, 3]), (6, [0, 1, 2, 3])])
@pytest.mark.parametrize("indexed", [True, False])
def test_lists_strips_and_fans_face_the_same_way(mode, numbers, indexed, tmp_path):
    gltf = Gltf()
    position = SQUARE if indexed else SQUARE[numbers]
    attributes = {"POSITION": gltf.accessor(position, "f4")}
    mesh = load_mesh(gltf.put(tmp_path, attributes, gltf.accessor(numbers, "u1") if indexed else None, mode=mode))
    assert len(mesh.faces) == 2
    assert np.allclose(mesh.normal, [-np.sqrt(0.5), 0, np.sqrt(0.5)])


def test_unknown_extensions_that_a_file_requires_are_named(tmp_path):
    gltf = Gltf(extensionsRequired=["KHR_materials_unlit", "EXT_feathers", "KHR_texture_transform", "ACME_fur"])
    assert_refused(gltf.put(tmp_path, *square(gltf)), "need no unknown extension; it requires ACME_fur, EXT_feathers")
    gltf.tree["extensionsRequired"] = ["KHR_materials_unlit", "KHR_texture_transform", "KHR_mesh_quantization"]
    gltf.tree["extensionsUsed"] = ["EXT_feathers"]
    assert len(load_mesh(gltf.put(tmp_path, *square(gltf))).faces) == 2


@pytest.mark.parametrize("where", ["used", "primitive", "required"])
def test_a_draco_file_says_what_it_is_and_what_to_do(where, tmp_path):
    name = "KHR_draco_mesh_compression"
    gltf = Gltf(extensionsUsed=[name], **({"extensionsRequired": [name]} if where == "required" else {}))
    gltf.tree["accessors"] = [
        {"componentType": 5126, "count": 4, "type": "VEC3"}, {"componentType": 5123, "count": 6, "type": "SCALAR"},
    ]
    more = {} if where == "used" else {"extensions": {name: {"bufferView": gltf.view(np.zeros(9, "u1")), "attributes": {}}}}
    path = gltf.put(tmp_path, {"POSITION": 0}, 1, **more)
    assert_refused(path, r"be uncompressed; it needs KHR_draco\w+ \(it is Draco-compressed\).*gltf-transform copy.*Blender")


def test_a_draco_file_with_plain_numbers_beside_is_read(tmp_path):
    name = "KHR_draco_mesh_compression"
    gltf = Gltf(extensionsUsed=[name])
    extensions = {name: {"bufferView": gltf.view(np.zeros(9, "u1")), "attributes": {}}}
    mesh = load_mesh(gltf.put(tmp_path, *square(gltf), extensions=extensions))
    assert np.array_equal(corners(mesh, "position"), SQUARE[TWO])


def test_a_meshopt_file_without_its_fallback_is_named(tmp_path):
    gltf = Gltf(extensionsUsed=["EXT_meshopt_compression"])
    attributes, indices = square(gltf)
    gltf.tree["bufferViews"][0] |= {"buffer": 1, "extensions": {"EXT_meshopt_compression": {"buffer": 0}}}
    path = gltf.put(tmp_path, attributes, indices)
    tree = json.loads(path.read_text())
    tree["buffers"].append({"byteLength": 48})
    path.write_text(json.dumps(tree))
    assert_refused(path, r"it needs EXT_meshopt_compression \(it is meshopt-compressed\)")


def test_instances_that_an_extension_holds_are_not_passed_over(tmp_path):
    gltf = Gltf(nodes=[{"mesh": 0, "extensions": {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": 0}}}}])
    assert_refused(gltf.put(tmp_path, *square(gltf)), "node 0 must show its mesh once; it uses EXT_mesh_gpu_instancing")


def test_a_material_moves_its_texture_coordinates(tmp_path):
    change = {"offset": [0, 1], "rotation": np.pi / 2, "scale": [0.5, 0.5], "texCoord": 1}
    texture = {"index": 0, "extensions": {"KHR_texture_transform": change}}
    gltf = Gltf(materials=[{"name": "wood", "pbrMetallicRoughness": {"baseColorTexture": texture}}])
    attributes, indices = square(gltf)
    attributes["TEXCOORD_0"] = gltf.accessor(FLIPPED + 7, "f4")
    attributes["TEXCOORD_1"] = gltf.accessor([[0, 0], [1, 0], [1, 1], [0, 1]], "f4")
    path = gltf.put(tmp_path, attributes, indices, material=0)
    # the extension's own example: the lower left quarter of the picture, turned by 90 degrees
    expected = {(0, 0, 0): (0, 0), (1, 0, 1): (0, 0.5), (1, 1, 1): (0.5, 0.5), (0, 1, 0): (0.5, 0)}
    mesh = load_mesh(path)
    for position, uv in zip(mesh.position.tolist(), mesh.uv.tolist(), strict=True):
        assert uv == pytest.approx(expected[tuple(position)], abs=1e-6)
    assert read_triangles(path).materials == ("wood",) and mesh.unit == "m"


def test_the_scene_that_the_file_begins_with_counts(tmp_path):
    parts = [{"position": SQUARE + (k, 0, 0), "faces": TWO} for k in (0, 10, 20)]
    nodes = [{"mesh": 0}, {"children": [2]}, {"mesh": 1, "translation": [0, 5, 0]}, {"mesh": 2}]
    for scene, low in ((0, [0, 0, 0]), (1, [10, 5, 0])):
        path = tmp_path / "scenes.glb"
        path.write_bytes(glb_of(parts, nodes, scene=scene, scenes=[{"nodes": [0]}, {"nodes": [1]}]))
        assert load_mesh(path).bounds[0].tolist() == low
    path.write_bytes(glb_of(parts, nodes, scenes=[], scene=0))
    assert load_mesh(path).bounds.tolist() == [[0, 0, 0], [21, 6, 1]]  # all roots, and what hangs from them
    path.write_bytes(glb_of(parts, [{"mesh": 0, "children": [1]}, {"children": [0]}], scenes=[{"nodes": [0]}]))
    assert_refused(path, "nodes must hang from a root")
    path.write_bytes(glb_of(parts, [{"children": [1, 2]}, {"children": [2]}, {"mesh": 0}], scenes=[{"nodes": [0]}]))
    assert_refused(path, "node 2 must have one parent")
    listed = [{"mesh": 0, "children": [1], "translation": [0, 0, 7]}, {"mesh": 0}]
    path.write_bytes(glb_of(parts[:1], listed, scenes=[{"nodes": [1, 0]}]))
    assert load_mesh(path).bounds[:, 2].tolist() == [7, 8]


@pytest.mark.parametrize("uri", ["../a.bin", "/etc/hostname", "https://example.org/a.bin", "..%2fa.bin"])
def test_buffers_outside_of_the_folder_are_refused(uri, tmp_path):
    gltf = Gltf()
    path = gltf.put(tmp_path, *square(gltf))
    tree = json.loads(path.read_text())
    tree["buffers"][0]["uri"] = uri
    path.write_text(json.dumps(tree))
    assert_refused(path, "the file of buffer 0 must lie beside the .gltf")


def test_a_buffer_with_a_blank_in_its_name(tmp_path):
    gltf = Gltf()
    path = gltf.put(tmp_path, *square(gltf))
    tree = json.loads(path.read_text())
    (tmp_path / "my numbers.bin").write_bytes(gltf.body)
    tree["buffers"][0]["uri"] = "my%20numbers.bin"
    path.write_text(json.dumps(tree))
    assert np.array_equal(corners(load_mesh(path), "position"), SQUARE[TWO])


def _change(key: str, number: int, **more):
    def change(tree: dict) -> None:
        tree[key][number] |= more

    return change


@pytest.mark.parametrize(("change", "words"), [
    (_change("accessors", 0, count=5), "accessor 0 must lie inside of bufferView 0; it ends at byte 60 of 48"),
    (_change("accessors", 0, byteOffset=-4), "byteOffset of accessor 0 must be a whole number from 0"),
    (_change("accessors", 0, componentType=5124), "componentType of accessor 0 must be one of"),
    (_change("accessors", 0, type="VEC4"), "the type of accessor 0 must be VEC3"),
    (_change("accessors", 0, bufferView=9), "number 9 of its bufferViews must be there; there are 2"),
    (_change("bufferViews", 0, byteStride=4), "byteStride of bufferView 0 must hold the 12 bytes"),
    (_change("bufferViews", 0, byteLength=400, byteOffset=40), "inside of its buffer; it ends at byte 88 of 60"),
    (_change("nodes", 0, rotation=[0, 0, 0, 0]), "rotation of node 0 must be a unit quaternion"),
    (_change("nodes", 0, scale=[1, 1]), "scale of node 0 must be 3 numbers"),
    (lambda tree: tree.update(asset={"version": "1.0"}), "be glTF 2.0"),
])
def test_numbers_that_cannot_be_are_named(change, words, tmp_path):
    gltf = Gltf()
    path = gltf.put(tmp_path, *square(gltf))
    tree = json.loads(path.read_text())
    change(tree)
    path.write_text(json.dumps(tree))
    assert_refused(path, words)


def test_a_glb_whose_chunk_is_longer_than_the_file_is_refused(tmp_path):
    data = bytearray(glb_of([{"position": SQUARE, "faces": TWO}], [{"mesh": 0}]))
    struct.pack_into("<I", data, 12, len(data))
    (tmp_path / "a.glb").write_bytes(data)
    assert_refused(tmp_path / "a.glb", "chunks of a GLB must lie inside of it")
