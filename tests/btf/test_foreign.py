"""Files of other tools are named for what they are, with a way on."""

from __future__ import annotations

import pytest
from tests.btf.files import put_image, random_codes

from torchmat import DataError, load_btf


@pytest.mark.parametrize(
    "name, what, step",
    [
        ("coin.ptm", r"a fitted Polynomial Texture Map \(PTM\), not the photographs", "Give the photographs that it was made of, with their .lp"),
        ("coin.rti", "a fitted RTI file", "torchmat fit ptm --data PHOTOGRAPHS"),
        ("coin.relight", "a project of RelightLab", "Export the light positions from it as an .lp file"),
        ("IMG_0001.CR2", "a raw camera file", "Develop it, linearly if you can, into a 16-bit TIFF or EXR"),
        ("a.NEF", "a raw camera file", "--encoding linear"),
        ("a.dng", "a raw camera file", "dcraw"),
        ("a.arw", "a raw camera file", "dcraw"),
        ("felt.btf", "a BTF in one file", "manifest.csv"),
        ("felt.h5", "an HDF5 container", "register a reader"),
    ],
)
def test_by_itself_and_in_a_folder(tmp_path, name, what, step):
    path = tmp_path / "d" / name
    path.parent.mkdir()
    path.write_bytes(b"some bytes\n")
    with pytest.raises(DataError, match=f"{name}: the path must be photographs with their lights; it is {what}.*{step}"):
        load_btf(path)
    with pytest.raises(DataError, match=f"d: the data must tell its directions; .*{name} is {what}.*{step}"):
        load_btf(path.parent)


def test_pictures_beside_raw_files_are_the_photographs(tmp_path):
    for number in range(3):
        put_image(tmp_path / "d" / f"{number}.jpg", random_codes(number))
        (tmp_path / "d" / f"{number}.CR2").write_bytes(b"x")
    with pytest.raises(DataError, match="there are 6 files, 3 of them images. Add a manifest.csv .* give their lights: --lights TABLE, or --ball"):
        load_btf(tmp_path / "d")
    (tmp_path / "d" / "c.relight").write_bytes(b"x")
    with pytest.raises(DataError, match="there are 3 images, and c.relight is a project of RelightLab"):
        load_btf(tmp_path / "d")


def test_a_table_that_does_not_lie_beside_its_photographs(tmp_path):
    put_image(tmp_path / "d" / "Objects" / "a.png", random_codes(0))
    (tmp_path / "d" / "light_directions.txt").write_text("0 0 1\n")
    with pytest.raises(DataError, match="light_directions.txt: the table must lie beside its photographs; .*--lights light_directions.txt"):
        load_btf(tmp_path / "d")
    assert len(load_btf(tmp_path / "d" / "Objects", light_table=tmp_path / "d" / "light_directions.txt")) == 1
