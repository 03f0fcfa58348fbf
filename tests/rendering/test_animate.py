"""Sheets of pictures, moving pictures as files, and the directions of a turn."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from PIL import Image
from tests.reference.colour import encode
from tests.support import assert_close

from torchmat import DataError, RangeError, ShapeError
from torchmat.images import read_image, write_frames
from torchmat.rendering.animate import (
    contact_sheet,
    directions_on_arc,
    directions_on_circle,
    turntable_directions,
    write_animation,
)


def smooth(number: int, height: int = 12, width: int = 20) -> torch.Tensor:
    """Return a linear picture [3, H, W] with a soft spot that moves with `number`."""
    down, across = torch.meshgrid(torch.linspace(0, 1, height), torch.linspace(0, 1, width), indexing="ij")
    spot = torch.exp(-20 * ((across - 0.1 * number) ** 2 + (down - 0.5) ** 2))
    return torch.stack((spot, 0.5 * spot, 0.2 + 0.1 * across))


def codes(picture: torch.Tensor, exposure: float = 1.0) -> np.ndarray:
    """Return the 8-bit sRGB codes [H, W, 3] that a picture should be shown as."""
    encoded = np.vectorize(encode)((picture.double() * exposure).clamp(0, 1).numpy())
    return np.rint(encoded * 255).astype(np.uint8).transpose(1, 2, 0)


def frames_of(path) -> tuple[list[np.ndarray], list[float], int | None]:
    """Return the frames, their milliseconds and how often a file plays (0 for ever, None once), read by Pillow."""
    with Image.open(path) as file:
        frames, times = [], []
        for number in range(getattr(file, "n_frames", 1)):
            file.seek(number)
            frames.append(np.asarray(file.convert("RGB")))
            times.append(file.info.get("duration"))
        return frames, times, file.info.get("loop")


def left_in(folder) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.parametrize("suffix", ["png", "apng", "PNG"])
@pytest.mark.parametrize("count", [1, 2, 5])
def test_png_keeps_every_colour(tmp_path, suffix, count):
    pictures = [smooth(number) for number in range(count)]
    path = tmp_path / f"turn.{suffix}"
    assert write_animation(pictures, path, seconds_per_frame=0.25) == path
    frames, times, loop = frames_of(path)
    assert len(frames) == count
    assert times == [250] * count and loop == 0
    for frame, picture in zip(frames, pictures, strict=True):
        assert np.abs(frame.astype(int) - codes(picture)).max() <= 1  # a value halfway between two codes
    assert left_in(tmp_path) == [path.name]
    assert np.array_equal(read_image(path), frames[0])  # programs that know no moving PNG show the first frame


@pytest.mark.parametrize("count", [1, 2, 5])
def test_gif_keeps_sizes_times_and_about_the_colours(tmp_path, count):
    pictures = [smooth(number) for number in range(count)]
    path = write_animation(pictures, tmp_path / "turn.gif", seconds_per_frame=0.07)
    frames, times, loop = frames_of(path)
    assert len(frames) == count
    assert times == [70] * count and loop == 0
    for frame, picture in zip(frames, pictures, strict=True):
        assert frame.shape == (12, 20, 3)
        # 240 pixels and 255 colours: what is left is the dithering of colours that the median cut merged.
        assert np.abs(frame.astype(int) - codes(picture)).mean() < 1.5
    assert left_in(tmp_path) == ["turn.gif"]


@pytest.mark.parametrize("suffix", ["gif", "png"])
def test_flat_frames_come_back_exactly(tmp_path, suffix):
    pictures = [torch.full((3, 5, 7), value) for value in (0.0, 0.2, 1.0, 0.2, 0.2)]
    frames, _, _ = frames_of(write_animation(pictures, tmp_path / f"a.{suffix}"))
    assert len(frames) == 5
    for frame, picture in zip(frames, pictures, strict=True):
        assert np.array_equal(frame, codes(picture))


@pytest.mark.parametrize("suffix", ["gif", "png"])
@pytest.mark.parametrize("hundredths", [2, 3, 4, 7, 29, 100, 60000])
def test_every_time_a_frame_may_stand(tmp_path, suffix, hundredths):
    pictures = [torch.zeros(3, 1, 1), torch.ones(3, 1, 1)]
    path = write_animation(pictures, tmp_path / f"a.{suffix}", seconds_per_frame=hundredths / 100)
    assert frames_of(path)[1] == [10 * hundredths] * 2


@pytest.mark.parametrize("suffix, once", [("gif", None), ("png", 1)])
def test_played_once(tmp_path, suffix, once):
    pictures = [smooth(0), smooth(3)]
    frames, _, loop = frames_of(write_animation(pictures, tmp_path / f"a.{suffix}", loop=False))
    assert loop == once
    assert [frame.shape for frame in frames] == [(12, 20, 3)] * 2
    endless, _, _ = frames_of(write_animation(pictures, tmp_path / f"b.{suffix}"))
    assert all(np.array_equal(*pair) for pair in zip(frames, endless, strict=True))


def test_exposure_brightens_before_the_display(tmp_path):
    path = write_animation([smooth(2)], tmp_path / "a.png", exposure=2.5)
    assert np.abs(frames_of(path)[0][0].astype(int) - codes(smooth(2), 2.5)).max() <= 1


@pytest.mark.parametrize("suffix", ["gif", "png"])
def test_frames_are_written_as_they_come(tmp_path, suffix):
    alive = []

    def pictures():
        for number in range(6):
            written = [path.stat().st_size for path in tmp_path.rglob(f"a.{suffix}")]
            alive.append(sum(written))
            yield torch.rand(3, 64, 64)

    write_animation(pictures(), tmp_path / f"a.{suffix}")
    # Streams hold back some thousand bytes; a frame of noise has more.
    assert alive[-1] > alive[-3] > alive[1] >= alive[0]


def test_names_with_spaces_and_letters_from_everywhere(tmp_path):
    for suffix in ("gif", "png"):
        path = write_animation([smooth(0), smooth(1)], tmp_path / "neu" / f"Stoff ä 布 #1.{suffix}")
        assert len(frames_of(path)[0]) == 2


@pytest.mark.parametrize("suffix", ["gif", "png"])
def test_what_was_there_stays_until_the_last_frame(tmp_path, suffix):
    path = tmp_path / f"a.{suffix}"
    path.write_bytes(b"old")

    def broken():
        yield smooth(0)
        yield smooth(1)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_animation(broken(), path)
    assert path.read_bytes() == b"old" and left_in(tmp_path) == [path.name]
    write_animation([smooth(0)], path)
    assert len(frames_of(path)[0]) == 1 and left_in(tmp_path) == [path.name]


@pytest.mark.parametrize("suffix", ["gif", "png"])
def test_bad_pictures_leave_nothing(tmp_path, suffix):
    path = tmp_path / f"a.{suffix}"
    with pytest.raises(ShapeError, match=r"pictures must have one size; picture 1 is \(12, 21\) and picture 0"):
        write_animation([smooth(0), smooth(1, 12, 21)], path)
    with pytest.raises(RangeError, match=f"a.{suffix}: frames must be at least one; there is none"):
        write_animation([], path)
    with pytest.raises(ShapeError, match=r"picture 0 must be \[3, H, W\]"):
        write_animation([torch.zeros(1, 4, 4)], path)
    with pytest.raises(RangeError, match="picture 0 must be finite; 1 of 12 values are NaN"):
        write_animation([torch.ones(3, 2, 2).index_put((torch.tensor(0),) * 3, torch.tensor(math.nan))], path)
    for seconds in (0.0, 0.01, 601, math.nan):
        with pytest.raises(RangeError, match="the seconds per frame must lie in"):
            write_animation([smooth(0)], path, seconds_per_frame=seconds)
    for exposure in (0.0, -1.0, math.inf):
        with pytest.raises(RangeError, match="exposure must be positive"):
            write_animation([smooth(0)], path, exposure=exposure)
    assert left_in(tmp_path) == []


@pytest.mark.parametrize("frame", [np.zeros((2, 2, 3)), np.zeros((2, 2, 4), np.uint8), np.zeros((2, 2), np.uint8)])
def test_what_is_no_frame(tmp_path, frame):
    with pytest.raises(ShapeError, match=r"frames must be \[H, W, 3\] of uint8; frame 1 is"):
        write_frames(tmp_path / "a.png", [np.zeros((2, 2, 3), np.uint8), frame])
    with pytest.raises(ShapeError, match=r"frame 1 is \(3, 2\) and frame 0 is \(2, 2\)"):
        write_frames(tmp_path / "a.gif", [np.zeros((2, 2, 3), np.uint8), np.zeros((3, 2, 3), np.uint8)])
    assert left_in(tmp_path) == []


@pytest.mark.parametrize("name", ["a.mp4", "a", "a.jpg"])
def test_unknown_suffix(tmp_path, name):
    with pytest.raises(DataError, match=f"{name}: the suffix of moving pictures must be one of .apng.*Write .png"):
        write_animation([smooth(0)], tmp_path / name)
    assert left_in(tmp_path) == []


@pytest.mark.parametrize("suffix", ["gif", "png"])
def test_unwritable(tmp_path, suffix):
    (tmp_path / f"a.{suffix}").mkdir()
    with pytest.raises(DataError, match=f"a.{suffix}: the file must be written whole"):
        write_animation([smooth(0)], tmp_path / f"a.{suffix}")
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match="the file must be writable"):
        write_animation([smooth(0)], tmp_path / "file" / f"a.{suffix}")
    assert left_in(tmp_path) == sorted([f"a.{suffix}", "file"])


@pytest.mark.parametrize("suffix", ["gif", "png"])
def test_a_full_disk(tmp_path, suffix):
    resource = pytest.importorskip("resource")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    random = np.random.default_rng(0)
    frames = [random.integers(0, 256, (64, 64, 3), dtype=np.uint8) for _ in range(8)]
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, hard))  # stands in for a disk with so much left
    try:
        with pytest.raises(DataError, match=f"a.{suffix}: the (image must be writable.*disk is not full|file must be written whole.*Free some space)"):
            write_frames(tmp_path / f"a.{suffix}", frames)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert left_in(tmp_path) == []


def test_a_sheet_by_hand():
    pictures = [torch.full((3, 1, 2), float(number)) for number in range(3)]
    sheet = contact_sheet(pictures, gap=1, background=9.0)
    rows = [[0, 0, 9, 1, 1], [9, 9, 9, 9, 9], [2, 2, 9, 9, 9]]
    assert torch.equal(sheet, torch.tensor(rows).float().expand(3, 3, 5))


def test_sheets_of_other_forms():
    pictures = [torch.rand(3, 4, 6, dtype=torch.float64) for _ in range(5)]
    assert contact_sheet(pictures).shape == (3, 12, 26)
    assert torch.equal(contact_sheet(pictures, columns=5, gap=0), torch.cat(pictures, dim=2))
    assert torch.equal(contact_sheet(pictures, columns=1, gap=0), torch.cat(pictures, dim=1))
    assert contact_sheet(pictures, columns=50).shape == (3, 4, 5 * 6 + 4 * 4)
    assert torch.equal(contact_sheet(pictures[:1]), pictures[0])
    coloured = contact_sheet(pictures, background=(0.1, 0.2, 0.3))
    assert coloured.dtype == torch.float64
    assert coloured[:, 4, 0].tolist() == coloured[:, -1, -1].tolist() == [0.1, 0.2, 0.3]


def test_sheets_that_cannot_be():
    with pytest.raises(RangeError, match="contact_sheet: pictures must be at least one"):
        contact_sheet([])
    with pytest.raises(ShapeError, match="picture 1 is"):
        contact_sheet([smooth(0), smooth(0, 3, 3)])
    for options in ({"columns": 0}, {"gap": -1}):
        with pytest.raises(RangeError, match="columns and gap must be"):
            contact_sheet([smooth(0)], **options)
    with pytest.raises(ShapeError, match="background must be one number or three"):
        contact_sheet([smooth(0)], background=(1.0, 2.0))


def test_a_light_that_goes_round():
    half = math.sqrt(0.5)
    found = directions_on_circle(4, math.pi / 4, dtype=torch.float64)
    assert_close(found, np.array([[half, 0, half], [0, half, half], [-half, 0, half], [0, -half, half]]))
    found = directions_on_circle(2, math.pi / 2, start=math.pi / 2, turn=-math.pi, dtype=torch.float64)
    assert_close(found, np.array([[0, 1, 0], [1, 0, 0]]), 1e-15)
    assert_close(directions_on_circle(3, 0.0), [[0, 0, 1]] * 3)
    assert directions_on_circle(7, 1.0).dtype == torch.float32


def test_a_light_that_passes_over():
    found = directions_on_arc(3, reach=math.pi / 2, dtype=torch.float64)
    assert_close(found, np.array([[-1, 0, 0], [0, 0, 1], [1, 0, 0]]), 1e-15)
    found = directions_on_arc(2, azimuth=math.pi / 2, reach=math.pi / 6, dtype=torch.float64)
    assert_close(found, np.array([[0, -0.5, math.sqrt(0.75)], [0, 0.5, math.sqrt(0.75)]]))
    assert_close(directions_on_arc(1), [[0, 0, 1]])


def test_a_camera_that_goes_round():
    round_once = np.array([[0, 0, 1], [1, 0, 0], [0, 0, -1], [-1, 0, 0]])
    assert_close(turntable_directions(4, dtype=torch.float64), round_once, 1e-15)
    high = turntable_directions(6, math.pi / 6, start=0.2, dtype=torch.float64)
    assert_close(high[:, 1], np.array([0.5] * 6))
    assert_close(high.norm(dim=1), torch.ones(6).double())
    assert_close(high[0], np.array([math.sqrt(0.75) * math.sin(0.2), 0.5, math.sqrt(0.75) * math.cos(0.2)]))
    assert_close(turntable_directions(2, -math.pi / 2), np.array([[0, -1, 0]] * 2), 1e-7)


def test_turns_that_cannot_be():
    for call in (lambda: directions_on_circle(0, 1.0), lambda: directions_on_arc(0), lambda: turntable_directions(0)):
        with pytest.raises(RangeError, match="count must be at least 1; it is 0"):
            call()
    with pytest.raises(RangeError, match="polar must lie in .* it is 45.0.*radians"):
        directions_on_circle(3, 45.0)
    with pytest.raises(RangeError, match="azimuth must lie in"):
        directions_on_arc(3, azimuth=math.nan)
    with pytest.raises(RangeError, match=r"elevation must lie in \[-pi/2, pi/2\]; it is 2"):
        turntable_directions(3, elevation=2.0)
