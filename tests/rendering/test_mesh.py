"""What is taken as a mesh, and real meshes where this machine has them."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from tests.reference import mesh as oracle
from tests.rendering.mesh_files import CUBE, CUBE_FACES, SQUARE, SQUARE_UV, TWO, assert_frames_hold, corners, open_edges
from tests.models.examples import make
from tests.rendering.mesh_files import put_obj, put_ply
from tests.support import shared_path

from torchmat.errors import DataError, RangeError
from torchmat.rendering import Camera, Directional, Point, render, vertices
from torchmat.rendering.as_mesh import as_mesh
from torchmat.rendering.mesh import Mesh, load_mesh
from torchmat.rendering.shapes import make_mesh


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


FAR = np.array([4_500_000.0, -320_000.0, 7_000_000.0])


def _ball(folder, name: str, offset):
    ball = make_mesh("sphere", segments=48)
    return put_obj(folder / name, ball.position.double().numpy() + offset, ball.faces.numpy(), ball.uv.double().numpy())


def test_a_mesh_far_away_keeps_its_shape(tmp_path):
    near, far = load_mesh(_ball(tmp_path, "near.obj", 0)), load_mesh(_ball(tmp_path, "far.obj", FAR))
    assert near.origin == (0, 0, 0) and far.origin == pytest.approx(FAR, abs=1e-6)
    assert (far.dropped, len(far.faces), len(far.position)) == (0, len(near.faces), len(near.position))
    # what the file's text holds of them is right to 1e-9
    assert np.abs(corners(far, "position") - corners(near, "position")).max() < 1e-7
    assert np.abs(corners(far, "normal") - corners(near, "normal")).max() < 1e-5
    assert far.centre.tolist() == pytest.approx(FAR, abs=1e-6)
    assert np.abs(far.bounds.numpy() - FAR - near.bounds.numpy()).max() < 1e-6
    assert far.radius == pytest.approx(near.radius, abs=1e-6)


def test_a_picture_of_a_mesh_far_away_is_that_of_a_near_one(tmp_path):
    material = make("phong_srf", {"residual": "half", "base": "phong"}, 4, 6, dtype=torch.float32)
    pictures = []
    for name, offset in (("near.obj", np.zeros(3)), ("far.obj", FAR)):
        lamps = [Point(tuple(offset + (1.0, 2.0, 3.0))), Directional((-0.4, 0.5, 0.768))]
        camera = Camera(tuple(offset + (0.0, 1.0, 5.0)), tuple(offset))
        mesh = load_mesh(_ball(tmp_path, name, offset))
        pictures.append(render(material, mesh, lamps, camera=camera, size=24, shadows=True, rays=1))
        with pytest.raises(RangeError, match="the light must lie outside of the mesh"):
            render(material, mesh, [Point(tuple(offset + (0.1, 0.2, 0.3)))], camera=camera, size=4)
    assert float(pictures[0].max()) > 0.1
    assert float((pictures[0] - pictures[1]).abs().max()) < 1e-4 * float(pictures[0].max())


def test_a_mesh_near_the_origin_stays_where_it_is(tmp_path):
    mesh = load_mesh(_ball(tmp_path, "beside.obj", (20.0, 0, 0)))
    assert mesh.origin == (0, 0, 0) and mesh.bounds[:, 0].tolist() == [19, 21]


def test_triangles_that_vanish_in_the_files_own_rounding_are_an_error(tmp_path):
    ball = make_mesh("sphere", segments=48)
    path = put_ply(tmp_path / "far.ply", ball.position.double().numpy() + FAR, ball.faces.numpy(), binary=True)
    with pytest.raises(DataError, match=r"far\.ply: triangles must have area; \d+ of 2208 have none\..*to about 0\.5: move"):
        load_mesh(path)


@pytest.mark.parametrize(("lost", "refused"), [(2, False), (3, True)])
def test_triangles_may_vanish_up_to_a_third_but_for_those_that_name_a_vertex_twice(lost, refused, tmp_path):
    flat = [[k, k + 1, k + 2] for k in range(4, 4 + lost)]
    position = np.vstack((SQUARE, SQUARE[:1] + np.arange(1, 7)[:, None] * (1.0, 0.5, 0)))
    faces = [*TWO, *TWO[:, ::-1], [0, 0, 1], [1, 2, 2], [3, 3, 3], *flat]
    path = put_obj(tmp_path / "flat.obj", position, faces)
    if refused:
        with pytest.raises(DataError, match="3 of 7 have none. Check the mesh"):
            load_mesh(path)
    else:
        assert (load_mesh(path).dropped, len(load_mesh(path).faces)) == (5, 4)


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
