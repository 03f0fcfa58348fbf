"""A reader from outside: one file that holds everything is loaded, described, fitted and cached as a folder is."""

from __future__ import annotations

import dataclasses
import threading
from pathlib import Path

import numpy as np
import pytest
import torch
from tests.btf.files import put_btf, zipped
from tests.support import all_pairs, assert_close, hemisphere, plausible_images

import torchmat as tm
from torchmat import DataError, RangeError
from torchmat.btf import READERS, Listing, Pixels, Reader, images_of_files, register_reader, unregister_reader
from torchmat.cli import main

LIGHT, VIEW = all_pairs(hemisphere(((0, 1), (40, 4))), hemisphere(((0, 1), (50, 3))))
IMAGES = plausible_images(LIGHT, VIEW, 8, 6).transpose(0, 2, 3, 1).astype(np.float32)  # [n, H, W, C]


class Toy:
    """Reads a ``.npz`` with `light`, `view` and an array for each image, and notes what it was asked for."""

    def __init__(self) -> None:
        self.asked: list[tuple[range, slice, slice]] = []
        self.opened = self.closed = self.inside = 0
        self.reader = Reader("toy", "a .npz of everything", self.sniff, self.listing, self.pixels, one_file=True)

    def sniff(self, source):
        return source.path.suffix == ".npz" and source.start(2) == b"PK"

    def listing(self, source):
        with np.load(source.path) as found:
            count = len(found["light"])
            light, view = (torch.from_numpy(found[name]) for name in ("light", "view"))
        return Listing("whatever", tuple(f"image {number}" for number in range(count)), light, view)

    def pixels(self, source, listing):
        archive = np.load(source.path)
        self.opened += 1
        first = archive["image_0"]

        def read(samples, rows, columns):
            self.asked.append((samples, rows, columns))
            self.inside += 1
            assert self.inside == 1, "two threads read at once"
            found = np.stack([archive[f"image_{sample}"][rows, columns] for sample in samples])
            self.inside -= 1
            return found

        def close():
            archive.close()
            self.closed += 1

        return Pixels(first.shape, first.dtype, read, close)


@pytest.fixture
def toy():
    toy = Toy()
    register_reader(toy.reader)
    yield toy
    unregister_reader("toy")


@pytest.fixture
def file(tmp_path):
    return put_npz(tmp_path / "wool.npz")


def put_npz(path, images=IMAGES, light=LIGHT, view=VIEW):
    np.savez(path, light=light, view=view, **{f"image_{number}": image for number, image in enumerate(images)})
    return path


def test_one_file_is_a_btf(toy, file):
    btf = tm.load_btf(file)
    assert (btf.source.kind, len(btf), btf.height, btf.width) == ("toy", len(LIGHT), 8, 6)
    assert btf.source.files[3] == "image 3"
    assert np.array_equal(btf.image(7).numpy(), IMAGES[7].transpose(2, 0, 1))
    assert_close(btf.light, LIGHT, 1e-6)
    assert toy.opened == toy.closed == 1
    assert np.array_equal(tm.load_btf(file, kind="toy").image(7), btf.image(7))


def test_without_the_reader_the_file_is_no_btf(file):
    with pytest.raises(DataError, match="wool.npz: the data must tell its directions"):
        tm.load_btf(file)
    with pytest.raises(RangeError, match="kind must be one of 'manifest', 'rti', .*'ubo2003'.*; it is 'toy'"):
        tm.load_btf(file, kind="toy")


def test_only_the_window_is_asked_for(toy, file):
    whole = tm.load_btf(file)
    toy.asked.clear()
    part = tm.load_btf(file, crop=(2, 1, 4, 3))
    assert np.array_equal(part.image(5), whole.image(5)[:, 2:6, 1:4])
    assert {(rows.start, rows.stop, columns.start, columns.stop) for _, rows, columns in toy.asked} == {(2, 6, 1, 4)}
    assert sorted(sample for samples, _, _ in toy.asked for sample in samples) == list(range(len(LIGHT)))


def test_shrinking_and_choosing_work_on_it(toy, file):
    small = tm.load_btf(file, downscale=2)
    mean = IMAGES[4].reshape(4, 2, 3, 2, 3).mean(axis=(1, 3)).transpose(2, 0, 1)
    assert_close(small.image(4), mean, 1e-6)
    chosen = tm.load_btf(file, lights=[0, 2], views=[1])
    assert len(chosen) == 2 and len(chosen.views) == 1
    rows = [i for i in range(len(LIGHT)) if np.allclose(VIEW[i], chosen.views[0].numpy(), atol=1e-6)]
    assert [int(name.split()[1]) for name in chosen.source.files] == [
        i for i in rows if any(np.allclose(LIGHT[i], light, atol=1e-6) for light in chosen.lights.numpy())
    ]


@pytest.mark.parametrize("dtype", ["uint8", "uint16"])
def test_codes_are_srgb_unless_told_otherwise(toy, tmp_path, dtype):
    full = np.iinfo(dtype).max
    file = put_npz(tmp_path / "codes.npz", np.full((len(LIGHT), 2, 2, 3), full // 2, dtype))
    linear = float(np.float32(full // 2 / full))
    assert_close(tm.load_btf(file, encoding="linear").image(0), np.full((3, 2, 2), linear), 1e-6)
    assert float(tm.load_btf(file).image(0).max()) == pytest.approx(((linear + 0.055) / 1.055) ** 2.4, rel=1e-5)


def test_the_second_load_comes_from_the_cache_until_the_file_or_the_reader_changes(toy, file):
    assert not tm.load_btf(file).source.from_cache
    again = tm.load_btf(file)
    assert again.source.from_cache and again.source.kind == "toy" and toy.opened == 1
    _swapped(toy, version=2)
    assert not tm.load_btf(file).source.from_cache
    _swapped(toy)
    put_npz(file, IMAGES * 0.5)
    changed = tm.load_btf(file)
    assert not changed.source.from_cache
    assert np.array_equal(changed.image(0), again.image(0) * 0.5)


def test_it_is_fitted_and_described_as_a_folder_is(toy, file, tmp_path, capsys):
    from_tensors = tm.Btf.from_tensors(IMAGES.transpose(0, 3, 1, 2), LIGHT, VIEW)
    fits = [tm.fit(btf, "lambert", holdout=0.25, progress=False) for btf in (tm.load_btf(file), from_tensors)]
    assert fits[0].report["held_out"] == fits[1].report["held_out"]
    assert main(["info", str(file), "--no-plot"]) == 0
    said = capsys.readouterr().out
    assert "toy" in said and f"{len(LIGHT)} of" in said
    config = tmp_path / "fit.toml"
    config.write_text('model = "lambert"\n[data]\nkind = "toy"\ncrop = [0, 0, 4, 4]\n')
    assert main(["fit", str(config), "--data", str(file), "--out", str(tmp_path / "out"), "--no-pictures"]) == 0
    assert tm.load_material(tmp_path / "out").size == (4, 4)


def test_folders_and_zips_are_read_as_before(toy, tmp_path):
    folder = put_btf(tmp_path / "d")
    assert [tm.load_btf(path).source.kind for path in (folder, zipped(folder))] == ["manifest", "manifest"]
    with pytest.raises(DataError, match="d: the path must be a file for kind 'toy'; it is a folder"):
        tm.load_btf(folder, kind="toy")
    (tmp_path / "a.xyz").write_text("x")
    with pytest.raises(DataError, match="a.xyz: the path must be a folder or a zip, or a file of kind brdf, ubo2014, neuralbtf, toy"):
        tm.load_btf(tmp_path / "a.xyz")


def test_a_reader_of_folders(tmp_path):
    def listing(source):
        light = torch.tensor([[0.0, 0.0, 1.0]])
        return Listing("", tuple(name for name in source.names if name.endswith("only.png")), light, light)

    def sniff(source):
        return any(name.endswith("only.png") for name in source.names)

    put_btf(tmp_path / "d")
    (tmp_path / "d" / "manifest.csv").unlink()
    (tmp_path / "d" / "0.png").rename(tmp_path / "d" / "only.png")
    register_reader(Reader("single", "one image", sniff, listing, images_of_files))
    try:
        for path in (tmp_path / "d", zipped(tmp_path / "d")):
            found = tm.load_btf(path, kind="single" if path.suffix else None)
            assert (found.source.kind, len(found), found.height, found.width) == ("single", 1, 3, 4)
    finally:
        unregister_reader("single")


def test_an_array_like_thing_is_enough():
    asked = []

    class Sliced:
        shape, dtype = (5, 4, 3, 3), np.dtype(np.float32)

        def __getitem__(self, key):
            asked.append(key)
            return np.zeros((2, 1, 3, 3), np.float32)

    pixels = Pixels.of(Sliced())
    assert pixels.shape == (4, 3, 3) and not pixels.parallel
    pixels.read(range(1, 3), slice(2, 3), slice(0, 3))
    assert asked == [(slice(1, 3), slice(2, 3), slice(0, 3))]


def test_names_are_taken_once_and_parts_are_asked_for(toy):
    with pytest.raises(RangeError, match="the reader's name must be new; 'toy' is taken"):
        register_reader(toy.reader)
    with pytest.raises(RangeError, match="'rti' is taken"):
        register_reader(dataclasses.replace(toy.reader, name="rti"))
    with pytest.raises(RangeError, match="Reader bare: pixels must be a function; it is None. Give pixels"):
        Reader("bare", "", toy.sniff, toy.listing)
    with pytest.raises(RangeError, match="Reader bare: sniff must be a function"):
        Reader("bare", "")
    with pytest.raises(RangeError, match="name must be a word; it is 'a b'"):
        Reader("a b", "", toy.sniff, toy.listing, toy.pixels)
    with pytest.raises(RangeError, match="reader must be a Reader; it is Toy"):
        register_reader(toy)
    with pytest.raises(RangeError, match="name must be one of .*; it is 'tot'. Did you mean 'toy'?"):
        unregister_reader("tot")


def _raises(*_):
    raise KeyError("ground_light")


def _swapped(toy, **parts):
    READERS["toy"] = dataclasses.replace(toy.reader, **parts)


@pytest.mark.parametrize("part", ["sniff", "listing", "pixels"])
def test_what_a_reader_raises_names_the_file_and_the_reader(toy, file, part):
    _swapped(toy, **{part: _raises})
    with pytest.raises(DataError, match="wool.npz: the data, as the reader 'toy' takes it, must be readable; KeyError"):
        tm.load_btf(file)


def _pixels(**changed):
    """Return a `pixels` whose promise or whose images differ from the file's."""

    def pixels(source, listing):
        return dataclasses.replace(Pixels.of(IMAGES), **changed)

    return pixels


@pytest.mark.parametrize("pixels, words", [
    (lambda *_: IMAGES, "its pixels must be Pixels; they are ndarray"),
    (_pixels(dtype=np.dtype("int32")), "its pixels must be images .* of int32"),
    (_pixels(dtype=np.dtype(">f4")), "its pixels must be images"),
    (_pixels(shape=(8, 6)), "its pixels must be images"),
    (_pixels(shape=(8, 6, 5)), "image 0: the image must have 1 to 4 channels"),
    (_pixels(shape=(8, 5, 3), read=lambda s, r, c: IMAGES[s.start : s.stop]), "image 1 is .8, 6, 3. of float32"),
    (_pixels(read=lambda s, r, c: IMAGES[s.start : s.stop].astype(float)), "image 1 is .8, 6, 3. of float64"),
    (_pixels(read=lambda s, r, c: IMAGES[:3]), "be 20 images .* 3 came"),
    (_pixels(read=lambda s, r, c: IMAGES[[*range(len(IMAGES)), 0]]), "image 21 is"),
    (_pixels(read=_raises), "must be readable; KeyError"),
])
def test_what_a_reader_promises_is_held_against_what_it_gives(toy, file, pixels, words):
    _swapped(toy, pixels=pixels)
    before = threading.active_count()
    with pytest.raises((DataError, tm.ShapeError), match=words):
        tm.load_btf(file)
    assert threading.active_count() <= before


@pytest.mark.parametrize("change, words", [
    (lambda found: None, "its listing must be a Listing; it is NoneType"),
    (lambda found: dataclasses.replace(found, light=found.light[:2]), "light .2, 3. and view .20, 3."),
    (lambda found: dataclasses.replace(found, files=()), "it has 0 names"),
    (lambda found: dataclasses.replace(found, light=found.light * 2), "image 0: the light direction must be a unit vector"),
])
def test_a_listing_that_does_not_fit_together(toy, file, change, words):
    _swapped(toy, listing=lambda source: change(toy.listing(source)))
    with pytest.raises(DataError, match=words):
        tm.load_btf(file)


def test_the_example_of_the_page_runs_as_it_stands(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    np.savez("wool.npz", light=LIGHT, view=VIEW, images=IMAGES)
    page = (Path(tm.__file__).parent / "btf" / "README.md").read_text("utf-8")
    room = {}
    try:
        exec(page.split("```python\n")[1].split("```")[0], room)  # noqa: S102
        assert np.array_equal(room["btf"].image(3).numpy(), IMAGES[3, :4, :4].transpose(2, 0, 1))
    finally:
        unregister_reader("stack")
