"""The shading map's volume, .3pm: bytes by hand, the round trip, and files that lie."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tests.models.examples import make
from tests.support import shared_path

from torchmat import DataError, RangeError, load_material, save_material
from torchmat.material_io import check_target
from torchmat.material_io.volume import read_volume

HEAD = b"VL\n#components 3\n%d %d %d\n%d\n"
CODES = np.random.default_rng(0).integers(0, 256, (4, 2, 3, 3), dtype=np.uint8)  # slices, rows, columns, RGB


def written(path, head=HEAD % (3, 2, 4, 255), body=CODES.tobytes()):
    path.write_bytes(head + body)
    return path


def volume_map(**options):
    """Return a small shading map whose slices lie in [0, 1]."""
    return make("shading_map", {"slices": 4, "brdf": "phong", **options}, 2, 3, torch.float32)


def test_the_layout_is_that_of_the_file(tmp_path):
    material = load_material(written(tmp_path / "a.3pm"))
    assert material.name == "shading_map" and material.size == (2, 3) and material.options["slices"] == 4
    slices = material.maps["slices"].detach().unflatten(0, (4, 3))
    for place in ((0, 0, 0, 0), (2, 1, 1, 2), (3, 2, 1, 0)):
        layer, channel, row, column = place
        assert float(slices[place]) == np.float32(CODES[layer, row, column, channel] / 255)


def test_what_the_file_does_not_say(tmp_path):
    material = load_material(written(tmp_path / "a.3pm"))
    mean = CODES[-1].mean() / 255
    assert float(material.maps["brightest"].detach()) == pytest.approx(mean, rel=1e-6)
    options = material.options
    assert (options["brdf"], options["overflow"], options["azimuths"]) == ("lambert", "clamp", 1)
    up = torch.tensor([0.0, 0, 1])[:, None, None]
    # Lit along the normal it shows its last slice, as the docstring says.
    assert torch.equal(material.shade(up, up), material.maps["slices"][-3:])


def test_read_and_written_back_is_the_same_file(tmp_path):
    source = written(tmp_path / "a.3pm")
    material = load_material(source)
    assert save_material(material, tmp_path / "b.3pm") == tmp_path / "b.3pm"
    assert (tmp_path / "b.3pm").read_bytes() == source.read_bytes()
    folder = save_material(material, tmp_path / "folder")
    save_material(load_material(folder), tmp_path / "c.3pm")  # half textures keep the codes apart
    assert (tmp_path / "c.3pm").read_bytes() == source.read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.3pm", "b.3pm", "c.3pm", "folder"]


def test_every_code_survives(tmp_path):
    codes = np.arange(256, dtype=np.uint8).repeat(3)
    source = written(tmp_path / "a.3pm", HEAD % (64, 2, 2, 255), codes.tobytes())
    save_material(load_material(source), tmp_path / "b.3pm")
    assert (tmp_path / "b.3pm").read_bytes() == source.read_bytes()


def test_the_chapters_file_byte_for_byte(tmp_path):
    source = shared_path("real/kautz_wool/wool.3pm")
    material = load_material(source)
    assert material.size == (256, 256) and material.options["slices"] == 8
    # The mean codes of its last slice are 193.326, 109.762 and 18.559.
    assert float(material.maps["brightest"].detach()) == pytest.approx(0.420454, abs=1e-6)
    save_material(material, tmp_path / "copy.3pm")
    assert (tmp_path / "copy.3pm").read_bytes() == source.read_bytes()


def test_values_are_rounded_to_the_nearest_code(tmp_path):
    material = volume_map()
    save_material(material, tmp_path / "a.3pm")
    found = load_material(tmp_path / "a.3pm").maps["slices"]
    assert float((found - material.maps["slices"]).detach().abs().max()) <= 0.5 / 255 + 1e-7


def test_an_existing_file_is_replaced(tmp_path):
    target = written(tmp_path / "a.3pm", body=b"old")
    save_material(volume_map(), target)
    assert load_material(target).size == (2, 3) and len(list(tmp_path.iterdir())) == 1


@pytest.mark.parametrize("levels", [1, 100])
def test_a_smaller_largest_code(tmp_path, levels):
    codes = (CODES % (levels + 1)).astype(np.uint8)
    material = read_volume(written(tmp_path / "a.3pm", HEAD % (3, 2, 4, levels), codes.tobytes()))
    slices = material.maps["slices"].detach().unflatten(0, (4, 3)).permute(0, 2, 3, 1).numpy()
    assert np.array_equal(slices, codes.astype(np.float32) / np.float32(levels))


def test_windows_line_ends_and_spaces(tmp_path):
    head = b"VL\r\n#components  3\r\n3 2\t4\r\n255\r\n"
    assert load_material(written(tmp_path / "a.3pm", head)).size == (2, 3)


@pytest.mark.parametrize("suffix", [".3pm", ".3PM"])
def test_names_with_spaces_and_foreign_letters(suffix, tmp_path):
    target = tmp_path / f"Wolle grün мох{suffix}"
    save_material(volume_map(), target)
    assert load_material(target).options["slices"] == 4


@pytest.mark.parametrize("head, body, words", [
    (b"", b"", "the head must be four short lines"),
    (b"VX\n#components 3\n3 2 4\n255\n", CODES.tobytes(), "the first line must be VL"),
    (b"P6\n3 2\n255\n", CODES.tobytes(), "the first line must be VL"),
    (b"\x89PNG\r\n\x1a\n", b"", "the head must be four short lines"),
    (b"V" * 5000, b"", "the head must be four short lines"),
    (b"VL\n#components 1\n3 2 4\n255\n", CODES.tobytes(), "second line must be '#components 3'; it is '#components 1'"),
    (b"VL\n#components 4\n3 2 4\n255\n", CODES.tobytes(), "second line must be '#components 3'"),
    (b"VL\n#components three\n3 2 4\n255\n", b"", "#components must be 1 positive whole number; the head says 'three'"),
    (b"VL\n3 2 4\n255\n", CODES.tobytes(), "the second line must be '#components 3'; it is '3 2 4'"),
    (b"VL\n#components 3\n3 2\n255\n", CODES.tobytes(), "width, height and slices must be 3 positive whole numbers"),
    (b"VL\n#components 3\n3 -2 4\n255\n", CODES.tobytes(), "the head says '3 -2 4'"),
    (b"VL\n#components 3\n3 0 4\n255\n", b"", "the head says '3 0 4'"),
    (b"VL\n#components 3\n3 2.0 4\n255\n", CODES.tobytes(), "the head says '3 2.0 4'"),
    (b"VL\n#components 3\n3 2 nan\n255\n", CODES.tobytes(), "the head says '3 2 nan'"),
    (b"VL\n#components 3\n99999999999 2 4\n255\n", b"", "the head says '99999999999 2 4'"),
    (HEAD % (999999999, 999999999, 999999999, 255), b"12", "have the size that its head says; .*and 2 follow"),
    (b"VL\n#components 3\n3 2 4\n255", b"", "the head must be four short lines"),
    (b"VL\n#components 3\n3 2 4\n0\n", CODES.tobytes(), "the largest code must be 1 positive whole number"),
    (b"VL\n#components 3\n3 2 4\n65535\n", CODES.tobytes(), "the largest code must be at most 255; it is 65535"),
    (b"VL\n#components 3\n3 2 4\n9\n", CODES.tobytes(), "codes must be at most 9 as the head says"),
    (HEAD % (3, 2, 4, 255), CODES.tobytes()[:-1], "3 x 2 x 4 x 3 are 72 bytes and 71 follow the head.*truncated"),
    (HEAD % (3, 2, 4, 255), CODES.tobytes() + b"x", "72 bytes and 73 follow the head"),
    (HEAD % (3, 2, 5, 255), CODES.tobytes(), "90 bytes and 72 follow the head"),
    (HEAD % (3, 2, 4, 255), b"", "72 bytes and 0 follow the head"),
    (HEAD % (12, 2, 1, 255), CODES.tobytes(), "slices must be a whole number from 2 to 64"),
    (b"VL\n#components 3\n" + "3 2 ٤\n255\n".encode(), CODES.tobytes(), "the head must be four short lines of ASCII"),
])
def test_bad_files_are_named(tmp_path, head, body, words):
    with pytest.raises(DataError, match=words) as error:
        load_material(written(tmp_path / "bad.3pm", head, body))
    assert str(tmp_path / "bad.3pm") in str(error.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(DataError, match=r"none\.3pm: the volume must be readable"):
        load_material(tmp_path / "none.3pm")


@pytest.mark.parametrize("material, words", [
    (lambda: make("ptm", {}, 2, 3, torch.float32), "must be a shading_map for a .3pm file; it is ptm. Save it as"),
    (lambda: make("shading_map", {"slices": 3, "brdf": "ggx", "azimuths": 4}), "must have one azimuth .*; it has 4"),
    (lambda: volume_map().on_relief(torch.rand(1, 2, 3)), "must be flat for a .3pm file; it has a height map"),
])
def test_what_has_no_place_in_the_file_is_refused(tmp_path, material, words):
    with pytest.raises(RangeError, match=words):
        save_material(material(), tmp_path / "a.3pm")
    assert not list(tmp_path.iterdir())


def test_slices_above_1_are_refused_with_the_way_out(tmp_path):
    material = volume_map()
    bright = material.with_maps(slices=4 * material.maps["slices"].detach())
    with pytest.raises(RangeError, match=r"slices must lie in \[0, 1\] for 8-bit codes; .*Write material"):
        save_material(bright, tmp_path / "a.3pm")
    assert not list(tmp_path.iterdir())
    largest = bright.maps["slices"].detach().max()
    save_material(bright.with_maps(slices=bright.maps["slices"] / largest), tmp_path / "a.3pm")
    found = load_material(tmp_path / "a.3pm").maps["slices"].detach()
    assert float((found * largest - bright.maps["slices"].detach()).abs().max()) <= float(largest) * 0.51 / 255


def test_negative_and_missing_values_are_never_written(tmp_path):
    for bad, words in ((-0.1, "slices must lie in"), (float("nan"), "slices must be finite")):
        material = volume_map()
        material.maps["slices"].data[0, 0, 0] = bad
        with pytest.raises(RangeError, match=words):
            save_material(material, tmp_path / "a.3pm")
    assert not list(tmp_path.iterdir())


def test_a_folder_that_cannot_be_written_to(tmp_path):
    (tmp_path / "file").write_text("mine", encoding="utf-8")
    with pytest.raises(DataError, match="must be writable"):
        save_material(volume_map(), tmp_path / "file" / "a.3pm")


def test_a_failure_leaves_the_old_file_and_no_rests(tmp_path, monkeypatch):
    target = written(tmp_path / "a.3pm")
    before = target.read_bytes()

    def full(*arguments):
        raise OSError(28, "No space left on device")

    for place in ("pathlib.Path.write_bytes", "torchmat.material_io.volume.os.replace"):
        with monkeypatch.context() as patch:
            patch.setattr(place, full)
            with pytest.raises(DataError, match="No space left"):
                save_material(volume_map(), target)
        assert target.read_bytes() == before and [path.name for path in tmp_path.iterdir()] == ["a.3pm"]


def test_a_material_folder_of_that_name_is_still_a_folder(tmp_path):
    save_material(volume_map(), tmp_path / "plain")
    (tmp_path / "plain").rename(tmp_path / "odd.3pm")
    assert load_material(tmp_path / "odd.3pm").options["brdf"] == "phong"


def test_a_fit_is_not_written_as_a_volume(tmp_path):
    with pytest.raises(DataError, match="x.3pm: the target must be a folder"):
        check_target(tmp_path / "x.3pm")
