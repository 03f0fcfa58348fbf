"""Near lights and cameras: each texel has directions of its own, and the fall-off is taken out of the images."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tests.btf.files import put_image, random_codes, srgb_decoded
from tests.support import assert_close

from torchmat import Btf, DataError, RangeError, RawBtf, ShapeError, fit, load_btf, register, Recipe
from torchmat.btf.near import Grid
from torchmat.fitting.fewer_texels import averaged
from torchmat.fitting.recipe import unregister
from torchmat.fitting.training import Fitted
from torchmat.models import Texture

POSITIONS = np.array([[0.0, 0.0, 2.0], [1.5, 0.5, 1.0], [-0.6, 0.9, 0.8]])
UP = np.tile([0.0, 0.0, 1.0], (3, 1))
HEIGHT, WIDTH = 4, 6


def texels(height: int = HEIGHT, width: int = WIDTH) -> np.ndarray:
    """Return x, y, z of the texels' centres, [H, W, 3], in widths from the centre."""
    x = (np.arange(width) + 0.5) / width - 0.5
    y = (height / 2 - np.arange(height) - 0.5) / width
    return np.stack((*np.meshgrid(x, y), np.zeros((height, width))), axis=-1)


def towards(position: np.ndarray, height: int = HEIGHT, width: int = WIDTH) -> tuple[np.ndarray, np.ndarray]:
    """Return unit directions [n, 3, H, W] to positions [n, 3], and distances [n, 1, H, W]."""
    gap = position[:, None, None] - texels(height, width)
    distance = np.linalg.norm(gap, axis=-1, keepdims=True)
    return (gap / distance).transpose(0, 3, 1, 2), distance.transpose(0, 3, 1, 2)


def flat(dtype=np.float64, **given) -> Btf:
    """Return a BTF whose images are 1 over the squared distance to their light, in the unit of the centre's."""
    _, distance = towards(POSITIONS)
    images = np.broadcast_to((np.linalg.norm(POSITIONS, axis=1)[:, None, None, None] / distance) ** 2, (3, 3, HEIGHT, WIDTH))
    return Btf.from_tensors(images.astype(dtype).copy(), None, UP.astype(dtype), light_position=POSITIONS, **given)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_each_texel_has_its_own_direction_and_no_fall_off(dtype):
    btf = flat(dtype)
    light, view = btf.directions(range(3))
    assert_close(light, torch.from_numpy(towards(POSITIONS)[0].astype(dtype)))
    assert tuple(view.shape) == (3, 3, 1, 1)
    assert_close(btf.light, torch.from_numpy((POSITIONS / np.linalg.norm(POSITIONS, axis=1)[:, None]).astype(dtype)))
    assert_close(btf.images(range(3), btf.light.dtype), torch.ones(3, 3, HEIGHT, WIDTH, dtype=btf.light.dtype))
    assert_close(next(iter(btf.blocks(dtype=btf.light.dtype))).images, torch.ones(3, 3, HEIGHT, WIDTH, dtype=btf.light.dtype))
    assert btf.value_range == pytest.approx((1, 1), abs=1e-6) and "near lights" in repr(btf)
    far = flat(dtype, falloff=False)
    assert float(far.images([1]).max()) > 1.5 and torch.equal(far.directions([1])[0], btf.directions([1])[0])


def test_near_cameras():
    btf = Btf.from_tensors(torch.rand(3, 3, HEIGHT, WIDTH), UP, None, view_position=POSITIONS)
    light, view = btf.directions(torch.tensor([2, 0]))
    assert_close(view, torch.from_numpy(towards(POSITIONS[[2, 0]])[0]).float())
    assert tuple(light.shape) == (2, 3, 1, 1) and len(btf.views) == 3 and len(btf.lights) == 1
    assert_close(btf.view_planes(btf.view_index), btf.directions(range(3))[1])


def test_parts_and_smaller_images_keep_their_places():
    btf = flat()
    whole = btf.directions(range(3))[0]
    part = btf.window(1, 2, 3, 4, 2)
    assert_close(part.directions(range(3))[0], whole[:, :, 1:4:2, 2:6:2])
    assert_close(part.images(range(3), torch.float64), torch.ones(3, 3, 2, 2, dtype=torch.float64))
    assert_close(part.window(1, 0, 1, 2).directions([0])[0], whole[:1, :, 3:4, 2:6:2])
    few = btf.picked([2, 0])
    assert_close(few.directions([0, 1])[0], whole[[2, 0]])
    assert torch.equal(few.light_position, btf.light_position[[2, 0]])
    small = averaged(btf, torch.tensor([1, 2]), (2, 3), torch.float64)
    assert_close(small.directions([0, 1])[0], torch.from_numpy(towards(POSITIONS[1:], 2, 3)[0]))
    assert_close(small.images([0, 1], torch.float64), torch.ones(2, 3, 2, 3, dtype=torch.float64))
    assert Grid.whole(HEIGHT, WIDTH).resized(HEIGHT, WIDTH) == pytest.approx(Grid.whole(HEIGHT, WIDTH))


def test_other_positions_are_other_data_and_other_lights():
    btf, moved = flat(), POSITIONS.copy()
    moved[1] *= 1.5
    one = Btf.from_tensors(btf.images(range(3)), None, UP, light_position=POSITIONS)
    other = Btf.from_tensors(btf.images(range(3)), None, UP, light_position=moved)
    assert one.identity() != other.identity() and one.digest() != other.digest()
    behind = Btf.from_tensors(btf.images(range(2)), None, UP[:2], light_position=np.array([[0, 0, 1.0], [0, 0, 2]]))
    assert len(behind.lights) == 2 and len(behind.far().lights) == 1


def test_far_is_said_and_knows_no_fall_off():
    far = flat().far()
    assert far.near is None and tuple(far.directions([0])[0].shape) == (1, 3, 1, 1)
    assert any(note.startswith("warning: near lights") for note in far.source.notes)
    assert float(far.images([1]).max()) > 1.5
    plain = Btf.from_tensors(torch.rand(3, 3, 2, 2), UP, UP)
    assert plain.far() is plain and plain.near is None


def test_very_far_positions_are_directions():
    images = torch.rand(3, 3, HEIGHT, WIDTH, dtype=torch.float64)
    for distance in (1e4, 1e7):  # the angle over the sample is that of its half width at such a distance
        near = Btf.from_tensors(images, None, UP, light_position=distance * POSITIONS)
        far = Btf.from_tensors(images, near.light, UP)
        gap = (near.directions(range(3))[0] - far.directions(range(3))[0]).abs().max()
        assert 0 < float(gap) < 0.7 / distance
        assert_close(near.images(range(3), torch.float64), images, 3 / distance)


@pytest.mark.parametrize(
    "bad, error, words",
    [
        ([0, 0, -1.0], RangeError, "lie above the surface; 1 of 3 are not, first that of sample 1"),
        ([0, 0, 0.0], RangeError, "lie above the surface"),
        ([0.2, 0.1, 1e-4], RangeError, "at least 0.001 widths from the sample"),
        ([0, np.nan, 1.0], RangeError, "be finite"),
    ],
)
def test_bad_positions(bad, error, words):
    position = POSITIONS.copy()
    position[1] = bad
    with pytest.raises(error, match=words):
        Btf.from_tensors(torch.rand(3, 3, 2, 2), None, UP, light_position=position)
    Btf.from_tensors(torch.rand(3, 3, 2, 2), None, UP, light_position=[[0.7, 0.1, 1e-4]] * 3)  # beside the sample


def test_bad_arguments():
    images = torch.rand(3, 3, 2, 2)
    with pytest.raises(ShapeError, match=r"light_position must be \[sample, 3\]"):
        Btf.from_tensors(images, None, UP, light_position=POSITIONS[:2])
    with pytest.raises(RangeError, match="light must point at the position"):
        Btf.from_tensors(images, UP, UP, light_position=POSITIONS)
    with pytest.raises(RangeError, match="Give view, or view_position"):
        Btf.from_tensors(images, UP, None)


def test_what_knows_no_near_lights_refuses_them():
    register(Recipe(type("Far", (Texture,), {"name": "knows_far"}), lambda training: Fitted(Texture({"albedo": training.btf.image(0)}))))
    try:
        with pytest.raises(RangeError, match="fit knows_far: lights and cameras must be far; near lights.*btf.far"):
            fit(flat(), "knows_far", holdout=0, measure="none")
    finally:
        unregister("knows_far")
    with pytest.raises(RangeError, match="RawBtf: lights and cameras must be far"):
        RawBtf(flat())


HEAD = "file,light_x,light_y,light_z,view_polar_deg,view_azimuth_deg"


def put_manifest(folder, head: str, more: str, rows=POSITIONS * 120):
    lines = [f"{name}.png,{x},{y},{z},0,0{more}" for name, (x, y, z) in zip("abc", rows.tolist(), strict=True)]
    for seed, name in enumerate("abc"):
        put_image(folder / f"{name}.png", random_codes(seed, (HEIGHT, WIDTH, 3)))
    (folder / "manifest.csv").write_text("\n".join([head, *lines, ""]))
    return folder


def test_manifest_in_millimetres(tmp_path):
    folder = put_manifest(tmp_path / "wall", f"{HEAD},sample_width", ",120")
    light, distance = towards(POSITIONS)
    for _ in range(2):  # decoded, then from the cache
        btf = load_btf(folder, cache=tmp_path / "cache")
        assert_close(btf.light_position, torch.from_numpy(POSITIONS).float())
        assert_close(btf.directions(range(3))[0], torch.from_numpy(light).float())
        gain = (distance[1] / np.linalg.norm(POSITIONS[1])) ** 2
        assert_close(btf.image(1), srgb_decoded(random_codes(1, (HEIGHT, WIDTH, 3)).transpose(2, 0, 1) / 255) * gain, 1e-5)
    assert btf.source.from_cache and any("lights are near: positions over a sample 120 wide" in note for note in btf.source.notes)
    part = load_btf(folder, cache=tmp_path / "cache", crop=(1, 2, 2, 4))
    assert_close(part.directions(range(3))[0], torch.from_numpy(light[:, :, 1:3, 2:6]).float())
    half = load_btf(folder, cache=tmp_path / "cache", downscale=2)
    assert_close(half.directions(range(3))[0], torch.from_numpy(towards(POSITIONS, 2, 3)[0]).float())


def test_manifest_of_normalised_images_and_near_cameras(tmp_path):
    head = f"{HEAD},sample_width,falloff".replace("view_polar_deg,view_azimuth_deg", "view_x,view_y,view_z")
    folder = put_manifest(tmp_path / "wall", head, ",500,120,0")
    btf = load_btf(folder, cache=False)
    assert_close(btf.view_position, torch.tensor([[0, 0, 500 / 120]]).repeat(3, 1))
    assert_close(btf.image(1), srgb_decoded(random_codes(1, (HEIGHT, WIDTH, 3)).transpose(2, 0, 1) / 255), 1e-6)
    assert btf.near.figures()["near"]["view_distance"] == pytest.approx([500 / 120] * 2)


@pytest.mark.parametrize(
    "head, more, words",
    [
        (f"{HEAD},sample_width", ",-3", "sample_width must be positive"),
        (f"{HEAD},falloff", ",1", "falloff must come with sample_width"),
        (f"{HEAD},sample_width,falloff", ",120,2", "falloff must be 0 or 1"),
        (HEAD, "", r"near=WIDTH \(--near WIDTH\)"),
    ],
)
def test_bad_manifests(tmp_path, head, more, words):
    with pytest.raises(DataError, match=words):
        load_btf(put_manifest(tmp_path / "wall", head, more), cache=False)


def test_a_position_below_names_its_file(tmp_path):
    rows = POSITIONS * [[1], [1], [-1]]
    folder = put_manifest(tmp_path / "wall", f"{HEAD},sample_width", ",1", rows)
    with pytest.raises(DataError, match="c.png: the light direction must lie above the surface"):
        load_btf(folder, cache=False)
    assert len(load_btf(folder, cache=False, skip_bad_lights=True).light_position) == 2


def put_table(folder, vectors: np.ndarray):
    put_manifest(folder, HEAD, "")
    (folder / "manifest.csv").unlink()
    (folder / "l.lp").write_text("".join(f"{name}.png {x!r} {y!r} {z!r}\n" for name, (x, y, z) in zip("abc", vectors.tolist(), strict=True)))
    return folder


def test_tables_of_positions_and_of_directions(tmp_path):
    folder = put_table(tmp_path / "near", 30 * POSITIONS)
    assert_close(load_btf(folder, near=30, cache=False).light_position, torch.from_numpy(POSITIONS).float())
    far = load_btf(folder, normalise=True, cache=False)
    assert far.near is None and any("they were 40.36 to 60 long" in note for note in far.source.notes)
    assert any("look like positions" in note and "near=WIDTH" in note for note in far.source.notes)
    unit = POSITIONS / np.linalg.norm(POSITIONS, axis=1)[:, None]
    dome = put_table(tmp_path / "dome", unit)
    assert_close(load_btf(dome, near=30, distance=40, cache=False).light_position, torch.from_numpy(unit * 40 / 30).float())
    with pytest.raises(DataError, match="all vectors have length 1: they are directions.*--distance"):
        load_btf(dome, near=30, cache=False)
    with pytest.raises(RangeError, match="distance must come with the sample's width"):
        load_btf(dome, distance=40, cache=False)
    with pytest.raises(RangeError, match="near must be positive"):
        load_btf(dome, near=-1, cache=False)
    normalised = load_btf(folder, near=30, falloff=False, cache=False)
    assert torch.equal(normalised.image(1), far.image(1))
