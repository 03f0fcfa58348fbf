"""Files that are damaged, lie, or are something else: always a DataError that names the file, and never much memory."""

from __future__ import annotations

import struct
import tracemalloc
import zipfile

import numpy as np
import pytest
import torch
from tests.brdf.files import merl_bytes, rgl_fields, tensor_bytes, write_tensor_file

from torchmat import load_brdf
from torchmat.brdf import MerlBrdf, RglBrdf, brdf_kind, read_merl, read_rgl
from torchmat.brdf.tensor_file import TensorFile
from torchmat.errors import DataError

MERL = merl_bytes(np.random.default_rng(0).uniform(0, 1, (3, 3, 4, 5)))
RGL = tensor_bytes(rgl_fields())


def refused(path, content: bytes, words: str | None = None) -> str:
    """Write `content`, assert that reading it names the file and takes little memory, and return the message."""
    path.write_bytes(content)
    tracemalloc.start()
    try:
        with pytest.raises(DataError, match=words) as caught:
            load_brdf(path)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert str(caught.value).startswith(f"{path}: ")
    assert peak < 200_000 + 20 * len(content)
    return str(caught.value)


def test_kinds_are_told_apart_by_content_and_not_by_name(tmp_path):
    path = tmp_path / "whatever.dat"
    path.write_bytes(MERL)
    assert brdf_kind(path) == "merl" and isinstance(load_brdf(path), MerlBrdf)
    path = tmp_path / "misnamed.binary"
    path.write_bytes(RGL)
    assert brdf_kind(path) == "rgl" and isinstance(load_brdf(path), RglBrdf)
    path.write_bytes(b"a text")
    assert brdf_kind(path) is None and brdf_kind(tmp_path) is None and brdf_kind(tmp_path / "no\0ne") is None


@pytest.mark.parametrize("name", ["Grüße und Küsse.binary", "two words.bsdf"])
def test_case_18_names_with_spaces_and_other_letters(tmp_path, name):
    path = tmp_path / name
    path.write_bytes(MERL if name.endswith("binary") else RGL)
    assert load_brdf(str(path)).isotropic
    assert name in refused(path, b"")


@pytest.mark.parametrize("name", ["x.binary", "x.bsdf", "x.txt"])
def test_case_11_text_and_empty_files(tmp_path, name):
    text = b"this is no table but a text of some length\n" * 20
    for content in (b"", b"\n", text, b"\xef\xbb\xbfa,b,c\r\n", bytes(5000)):
        refused(tmp_path / name, content)


def test_what_is_no_file_is_refused(tmp_path):
    for path in (tmp_path / "absent.binary", tmp_path / "absent.bsdf", tmp_path):
        with pytest.raises(DataError, match="there is no such file") as caught:
            load_brdf(path)
        assert str(path) in str(caught.value)
    for read in (read_merl, read_rgl):
        with pytest.raises(DataError, match="absent"):
            read(tmp_path / "absent")


def test_a_device_that_never_ends_is_not_searched_for_an_archive(tmp_path, monkeypatch):
    (tmp_path / "a.zip").symlink_to("/dev/zero")
    monkeypatch.setattr(zipfile, "is_zipfile", lambda path: pytest.fail("it would read for ever"))
    with pytest.raises(DataError, match=r"a\.zip.*there is no such file"):
        load_brdf(tmp_path / "a.zip")


@pytest.mark.parametrize("name, content", [("x.binary", MERL), ("x.bsdf", RGL)])
def test_case_11_truncated_at_many_lengths(tmp_path, name, content):
    lengths = {*range(0, min(600, len(content)), 7), *range(600, len(content), 331), len(content) - 1}
    for length in sorted(lengths):
        refused(tmp_path / name, content[:length])


def test_a_longer_table_is_not_the_one_that_was_promised(tmp_path):
    refused(tmp_path / "x.binary", MERL + b"\0", "have the size that its head promises; 3 x 4 x 5 entries take 1452")


@pytest.mark.parametrize(
    "sizes",
    [
        (0, 4, 5), (-3, 4, 5), (-3, -4, 5), (3, 4, 6), (90, 90, 180), (2**31 - 1, 1, 1), (2**31 - 1,) * 3,
        (-(2**31),) * 3,
    ],
)
def test_heads_of_tables_that_lie(tmp_path, sizes):
    refused(tmp_path / "x.binary", struct.pack("<3i", *sizes) + MERL[12:])


def test_sizes_whose_product_overflows(tmp_path):
    refused(tmp_path / "x.binary", struct.pack("<3i", 65536, 65536, 1))  # 0 in 32 bits, as the file then holds


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e300])
def test_tables_that_are_not_finite(tmp_path, value):
    table = np.ones((3, 2, 2, 2))
    table[1, 1, 0, 1] = value
    refused(tmp_path / "x.binary", merl_bytes(table), "fit torch.float32" if value == 1e300 else "1 of 8 entries")


def changed(place: int, layout: str, value: int) -> bytes:
    """Return the made-up RGL file with one number of its head overwritten."""
    content = bytearray(RGL)
    struct.pack_into(layout, content, place, value)
    return bytes(content)


def head_places() -> dict[str, tuple[int, str]]:
    """Return (place, layout) of each number in the head of the first field and the one called vndf."""
    found = {"version": (12, "<B"), "count": (14, "<I"), "name_length": (18, "<H")}
    at = RGL.index(b"vndf") + 4
    found |= {"dimensions": (at, "<H"), "type": (at + 2, "<B"), "offset": (at + 3, "<Q")}
    return found | {f"size_{k}": (at + 11 + 8 * k, "<Q") for k in range(4)}


@pytest.mark.parametrize("number", head_places())
def test_heads_of_tensor_files_that_lie(tmp_path, number):
    place, layout = head_places()[number]
    limit = 256 ** struct.calcsize(layout)
    before = struct.unpack_from(layout, RGL, place)[0]
    for value in {0, 1, limit - 1, limit // 2, limit // 2 - 1, len(RGL), len(RGL) + 1} - {before}:
        if number == "offset" and value < len(RGL) // 4:
            continue  # there the array is inside the file, and holds other numbers
        refused(tmp_path / "x.bsdf", changed(place, layout, value % limit))


def test_any_byte_of_the_head_may_be_wrong(tmp_path):
    """A flipped byte is refused, or leaves a BRDF that shades: it never ends in another error."""
    intact = TensorFile(write_tensor_file(tmp_path / "intact.bsdf", rgl_fields()))
    head_end = min(field.offset for field in intact.fields.values())
    pole = torch.tensor([0.0, 0.0, 1.0])[:, None, None]
    refusals = 0
    for place in range(0, head_end, 3):
        for flip in (0x01, 0x80, 0xFF):
            content = bytearray(RGL)
            content[place] ^= flip
            (tmp_path / "x.bsdf").write_bytes(bytes(content))
            try:
                assert bool(torch.isfinite(load_brdf(tmp_path / "x.bsdf").shade(pole, pole)).all())
            except DataError as error:
                refusals += 1
                assert "x.bsdf" in str(error)
    assert refusals > head_end / 3


def test_fields_that_lie_on_each_other_or_twice(tmp_path):
    twice = RGL.replace(b"sigma", b"phi_i")
    refused(tmp_path / "x.bsdf", twice, "field 'phi_i' must occur once")


@pytest.mark.parametrize("name", ["theta_i", "phi_i", "ndf", "sigma", "vndf", "rgb", "jacobian"])
def test_a_field_that_is_missing_or_of_another_kind(tmp_path, name):
    fields = rgl_fields()
    refused(tmp_path / "x.bsdf", tensor_bytes({k: v for k, v in fields.items() if k != name}), "field")
    other = fields[name].astype(np.int32)
    refused(tmp_path / "x.bsdf", tensor_bytes({**fields, name: other}), f"field '{name}'")
    refused(tmp_path / "x.bsdf", tensor_bytes({**fields, name: fields[name][None]}), f"field '{name}'")


@pytest.mark.parametrize("name", ["luminance", "description"])
def test_a_field_that_is_not_needed_may_be_missing(tmp_path, name):
    path = write_tensor_file(tmp_path / "x.bsdf", {k: v for k, v in rgl_fields().items() if k != name})
    assert load_brdf(path).isotropic


@pytest.mark.parametrize(
    "name, value, words",
    [
        ("theta_i", [0, 0.9, 0.4, 1.57], "field 'theta_i' must be finite and increasing"),
        ("theta_i", [0, 0.4, np.nan, 1.57], "field 'theta_i' must be finite and increasing"),
        ("theta_i", [0, 0.4, 0.9], "the fields must fit together"),
        ("ndf", [[1, np.inf], [1, 1]], "field 'ndf' must be finite and at least 0; 1 of 4"),
        ("sigma", [[1, -1], [1, 1]], r"field 'sigma' must be finite and at least 0; 1 of 4 .* first at index \(0, 1\)"),
        ("ndf", [[1, 1]], "the fields must fit together"),
        ("rgb", np.ones((1, 4, 2, 4, 4)), "the fields must fit together"),
        ("vndf", np.ones((2, 4, 4, 4)), "the fields must fit together"),
    ],
)
def test_numbers_that_are_wrong(tmp_path, name, value, words):
    refused(tmp_path / "x.bsdf", tensor_bytes({**rgl_fields(), name: np.array(value, np.float32)}), words)


@pytest.mark.parametrize(
    "wavelengths, planes, words",
    [
        ([500, 600, 700, 800], 3, "field 'spectra' must have a plane per wavelength"),
        ([500, 400, 600], 3, "field 'wavelengths' must be finite and increasing"),
        ([500, 600], 2, "field 'wavelengths' must cover visible light; there are 2 wavelengths"),
        ([900, 950, 1000], 3, "field 'wavelengths' must cover visible light"),
    ],
)
def test_spectra_that_give_no_colour(tmp_path, wavelengths, planes, words):
    fields = {k: v for k, v in rgl_fields().items() if k != "rgb"}
    fields |= {"wavelengths": np.array(wavelengths, np.float32), "spectra": np.ones((1, 4, planes, 4, 4), np.float32)}
    refused(tmp_path / "x.bsdf", tensor_bytes(fields), words)
    if words.startswith("field 'spectra'"):
        fields |= {"wavelengths": np.array([450, 550, 650], np.float32)}
        fields["spectra"][0, 1, 2, 3, 3] = np.nan
        refused(tmp_path / "x.bsdf", tensor_bytes(fields), "field 'spectra' must be finite")


def test_anisotropic_azimuths_that_do_not_divide_a_turn(tmp_path):
    fields = rgl_fields(azimuths=5)
    fields["phi_i"] = np.linspace(0, 0.01, 5, dtype=np.float32)
    refused(tmp_path / "x.bsdf", tensor_bytes(fields), "the fields must fit together; rgl: azimuths must span a turn")
