"""What is taken as a mesh, and real meshes where this machine has them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from tests.reference import mesh as oracle
from tests.rendering.mesh_files import CUBE, CUBE_FACES, SQUARE, SQUARE_UV, TWO, assert_frames_hold, corners, open_edges
from tests.rendering.mesh_files import put_obj
from tests.support import shared_path

from torchmat.errors import DataError, RangeError
from torchmat.rendering import vertices
from torchmat.rendering.as_mesh import as_mesh
from torchmat.rendering.mesh import Mesh, load_mesh


def test_a_mesh_is_taken_by_name_by_path_and_as_it_is(tmp_path):
    path = put_obj(tmp_path / "a.obj", SQUARE, TWO, SQUARE_UV)
    cube = as_mesh("cube")
    assert cube.name == "cube" and as_mesh(cube) is cube
    assert as_mesh(path).name == as_mesh(str(path)).name == "a"


def test_trimeshs_mesh_is_taken_with_its_texture_coordinates_and_not_its_normals():
    import trimesh

    source = trimesh.Trimesh(CUBE, CUBE_FACES, process=False)
    assert len(source.vertex_normals) == 8  # trimesh keeps these averages over the edges
    mesh = as_mesh(source)
    assert (len(mesh.position), mesh.mapping, mesh.name) == (24, "box", "mesh")
    textured = trimesh.Trimesh(SQUARE, TWO, process=False, visual=trimesh.visual.TextureVisuals(uv=SQUARE_UV))
    assert as_mesh(textured).mapping == "file"


def test_what_is_no_mesh_is_an_error(tmp_path):
    with pytest.raises(RangeError, match="Did you mean 'sphere'"):
        as_mesh("spere")
    with pytest.raises(DataError, match=r"bunny\.obj: the mesh file must exist; there is none"):
        as_mesh("bunny.obj")
    with pytest.raises(RangeError, match="it is a int"):
        as_mesh(3)
    with pytest.raises(RangeError, match="uv must be one of 'auto', 'box'"):
        load_mesh(put_obj(tmp_path / "a.obj", SQUARE, TWO), uv="boxes")


def test_bounds_centre_and_radius():
    mesh = as_mesh("cube")
    assert mesh.bounds.tolist() == [[-0.5] * 3, [0.5] * 3]
    assert mesh.centre.tolist() == [0, 0, 0]
    assert mesh.radius == pytest.approx(math.sqrt(0.75))


def test_the_bunny_without_texture_coordinates():
    mesh = load_mesh(shared_path("meshes/bunny/stanford-bunny.obj"))
    assert (len(mesh.faces), mesh.mapping, mesh.dropped) == (69451, "box", 0)
    assert_frames_hold(mesh)
    points = corners(mesh, "position")
    flat = vertices.face_normals(points)
    # Angle-weighted means of neighbours stay on the triangles' own side, but for a few folds of the scan.
    assert ((flat[:, None] * corners(mesh, "normal")).sum(-1) <= 0).sum() < 20
    assert bool((mesh.handedness == 1).all())


@pytest.mark.parametrize("name", ["spot.obj", "spot_quadrangulated.obj"])
def test_spot_with_its_own_texture_coordinates(name):
    mesh: Mesh = load_mesh(shared_path(f"meshes/spot/{name}"))
    assert (len(mesh.faces), mesh.mapping, mesh.dropped) == (5856, "file", 0)
    assert_frames_hold(mesh)
    assert open_edges(mesh) == []
    points, uv = corners(mesh, "position"), corners(mesh, "uv")
    some = np.arange(0, 5856, 17)
    for number in some:
        along, up = oracle.face_frame(points[number], uv[number])
        side = np.sign(np.cross(along, up) @ oracle.face_normal(points[number]))
        assert set(mesh.handedness[mesh.faces[number]].tolist()) == {side}


def test_the_finished_teapot_without_texture_coordinates():
    mesh = load_mesh(shared_path("meshes/teapot/teapot.obj"))
    assert (len(mesh.faces) + mesh.dropped, mesh.mapping) == (6320, "box")
    assert_frames_hold(mesh)
