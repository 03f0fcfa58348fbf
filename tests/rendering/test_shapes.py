"""Shapes: closed, facing outward, with the tangent frame that finite differences over the texture give."""

from __future__ import annotations

import math
import sys

import numpy as np
import pytest
import torch
from tests.reference import mesh as oracle
from tests.rendering.mesh_files import assert_frames_hold, corners, open_edges

from torchmat.errors import RangeError
from torchmat.rendering.shapes import SHAPES, make_mesh

# Finely enough for the bounds below, coarsely enough for loops.
SMALL = {"quad": {}, "cube": {}, "sphere": {"segments": 48}, "torus": {"segments": 48}, "teapot": {"segments": 12}}


@pytest.mark.parametrize("name", SHAPES)
def test_frames_are_orthonormal_and_finite(name):
    mesh = make_mesh(name)
    assert_frames_hold(mesh)
    assert (mesh.name, mesh.mapping, mesh.dropped) == (name, "shape", 0)
    assert bool((mesh.handedness == 1).all())
    assert float(mesh.centre.abs().max()) < 5e-6  # the teapot's steps miss the end of its spout by as much


@pytest.mark.parametrize("name", ["cube", "sphere", "torus"])
def test_solids_are_closed_to_the_bit(name):
    assert open_edges(make_mesh(name, **SMALL[name])) == []


def test_an_open_edge_is_found():
    assert len(open_edges(make_mesh("quad"))) == 4


VOLUMES = {"cube": 1.0, "sphere": 4 / 3 * math.pi, "torus": 3 / 32 * math.pi**2}


@pytest.mark.parametrize(("name", "volume"), VOLUMES.items())
def test_triangles_face_outward(name, volume):
    mesh = make_mesh(name)
    points = corners(mesh, "position")
    signed = np.einsum("fi,fi->f", points[:, 0], np.cross(points[:, 1], points[:, 2])) / 6
    # 256 and 240 x 80 straight segments cut 0.03 % and 0.1 % off the round ones.
    assert signed.sum() == pytest.approx(volume, rel=2e-3)


def degrees_between(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the angle between rows of vectors, in degrees."""
    return np.rad2deg(np.arctan2(np.linalg.norm(np.cross(one, other), axis=-1), (one * other).sum(-1)))


# Degrees between a triangle's own frame and the mean of its corners': the curvature over half a step. Measured, the
# worst of normal, tangent and bitangent: sphere 2.8, torus 4.6, teapot 26 (at the end of the spout, which is bent the
# most). A wrong axis or sign is 90 or 180.
FRAME_BOUNDS = {"quad": 1e-5, "cube": 1e-5, "sphere": 4, "torus": 6, "teapot": 35}


@pytest.mark.parametrize("name", SHAPES)
def test_frames_agree_with_differences_over_the_texture(name):
    mesh = make_mesh(name, **SMALL[name])
    points, uv = corners(mesh, "position"), corners(mesh, "uv")
    frames = [oracle.face_frame(point, texture) for point, texture in zip(points, uv, strict=True)]
    along, up = np.array([frame[0] for frame in frames]), np.array([frame[1] for frame in frames])
    normal, tangent = corners(mesh, "normal").sum(axis=1), corners(mesh, "tangent").sum(axis=1)
    bitangent = np.cross(corners(mesh, "normal"), corners(mesh, "tangent")).sum(axis=1)
    assert degrees_between(np.array([oracle.face_normal(point) for point in points]), normal).max() < FRAME_BOUNDS[name]
    assert degrees_between(along, tangent).max() < FRAME_BOUNDS[name]
    # On a patch u and v need not be at right angles; v then only has to run to the bitangent's side.
    assert ((up * bitangent).sum(-1) > 0).all()
    if name != "teapot":
        assert degrees_between(up, bitangent).max() < FRAME_BOUNDS[name]


def test_quad_by_hand():
    mesh = make_mesh("quad")
    assert mesh.position.tolist() == [[-0.5, -0.5, 0], [0.5, -0.5, 0], [-0.5, 0.5, 0], [0.5, 0.5, 0]]
    assert mesh.uv.tolist() == [[0, 0], [1, 0], [0, 1], [1, 1]]
    assert len(mesh.faces) == 2
    assert mesh.bounds.tolist() == [[-0.5, -0.5, 0], [0.5, 0.5, 0]]
    assert mesh.radius == pytest.approx(math.sqrt(0.5))


def test_each_side_of_the_cube_shows_one_upright_texture():
    mesh = make_mesh("cube")
    for axis in range(3):
        for sign in (1, -1):
            outward = torch.zeros(3)
            outward[axis] = sign
            side = (mesh.normal == outward).all(dim=1)
            assert int(side.sum()) == 4
            assert bool((mesh.position[side][:, axis] == sign / 2).all())
            assert sorted(mesh.uv[side].tolist()) == [[0, 0], [0, 1], [1, 0], [1, 1]]
            if axis != 1:
                assert torch.equal(mesh.uv[side][:, 1], mesh.position[side][:, 1] + 0.5)


@pytest.mark.parametrize("name", ["sphere", "torus"])
def test_round_shapes_begin_at_the_front_and_go_to_the_right(name):
    mesh = make_mesh(name, **SMALL[name])
    position, u, v = mesh.position.double(), mesh.uv[:, 0].double(), mesh.uv[:, 1].double()
    turns, middle = {"sphere": (4, 1.0), "torus": (3, 0.5)}[name]
    ring = torch.stack((torch.sin(2 * math.pi * u / turns), torch.cos(2 * math.pi * u / turns)), dim=1)
    radius = position[:, [0, 2]].norm(dim=1)
    assert float((position[:, [0, 2]] - radius[:, None] * ring).abs().max()) < 1e-6
    # v is in the same measure as u: quarters of the unit circle, from its middle height up.
    angle = (v - middle) * (math.pi / 2 if name == "sphere" else 2 * math.pi)
    size, offset = (1.0, 0.0) if name == "sphere" else (0.25, 0.75)
    assert float((position[:, 1] - size * torch.sin(angle)).abs().max()) < 1e-6
    assert float((radius - offset - size * torch.cos(angle)).abs().max()) < 1e-6
    assert (float(u.max()), float(v.min()), float(v.max())) == (turns, 0, 2 * middle)


@pytest.mark.parametrize("name", ["sphere", "torus"])
def test_a_texture_keeps_its_aspect_and_its_size(name):
    mesh = make_mesh(name)
    points, uv = corners(mesh, "position"), corners(mesh, "uv")
    height = {"sphere": 1.0, "torus": 0.25}[name]  # the equator; the tube's lowest line, where the ring's radius is 3/4
    middle = np.abs(uv[..., 1].mean(axis=1) - height) < 0.02
    along, up = (np.array(part) for part in zip(*map(oracle.face_frame, points[middle], uv[middle]), strict=True))
    assert middle.sum() > 100
    # 2 pi in four, and 3 / 4 * 2 pi in three
    assert np.allclose(np.linalg.norm(along, axis=1), math.pi / 2, rtol=0.04)
    assert np.allclose(np.linalg.norm(up, axis=1), math.pi / 2, rtol=0.04)


def test_normals_of_the_seen_sphere_are_exact_to_the_stated_angle():
    mesh = make_mesh("sphere")
    random = np.random.default_rng(0)
    radius, azimuth = np.sin(np.deg2rad(random.uniform(0, 65, 500))), random.uniform(0, 2 * np.pi, 500)
    across = np.stack((radius * np.cos(azimuth), radius * np.sin(azimuth)), axis=1)
    start = np.column_stack((across, np.full(500, 2.0)))
    hit = mesh.trimesh.ray.intersects_first(start, np.tile([0.0, 0, -1], (500, 1)))
    assert (hit >= 0).all()
    points, normals = corners(mesh, "position")[hit], corners(mesh, "normal")[hit]
    edges = points[:, 1:, :2] - points[:, :1, :2]
    share = np.linalg.solve(np.moveaxis(edges, 1, 2), (across - points[:, 0, :2])[..., None])[..., 0]
    weight = np.column_stack((1 - share.sum(axis=1), share))
    seen = np.einsum("fk,fki->fi", weight, normals)
    exact = np.column_stack((across, np.sqrt(1 - radius**2)))
    assert degrees_between(seen, exact).max() < 0.02


def test_the_same_shape_is_the_same_to_the_bit():
    one, other = make_mesh("teapot"), make_mesh("teapot")
    assert torch.equal(one.position, other.position) and torch.equal(one.tangent, other.tangent)


def test_trimesh_has_the_same_triangles_and_embree():
    mesh = make_mesh("cube")
    assert np.array_equal(mesh.trimesh.faces, mesh.faces.numpy())
    assert np.array_equal(mesh.trimesh.vertices, mesh.position.double().numpy())
    assert "pyembree" in type(mesh.trimesh.ray).__module__
    assert mesh.trimesh is mesh.trimesh


@pytest.mark.parametrize("name", ["teapot", "cube", "quad", "torus"])
def test_rays_meet_what_those_of_trimesh_meet(name):
    mesh, random = make_mesh(name), np.random.default_rng(0)
    start = random.normal(size=(20_000, 3)) * 3
    direction = random.normal(size=start.shape) * 0.5 - start
    known = mesh.trimesh.ray.intersects_first(start, direction)
    assert np.array_equal(mesh.first_met(start, direction), known) and 0 < (known >= 0).mean() < 1


def test_rays_are_met_without_embree(monkeypatch):
    mesh, start = make_mesh("cube"), np.array([[0.1, 0.2, 5.0], [9.0, 9.0, 9.0]])
    known = mesh.first_met(start, np.tile([0.0, 0.0, -1.0], (2, 1)))
    monkeypatch.setitem(sys.modules, "embreex.mesh_construction", None)
    assert np.array_equal(make_mesh("cube").first_met(start, np.tile([0.0, 0.0, -1.0], (2, 1))), known) and known[0] >= 0 > known[1]


def test_unknown_names_and_options_are_errors():
    with pytest.raises(RangeError, match="Did you mean 'teapot'"):
        make_mesh("teapott")
    with pytest.raises(RangeError, match="key 'segment' must be one of: segments"):
        make_mesh("sphere", segment=8)
    with pytest.raises(RangeError, match="key 'segments' must be one of: none"):
        make_mesh("cube", segments=8)


@pytest.mark.parametrize("segments", [0, 2, 9.0, True, 100_000, "8"])
def test_numbers_of_segments_that_make_no_sphere_are_errors(segments):
    with pytest.raises(RangeError, match="segments must be a whole number from 4 to 2048"):
        make_mesh("sphere", segments=segments)


def test_a_sphere_of_an_odd_number_of_segments_is_an_error():
    with pytest.raises(RangeError, match="segments must be even for the sphere; it is 9"):
        make_mesh("sphere", segments=9)


@pytest.mark.parametrize(("name", "least"), [("sphere", 4), ("torus", 9), ("teapot", 1)])
def test_the_coarsest_shapes_hold_together(name, least):
    assert_frames_hold(make_mesh(name, segments=least))
