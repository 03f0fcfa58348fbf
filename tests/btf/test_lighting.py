"""Photographs of one view and their lights: order, names, intensities, a chrome ball, and what is said of them."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tests.btf.files import put_image, random_codes, zipped
from tests.support import assert_close

from torchmat import DataError, RangeError, load_btf

COUNT = 12
POLAR, AZIMUTH = np.deg2rad(20 + 3 * np.arange(COUNT)), 2.4 * np.arange(COUNT)
LIGHT = np.stack((np.sin(POLAR) * np.cos(AZIMUTH), np.sin(POLAR) * np.sin(AZIMUTH), np.cos(POLAR)), axis=1)


def put_photographs(folder, name="gray.{}.tga", count=COUNT):
    for number in range(count):
        put_image(folder / name.format(number), random_codes(number))
    return folder


def put_lights(path, light=LIGHT, decimals=8):
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(path, light, fmt=f"%.{decimals}f")
    return path


def put_lp(path, names, light=LIGHT, decimals=8):
    lines = [f"{name} {x:.{decimals}f} {y:.{decimals}f} {z:.{decimals}f}" for name, (x, y, z) in zip(names, light, strict=True)]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize("pack", [lambda folder: folder, zipped], ids=["folder", "zip"])
def test_photographs_count_as_people_do(tmp_path, pack):
    source = pack(put_photographs(tmp_path / "d"))
    btf = load_btf(source, light_table=put_lights(tmp_path / "lights.txt"))
    assert [name.rpartition("/")[2] for name in btf.source.files] == [f"gray.{number}.tga" for number in range(COUNT)]
    assert_close(btf.light, LIGHT, 1e-6)
    assert (btf.source.kind, len(btf.views)) == ("rti", 1)
    assert "12 photographs, in their natural order, have the lights of" in btf.source.notes[0]


def test_a_list_of_names_decides_the_order(tmp_path):
    folder = put_photographs(tmp_path / "d")
    put_image(folder / "mask.png", random_codes(99))
    names = [f"gray.{number}.tga" for number in (3, 1, 2, 0, 11, 10, 9, 8, 7, 6, 5, 4)]
    (folder / "filenames.txt").write_text("\r\n".join(names) + "\r\n")
    btf = load_btf(folder, light_table=put_lights(tmp_path / "lights.txt"))
    assert list(btf.source.files) == names


def test_the_form_of_diligent(tmp_path):
    folder = put_photographs(tmp_path / "d", "{:03d}.png")
    put_image(folder / "mask.png", random_codes(99))
    (folder / "filenames.txt").write_text("".join(f"{number:03d}.png\n" for number in range(COUNT)))
    put_lights(folder / "light_directions.txt")
    intensity = 1 + np.arange(3 * COUNT).reshape(COUNT, 3) / 10
    np.savetxt(folder / "light_intensities.txt", intensity)
    plain = load_btf(folder, light_table=folder / "light_directions.txt")
    for path in (folder, folder / "light_directions.txt"):
        btf = load_btf(path)
        assert btf.source.kind == "stereo" and "intensities are those of light_intensities.txt" in btf.source.notes
        assert_close(btf.light, LIGHT, 1e-6)
        assert_close(btf.images([2, 5]), plain.images([2, 5]).numpy() / intensity[[2, 5], :, None, None], 1e-6)
    again = load_btf(folder)
    assert again.source.from_cache and again.source.notes == btf.source.notes
    assert_close(again.intensity, intensity, 1e-6)


def test_every_way_to_the_values_divides_them(tmp_path):
    folder = put_photographs(tmp_path / "d")
    put_image(folder / "gray.3.tga", np.full((3, 4, 3), 255, np.uint8))
    intensity = 1 + np.arange(3 * COUNT).reshape(COUNT, 3) / 10
    np.savetxt(tmp_path / "i.txt", intensity)
    table = put_lights(tmp_path / "lights.txt")
    plain, btf = load_btf(folder, light_table=table), load_btf(folder, light_table=table, intensities=tmp_path / "i.txt")
    wanted = plain.images(range(COUNT)) / torch.from_numpy(intensity).float()[:, :, None, None]
    assert_close(btf.images(range(COUNT)), wanted, 1e-6)
    assert_close(torch.cat([block.images.clone() for block in btf.blocks()]), wanted, 1e-6)
    assert_close(btf.window(1, 1, 2, 2).picked([4, 7]).images([1]), wanted[7:8, :, 1:3, 1:3], 1e-6)
    low, high = btf.value_range
    assert low <= float(wanted.min()) and high >= float(wanted.max())
    assert bool(btf.saturated([3], btf.images([3])).all()) and not bool(btf.saturated([4], btf.images([4])).any())
    assert btf.identity() != plain.identity()


def test_intensities_of_the_table_and_of_a_file_that_does_not_fit(tmp_path):
    folder = put_photographs(tmp_path / "d")
    table = put_lights(tmp_path / "lights.txt", np.concatenate((LIGHT, 2 + np.arange(COUNT)[:, None]), axis=1))
    assert_close(load_btf(folder, light_table=table).intensity, (2 + np.arange(COUNT))[:, None].repeat(3, axis=1), 1e-6)
    (tmp_path / "i.txt").write_text("1\n2\n")
    with pytest.raises(DataError, match="i.txt: the table must hold the intensity of each light; it is 2 x 1 for 12"):
        load_btf(folder, light_table=table, intensities=tmp_path / "i.txt")


def test_as_many_lights_as_photographs(tmp_path):
    folder = put_photographs(tmp_path / "d")
    with pytest.raises(DataError, match="there are 11 lights and 12 photographs, gray.0.tga to gray.11.tga. Move out what is no"):
        load_btf(folder, light_table=put_lights(tmp_path / "lights.txt", LIGHT[:11]))


def test_the_named_lp_of_two(tmp_path):
    folder = put_photographs(tmp_path / "d")
    names = [f"gray.{number}.tga" for number in range(COUNT)]
    put_lp(folder / "a.lp", names), put_lp(folder / "b.lp", names[:5], LIGHT[::-1][:5])
    btf = load_btf(folder / "b.lp")
    assert list(btf.source.files) == names[:5]
    assert_close(btf.light, LIGHT[::-1][:5].copy(), 1e-6)
    assert "7 images are not in the table of lights and are left out, first gray.5.tga" in btf.source.notes
    assert len(load_btf(folder / "a.lp")) == COUNT
    with pytest.raises(DataError, match="there are 2: a.lp, b.lp. Keep one, or give the file's own path"):
        load_btf(folder)


@pytest.mark.parametrize("images", ["", "jpeg-exports"])
def test_a_table_in_a_folder_of_its_own(tmp_path, images):
    put_photographs(tmp_path / "d" / images)
    names = [f"C:\\rti\\jpeg-exports\\gray.{number}.tga" for number in range(COUNT)]
    btf = load_btf(put_lp(tmp_path / "d" / "assembly-files" / "coin.lp", names))
    assert len(btf) == COUNT and btf.source.files[0] == (f"{images}/gray.0.tga" if images else "gray.0.tga")


def test_lights_rounded_to_two_decimals_are_made_unit_and_it_is_said(tmp_path):
    names = [f"gray.{number}.tga" for number in range(COUNT)]
    btf = load_btf(put_lp(put_photographs(tmp_path / "d") / "x.lp", names, decimals=2))
    assert_close(btf.light.norm(dim=1), torch.ones(COUNT), 1e-6)
    assert float((btf.light - torch.from_numpy(LIGHT)).abs().max()) < 0.01
    assert any("light directions were brought to length 1; they were 0.99" in note for note in btf.source.notes)


def test_positions_are_told_from_directions(tmp_path):
    folder = put_photographs(tmp_path / "d")
    far = put_lights(tmp_path / "far.txt", 100 * LIGHT)
    near = put_lights(tmp_path / "near.txt", LIGHT * np.linspace(30, 60, COUNT)[:, None])
    for table, said in ((far, False), (near, True)):
        notes = load_btf(folder, light_table=table).source.notes
        assert any("brought to length 1" in note for note in notes)
        assert any("look like positions" in note for note in notes) == said
    with pytest.raises(DataError, match=r"unit vector; 12 of 12 are not.*normalise=True \(--normalise\)"):
        load_btf(put_lp(folder / "x.lp", [f"gray.{number}.tga" for number in range(COUNT)], 100 * LIGHT))


def test_bad_lines_are_skipped_on_request_and_counted(tmp_path):
    folder = put_photographs(tmp_path / "d")
    names, light = [f"gray.{number}.tga" for number in range(COUNT)], LIGHT.copy()
    names[4] = "gone.tga"
    light[7, 2] *= -1
    light[9] = 0
    path = put_lp(folder / "x.lp", names, light)
    with pytest.raises(DataError, match="line 5: the file 'gone.tga' must exist"):
        load_btf(folder)
    btf = load_btf(folder, skip_bad_lights=True)
    assert list(btf.source.files) == [name for number, name in enumerate(names) if number not in (4, 7, 9)]
    assert_close(btf.light, np.delete(LIGHT, (4, 7, 9), axis=0), 1e-6)
    notes = " / ".join(btf.source.notes)
    assert "1 lines of the table are skipped, first: " in notes and "gone.tga" in notes
    assert "2 of 11 photographs are skipped, whose lights are below the surface, first gray.7.tga" in notes
    put_lp(path, names, -LIGHT)
    with pytest.raises(DataError, match="lights must lie above the surface; all 11 are not"):
        load_btf(folder, skip_bad_lights=True)


def put_ball(folder, light, name="ball {}.png", centre=(30.0, 24.0), radius=20.0, size=(50, 64)):
    """Photograph a chrome ball: the mirror direction of each pixel, traced, and a lamp with a soft edge."""
    rows, columns = np.meshgrid(np.arange(size[0]), np.arange(size[1]), indexing="ij")
    x, y = (columns - centre[0]) / radius, (centre[1] - rows) / radius
    inside = x * x + y * y < 1
    z = np.sqrt(np.where(inside, 1 - x * x - y * y, 0))
    mirrored = 2 * z[..., None] * np.stack((x, y, z), axis=-1) - np.array([0, 0, 1])
    for number, one in enumerate(light):
        spot = np.where(inside, np.maximum(mirrored @ one, 0) ** 60, 0.0)
        put_image(folder / name.format(number), np.repeat((20 + 230 * spot)[..., None], 3, axis=-1).astype(np.uint8))
    return folder


CIRCLE = (30.0, 24.0, 20.0)


def angles_deg(found, light):
    return np.rad2deg(np.arccos(np.clip((found.numpy() * light).sum(axis=1), -1, 1)))


@pytest.mark.parametrize("name", ["ball {}.png", "gray.{}.png"])
def test_a_ball_gives_the_lights(tmp_path, name):
    folder, ball = put_photographs(tmp_path / "d"), put_ball(tmp_path / "ball", LIGHT, name)
    btf = load_btf(folder, ball=ball, circle=CIRCLE)
    assert btf.source.files[2] == "gray.2.tga" and f"12 lights come from the chrome ball in {ball}" in btf.source.notes
    assert float(angles_deg(btf.light, LIGHT).max()) < 3  # on 20 pixels a half is 1.4 degrees of the normal, 2.9 of the light


def test_photographs_of_the_ball_are_paired_by_name_where_they_are_called_alike(tmp_path):
    folder, ball = put_photographs(tmp_path / "d"), put_ball(tmp_path / "ball", LIGHT[:7], "gray.{}.png")
    btf = load_btf(folder, ball=ball, circle=CIRCLE)
    assert list(btf.source.files) == [f"gray.{number}.tga" for number in range(7)]
    with pytest.raises(RangeError, match="there are 7 for 12 photographs"):
        load_btf(folder, ball=put_ball(tmp_path / "other", LIGHT[:7]), circle=CIRCLE)


@pytest.mark.parametrize(
    "circle, expected",
    [
        (None, "the ball must be calibrated; the circle is missing.*--circle COLUMN ROW RADIUS"),
        ((30.0, 24.0), "the circle is missing|it has 2 numbers"),
        ((60.0, 24.0, 20.0), r"ball 0.png: the ball's circle must lie inside the photograph; centre \(60, 24\), radius 20"),
        ((30.0, 24.0, 0.0), "ball 0.png: the ball's circle must lie inside"),
        ((40.0, 24.0, 12.0), r"ball \d+.png: (the ball's light must be above the surface|.*must (lie inside|show one highlight))"),
    ],
)
def test_a_wrong_circle_is_refused_with_the_photograph_s_name(tmp_path, circle, expected):
    folder, ball = put_photographs(tmp_path / "d"), put_ball(tmp_path / "ball", LIGHT)
    with pytest.raises((DataError, RangeError), match=expected):
        load_btf(folder, ball=ball, circle=circle)


def test_a_ball_s_light_below_the_surface_is_refused_or_skipped(tmp_path):
    light = LIGHT.copy()
    light[3] = (0.8, 0.0, -0.6)
    folder, ball = put_photographs(tmp_path / "d"), put_ball(tmp_path / "ball", light)
    with pytest.raises(DataError, match=r"ball 3.png: the ball's light must be above the surface; the highlight is at column 4\d"):
        load_btf(folder, ball=ball, circle=CIRCLE)
    btf = load_btf(folder, ball=ball, circle=CIRCLE, skip_bad_lights=True)
    assert len(btf) == 11 and "gray.3.tga" not in btf.source.files


def test_a_table_or_a_ball(tmp_path):
    folder = put_photographs(tmp_path / "d")
    with pytest.raises(RangeError, match="come from a table or from a ball; both are given"):
        load_btf(folder, ball=folder, circle=CIRCLE, light_table=put_lights(tmp_path / "lights.txt"))
