"""What rays meet, against a loop over triangles, and against pictures known by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from tests.reference.rays import crossings, first_hit
from tests.rendering.scenes import flat_mesh, front, squares
from tests.support import assert_close

from torchmat.errors import RangeError
from torchmat.rendering import visibility
from torchmat.rendering.camera import Camera
from torchmat.rendering.mesh import of_arrays
from torchmat.rendering.shapes import SHAPES, make_mesh
from torchmat.rendering.visibility import check_outside, first_hits, see, winding_number

PARTS = ("weight", "position", "frame", "view", "uv", "footprint", "share")


def corners(mesh) -> np.ndarray:
    return mesh.position.double()[mesh.faces].numpy()


def unit_rows(rows: np.ndarray) -> np.ndarray:
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)


def resolved(visible, name: str) -> torch.Tensor:
    return visible.resolve(getattr(visible, name))


@pytest.fixture(scope="module")
def sphere():
    return make_mesh("sphere", segments=48)


@pytest.fixture(scope="module")
def fine_sphere():
    return make_mesh("sphere")


def test_first_hits_are_those_of_a_loop_over_triangles():
    random = np.random.default_rng(3)
    mesh = flat_mesh(random.uniform(-1, 1, (12, 1, 3)) + random.uniform(-0.6, 0.6, (12, 3, 3)))
    origin, target = random.normal(size=(300, 3)) * 3, random.uniform(-1, 1, (300, 3))
    direction = unit_rows(target - origin)
    found = first_hits(mesh, torch.from_numpy(origin), torch.from_numpy(direction))
    expected = [first_hit(*ray, corners(mesh)) for ray in zip(origin, direction, strict=True)]
    met = [number for number, (triangle, _, _) in enumerate(expected) if triangle >= 0]
    assert 50 < len(met) < 250
    assert found.ray.tolist() == met
    assert found.triangle.tolist() == [expected[number][0] for number in met]
    assert_close(found.distance, torch.tensor([expected[number][1] for number in met], dtype=torch.float64), 1e-9)
    assert_close(found.share, torch.from_numpy(np.array([expected[number][2] for number in met])), 1e-9)


def test_rays_that_meet_nothing():
    mesh = squares((0, 0, 0, 1))
    up = torch.tensor([[0.0, 0, 1]], dtype=torch.float64)
    for origin in ([[0.0, 0, 1]], [[0.0, 5, -1]]):
        found = first_hits(mesh, torch.tensor(origin, dtype=torch.float64), up)
        assert [len(part) for part in found] == [0] * 4
    none = torch.zeros(0, 3, dtype=torch.float64)
    assert [len(part) for part in first_hits(mesh, none, none)] == [0] * 4


@pytest.mark.parametrize("edges_only", [False, True])
def test_a_camera_that_looks_away_sees_nothing(edges_only, dtype):
    seen = see(squares((0, 0, 0, 1)), Camera((0, 0, 3), (0, 0, 6)), (3, 5), 4, edges_only, dtype=dtype)
    assert len(seen.pixel) == 0
    picture = seen.resolve(torch.zeros(3, 1, 0, dtype=dtype))
    assert picture.shape == (3, 3, 5) and picture.dtype == dtype and not bool(picture.any())


@pytest.mark.parametrize("distance", [10.0, 1e3, 1e6, 1e9])
def test_distance_costs_no_digits(sphere, distance):
    # Measured 4e-16 in double precision at 10, 3e-7 at 1e9, where the camera's own numbers end.
    near, far = (see(sphere, front(2.2, away), 40, 1, dtype=torch.float64) for away in (4.0, distance))
    assert near.pixel.tolist() == far.pixel.tolist() and near.triangle.tolist() == far.triangle.tolist()
    assert_close(far.position, near.position, 1e-5 * distance / 1e9 + 1e-12)


def test_a_narrow_view_from_far_away_is_the_orthographic_one(sphere):
    away = 1e5
    narrow = see(sphere, Camera((0, 0, away), field_of_view=2 * math.atan(1.1 / away)), 30, 1, dtype=torch.float64)
    assert narrow.pixel.tolist() == see(sphere, front(2.2), 30, 1).pixel.tolist()
    assert_close(narrow.position, see(sphere, front(2.2), 30, 1, dtype=torch.float64).position, 1e-4)


@pytest.mark.parametrize("view", [(0.0, 0.0, 1.0), (0.3, 0.9, 0.1), (0.0, 1.0, 0.0), (-1.0, -0.2, 0.4)])
def test_a_sphere_has_no_holes(fine_sphere, view):
    camera = Camera.framing((0, 0, 0), 1.0, view)
    seen = see(fine_sphere, camera, 160, 1)
    place = (torch.arange(160, dtype=torch.float64) + 0.5) / 160 * 2.04 - 1.02
    radius = (place[:, None] ** 2 + place**2).sqrt().flatten()
    hit = torch.zeros(160 * 160, dtype=torch.bool)
    hit[seen.pixel] = True
    assert bool(hit[radius < 0.99].all()) and not bool(hit[radius > 1.0].any())


def test_rays_along_edges_and_through_corners_find_no_gap(sphere):
    points = corners(sphere)
    share = torch.tensor([[1, 0, 0], [0.5, 0.5, 0], [0, 0.25, 0.75], [0.1, 0, 0.9]], dtype=torch.float64).numpy()
    target = np.einsum("sk,fkx->fsx", share, points).reshape(-1, 3)
    origin = np.broadcast_to([0.5, 2.0, 4.0], target.shape)
    facing = np.einsum("nx,nx->n", target, origin - target) > 0.5  # not where the outline runs along an edge
    origin, target = origin[facing].copy(), target[facing]
    found = first_hits(sphere, torch.from_numpy(origin), torch.from_numpy(unit_rows(target - origin)))
    assert len(found.ray) == len(target) > 1000
    # The point met is the one aimed at, whichever of the triangles around it was.
    assert_close(found.distance, torch.from_numpy(np.linalg.norm(target - origin, axis=1)), 1e-6)
    assert float(found.share.min()) >= 0 and float((found.share.sum(dim=1) - 1).abs().max()) < 1e-12


def test_points_of_triangles_seen_edge_on_stay_in_them():
    random = np.random.default_rng(0)
    fan = [[[0, 0, 0], [1, 0, slope], [0, 1e-3 * slope, -1]] for slope in (0.0, 1e-7, -1e-7, 1e-4)]
    mesh = flat_mesh(fan)
    origin = np.tile([0.3, 5.0, -0.3], (500, 1))
    target = np.stack((random.uniform(0, 1, 500), np.zeros(500), random.uniform(-1, 0, 500)), axis=1)
    origin[:250] = target[:250] * [1, 0, 1] + [-5, 0, 0]  # in the plane itself
    found = first_hits(mesh, torch.from_numpy(origin), torch.from_numpy(unit_rows(target - origin + 1e-12)))
    assert len(found.ray) > 50 and bool(torch.isfinite(found.distance).all())
    point = torch.einsum("pk,pkx->px", found.share, torch.from_numpy(corners(mesh))[found.triangle])
    way = torch.from_numpy(origin)[found.ray] - point
    assert float((way.norm(dim=1) - found.distance).abs().max()) < 1e-3


def test_winding_number_of_a_closed_mesh_is_that_of_crossings(sphere):
    random = np.random.default_rng(1)
    for mesh in (sphere, make_mesh("torus", segments=24), make_mesh("cube")):
        for point in random.uniform(-0.95, 0.95, (6, 3)):
            expected = crossings(point, corners(mesh), unit_rows(random.normal(size=(1, 3)))[0])
            assert winding_number(mesh, torch.from_numpy(point)) == pytest.approx(expected, abs=1e-6)


def test_a_mesh_that_faces_inward_is_a_room(sphere):
    parts = [part.numpy() for part in (sphere.uv, sphere.tangent, -sphere.handedness)]
    inward = sphere.faces.flip(1).numpy(), -sphere.normal.numpy()
    room = of_arrays(sphere.position.numpy(), *inward, *parts, "room", "shape")
    assert winding_number(room, torch.zeros(3)) == pytest.approx(-1, abs=1e-6)
    seen = see(room, Camera((0, 0, 0), (0, 0, -1), field_of_view=1.0), 8, 1)
    assert len(seen.pixel) == 64 and float(seen.view[2].min()) > 0.95


@pytest.mark.parametrize("height", [1e-3, 0.5, 2.0])
def test_winding_number_of_an_open_mesh_is_its_solid_angle(height):
    # A square of side 2 from above its centre: 4 atan(1 / (h sqrt(2 + h^2))) of 4 pi, by hand.
    share = math.atan(1 / (height * math.sqrt(2 + height**2))) / math.pi
    mesh = squares((0, 0, 0, 1))
    assert winding_number(mesh, torch.tensor([0, 0, -height])) == pytest.approx(share, rel=1e-6)
    assert winding_number(mesh, torch.tensor([0, 0, height])) == pytest.approx(-share, rel=1e-6)


def test_winding_number_on_the_surface_is_finite(sphere):
    triangles = torch.from_numpy(corners(sphere))
    for place in (triangles[40, 0], triangles[40].mean(dim=0), triangles[40, :2].mean(dim=0)):
        assert -1e-6 < winding_number(sphere, place) < 1 + 1e-6


def test_a_camera_or_light_inside_is_an_error_that_says_so(sphere):
    for place in ((0, 0, 0), (0.5, 0.5, 0.5), (0, -0.97, 0)):
        with pytest.raises(RangeError, match=r"render: the light must lie outside of the mesh 'sphere'.*Move it out"):
            check_outside(sphere, "the light", place)
    for place in ((0, 0, 1.01), (0.9, 0.9, 0.9), (50, 0, 0)):
        check_outside(sphere, "the light", place)
    with pytest.raises(RangeError, match=r"the camera must .* it stands at \(0.0, 0.0, 0.5\), inside"):
        see(sphere, Camera((0, 0, 0.5)), 4)
    # In the hole of a torus, and beside an open mesh, there is nothing around it.
    check_outside(make_mesh("torus"), "the camera", (0, 0, 0))
    for height in (1e-6, 0.0, -1e-6):
        check_outside(make_mesh("quad"), "the light", (0, 0, height))
    check_outside(squares((0, 0, 0, 5), (0, 0, 1, 0.5)), "the light", (0, 0, 1.001))  # on a table on the floor


@pytest.mark.parametrize("rays", (1, 4, 9, 16))
@pytest.mark.parametrize("repeat", [1.0, 3.0, 1e4])
def test_footprint_seen_head_on(rays, repeat, dtype):
    seen = see(make_mesh("quad"), front(2.0), (8, 10), rays, repeat=repeat, dtype=dtype)
    expected = 0.2 * repeat / math.sqrt(rays)
    assert_close(seen.footprint, torch.full_like(seen.footprint, expected))


@pytest.mark.parametrize("angle_deg", [0.0, 30.0, 60.0, 85.0])
def test_footprint_grows_with_one_over_the_cosine(angle_deg):
    angle = math.radians(angle_deg)
    camera = Camera((0, 5 * math.sin(angle), 5 * math.cos(angle)), width=1.0)
    seen = see(make_mesh("quad"), camera, 20, 1, dtype=torch.float64)
    assert len(seen.pixel) > 20
    assert_close(seen.footprint, torch.full_like(seen.footprint, 0.05 / math.cos(angle)), 1e-6)


def test_footprint_of_a_grazing_view_is_bounded():
    angle = math.radians(89.99)
    camera = Camera((0, 5 * math.sin(angle), 5 * math.cos(angle)), width=1e-4)
    seen = see(make_mesh("quad"), camera, 4, 1, dtype=torch.float64)
    assert len(seen.pixel) and float(seen.footprint.max()) == pytest.approx(1e-4 / 4 * 20)


def test_footprint_of_a_perspective_view_grows_with_the_distance():
    near, far = (
        see(squares((0, 0, z, 2)), Camera((0, 0, 4), field_of_view=0.5), 11, 1, dtype=torch.float64) for z in (2, -2)
    )
    middle = 5 * 11 + 5
    expected = [2 * math.tan(0.25) / 11 * away / 4 for away in (2, 6)]  # a texture is 4 wide
    assert [float(seen.footprint[seen.pixel == middle]) for seen in (near, far)] == pytest.approx(expected)


def test_footprint_counts_textures_whatever_their_stretch():
    # Two textures along x and one half along y: as many in an area as one of side 1.
    mesh = squares((0, 0, 0, 0.5))
    stretched = flat_mesh(corners(mesh), mesh.uv.reshape(-1, 3, 2).numpy() * [2.0, 0.5], (1.0, 0.0, 0.0))
    seen = see(stretched, front(1.0), 10, 1, dtype=torch.float64)
    assert_close(seen.footprint, torch.full_like(seen.footprint, 0.1), 1e-6)


@pytest.mark.parametrize("name", SHAPES)
def test_frames_are_orthonormal_and_right_handed(name, dtype):
    mesh = make_mesh(name)
    seen = see(mesh, Camera.framing(mesh.centre, mesh.radius, (0.4, 0.5, 1)), 24, 1, dtype=dtype)
    frame = seen.frame[:, :, 0].permute(2, 0, 1)
    assert frame.dtype == dtype and len(frame) > 50
    assert_close(frame @ frame.transpose(1, 2), torch.eye(3, dtype=dtype).expand(len(frame), 3, 3), 1e-6)
    assert_close(torch.linalg.det(frame), torch.ones(len(frame), dtype=dtype), 1e-6)
    length = seen.view[:, 0].norm(dim=0)
    assert_close(length, torch.ones_like(length), 1e-6)
    # Back in the scene, the view is the camera's direction.
    back = torch.einsum("rxp,rp->xp", seen.frame[:, :, 0], seen.view[:, 0])
    camera = torch.tensor([0.4, 0.5, 1.0], dtype=dtype)
    assert_close(back, (camera / camera.norm())[:, None].expand_as(back), 1e-6)


def test_frame_of_a_mirrored_texture_is_left_handed_and_follows_it():
    mesh = squares((0, 0, 0, 1))
    mirrored = mesh.uv.reshape(-1, 3, 2).numpy() * [-1.0, 1.0]
    seen = see(flat_mesh(corners(mesh), mirrored, (-1.0, 0.0, 0.0), handedness=-1.0), front(2.0), 4, 1)
    expected = torch.tensor([[-1.0, 0, 0], [0, 1, 0], [0, 0, 1]])
    assert_close(seen.frame[:, :, 0], expected[:, :, None].expand(3, 3, 16))


@pytest.mark.parametrize("normal", [(0.0, 0.0, 1.0), (0.6, 0.0, 0.8)])
def test_opposite_tangents_leave_a_frame_all_the_same(normal, dtype):
    along = np.cross([0, 1, 0], normal)
    tangent = np.stack((along, -along, 0 * along))
    mesh = of_arrays(
        np.array([[-1.0, -1, 0], [1, -1, 0], [0, 1, 0]]), np.array([[0, 1, 2]]), np.tile(normal, (3, 1)),
        np.zeros((3, 2)), tangent, np.ones(3), "cancelled", "shape",
    )
    frame = see(mesh, front(2.0), 9, 1, dtype=dtype).frame[:, :, 0].permute(2, 0, 1)
    assert_close(frame @ frame.transpose(1, 2), torch.eye(3, dtype=dtype).expand(len(frame), 3, 3), 1e-6)


def test_places_and_coordinates_by_hand(dtype):
    # Two rows, four columns, 4 wide: pixel centres at x = -1.5 ... 1.5, y = 0.5 and -0.5; the square spans -2 ... 2.
    seen = see(squares((0, 0, -1, 2)), front(4.0), (2, 4), 1, repeat=2.0, dtype=dtype)
    assert seen.pixel.tolist() == list(range(8))
    x, y = torch.tensor([-1.5, -0.5, 0.5, 1.5] * 2, dtype=dtype), torch.tensor([0.5] * 4 + [-0.5] * 4, dtype=dtype)
    assert_close(seen.position[:, 0], torch.stack((x, y, torch.full_like(x, -1))))
    assert_close(seen.uv[:, 0], torch.stack((x, y)) / 2 + 1)
    assert_close(resolved(seen, "position")[1], y.reshape(2, 4))


@pytest.mark.parametrize("size", [1, (1, 7), (6, 1), (4, 9)])
@pytest.mark.parametrize("rays", (1, 4, 9, 16))
def test_weights_sum_to_the_covered_share(size, rays, dtype):
    rows, columns = (size, size) if isinstance(size, int) else size
    seen = see(squares((0, 0, 0, 50)), front(2.0), size, rays, dtype=dtype)
    full = seen.resolve(torch.ones(3, 1, len(seen.pixel), dtype=dtype))
    assert_close(full, torch.ones(3, rows, columns, dtype=dtype))
    assert len(seen.pixel) == rows * columns * rays
    half = see(squares((-50, 0, 0, 50)), front(2.0), size, rays, dtype=dtype)  # the picture's left half
    x = (torch.arange(columns * math.isqrt(rays), dtype=dtype) + 0.5) / (columns * math.isqrt(rays))
    on_edge = float(((x - 0.5).abs() < 1e-9).sum()) / len(x)  # may count or not
    share = float(half.weight.sum()) / (rows * columns)
    assert abs(share - 0.5) <= on_edge / 2 + 1e-6


def test_full_rays_at_edges_only_and_one_elsewhere():
    mesh = make_mesh("cube")
    camera = Camera.framing(mesh.centre, mesh.radius, (0.5, 0.4, 1))
    mixed, all_four, one = (see(mesh, camera, 24, *way, dtype=torch.float64) for way in ((4, True), (4,), (1,)))
    fine = torch.zeros(24 * 24, dtype=torch.bool)
    fine[mixed.pixel[mixed.weight < 1]] = True
    fine = fine.reshape(24, 24)
    assert 40 < int(fine.sum()) < 200
    for name in ("position", "view", "uv"):
        picture, four, single = (resolved(seen, name) for seen in (mixed, all_four, one))
        assert_close(picture[:, fine], four[:, fine])
        assert_close(picture[:, ~fine], single[:, ~fine])
    # Where one ray saw something or nothing and four agree, nothing is lost; the rest are the edges.
    covered = resolved_weight(all_four)
    assert bool(fine[(covered > 0) & (covered < 1)].all())


def resolved_weight(seen) -> torch.Tensor:
    return seen.resolve(torch.ones(1, 1, len(seen.pixel), dtype=seen.weight.dtype))[0]


def test_a_step_between_surfaces_that_face_alike_is_an_edge():
    seen = see(squares((0, 0, 0, 2), (0, 0, 1, 0.45)), front(2.0), 20, 4, edges_only=True)
    fine = torch.zeros(400, dtype=torch.bool)
    fine[seen.pixel[seen.weight < 1]] = True
    ring = torch.zeros(20, 20, dtype=torch.bool)
    ring[4:16, 4:16] = True  # pixel centres at 0.05, 0.15 ...: the square's border lies between 0.45 and 0.55
    ring[7:13, 7:13] = False
    assert bool(fine.any()) and not bool((fine.reshape(20, 20) & ~ring).any())
    assert 60 < int(fine.sum()) < 100


def test_a_ridge_between_neighbours_that_lie_alike_is_an_edge():
    left = [[[-2, -2, -2], [0, -2, 0], [0, 2, 0]], [[-2, -2, -2], [0, 2, 0], [-2, 2, -2]]]
    right = [[[0, -2, 0], [2, -2, -2], [2, 2, -2]], [[0, -2, 0], [2, 2, -2], [0, 2, 0]]]
    seen = see(flat_mesh(left + right), front(2.0), 10, 4, edges_only=True)
    fine = torch.zeros(100, dtype=torch.bool)
    fine[seen.pixel[seen.weight < 1]] = True
    assert fine.reshape(10, 10).all(dim=0).nonzero()[:, 0].tolist() == [4, 5] and int(fine.sum()) == 20


def test_a_smooth_surface_has_no_edges_inside(fine_sphere):
    seen = see(fine_sphere, front(2.2), 64, 4, edges_only=True)
    inner = seen.position[:2, 0].norm(dim=0) < 0.85
    assert bool(inner.any()) and bool((seen.weight[inner] == 1).all())


def test_every_part_is_finite_where_triangles_and_coordinates_have_no_area(dtype):
    good = [[-1, -1, 0], [1, -1, 0], [0, 1, 0]]
    line, point = [[-1, 0, 0.5], [0, 0, 0.5], [1, 0, 0.5]], [[0, 0, 1.0]] * 3
    for uv in (np.zeros((3, 3, 2)), np.full((3, 3, 2), 0.3), np.random.default_rng(0).uniform(0, 1, (3, 3, 2))):
        seen = see(flat_mesh([good, line, point], uv), front(2.0), 16, 4, dtype=dtype)
        assert len(seen.pixel) > 100
        for name in PARTS:
            part = getattr(seen, name)
            assert part.dtype == dtype or name == "share"
            assert bool(torch.isfinite(part).all()), name


def test_the_same_call_gives_the_same_bits():
    mesh, camera = make_mesh("teapot", segments=6), Camera.framing((0, 0, 0), 1.2, (1, 1, 1), 0.4)
    one, other = see(mesh, camera, 30, 9, edges_only=True), see(mesh, camera, 30, 9, edges_only=True)
    assert one.pixel.equal(other.pixel) and all(getattr(one, name).equal(getattr(other, name)) for name in PARTS)


def test_errors():
    mesh, camera = make_mesh("quad"), front(2.0)
    for size in (0, -3, (4, 0), (4,), (1, 2, 3), 2.5, (4, 2.5)):
        with pytest.raises(RangeError, match="render: size and repeat must be positive"):
            see(mesh, camera, size)
    for repeat in (0.0, -1.0, math.inf, math.nan):
        with pytest.raises(RangeError, match="size and repeat must be positive"):
            see(mesh, camera, 4, repeat=repeat)
    for rays in (0, 2, 25):
        with pytest.raises(RangeError, match="rays must be one of 1, 4, 9, 16; it is"):
            see(mesh, camera, 4, rays)


@pytest.mark.parametrize("edges_only", [False, True])
@pytest.mark.parametrize("camera", [
    None, Camera((0.5, 0.6, 1.2), field_of_view=0.5), Camera((0.1, 0.6, 4.2), field_of_view=1.5), Camera((0.0, 0.3, 0.4), width=0.7),
    Camera((0.2, 0.1, 1.9), (0.0, 3.0, 0.0), field_of_view=2.5),
])
def test_rays_that_cannot_meet_the_mesh_change_nothing(camera, edges_only, monkeypatch):
    mesh = make_mesh("torus", segments=32)
    camera = camera or Camera.framing(mesh.centre, mesh.radius)

    def seen():
        return visibility.see(mesh, camera, (45, 70), 4, edges_only)

    few = seen()
    fewer = visibility._may_show(mesh, camera, 45, 70, 4)
    monkeypatch.setattr(visibility, "_may_show", lambda mesh, camera, rows, columns, rays: torch.ones(rows, columns, dtype=torch.bool))
    every = seen()
    assert (len(few.pixel) > 0) == bool(fewer.any())
    for name in ("pixel", "weight", "position", "frame", "uv", "footprint", "triangle"):
        assert torch.equal(getattr(few, name), getattr(every, name)), name
    if camera.width is None and camera.field_of_view == 1.5:
        assert float(fewer.double().mean()) < 0.3
