"""What the fuzzer found, each as its smallest input; and one content in many forms, which must read as one."""

from __future__ import annotations

import json
import struct
import zipfile

import numpy as np
import pytest
import torch
from tests.brdf.files import rgl_fields, tensor_bytes
from tests.btf.files import ANGLES, HEADER, members_of, put_btf, put_image, put_manifest, random_codes, zip_of
from tests.hard_cases.fuzz_readers import BY_NAME
from tests.models.distributions import distribution
from tests.rendering.mesh_files import SQUARE, SQUARE_UV, TWO, glb_of, put_obj, put_ply, put_stl
from tests.support import assert_close

from torchmat import DataError, RangeError, load_brdf, load_btf, load_config, load_material
from torchmat.brdf import AnalyticBrdf, brdf_kind, is_brdf_file
from torchmat.btf.light_table import read_lights
from torchmat.btf.photographs import read_linear
from torchmat.btf.readers import open_source
from torchmat.errors import message
from torchmat.geometry.height_file import load_height
from torchmat.images import read_image, write_image
from torchmat.material_io.folder import check_target
from torchmat.material_io.packing import DESCRIPTION, pack, unpack
from torchmat.rendering.mesh import load_mesh
from torchmat.report.describe import is_material
from torchmat.text_file import read_json, read_text

DEEP = "[" * 100_000


def good(name, folder):
    """Return what to read of the fuzzer's good input."""
    folder.mkdir(exist_ok=True)
    return BY_NAME[name].put(folder)


# What was found


def test_a_device_without_an_end_is_no_archive(tmp_path):
    (tmp_path / "d.zip").symlink_to("/dev/zero")
    with pytest.raises(DataError, match=r"d\.zip: the path must be a folder or a zip; it is a device or a pipe"):
        load_btf(tmp_path / "d.zip")


@pytest.mark.parametrize("read", [read_text, lambda path: read_json(path, "a", "b"), lambda path: read_lights(path, 3)])
def test_a_device_without_an_end_is_no_text(tmp_path, read):
    (tmp_path / "a.txt").symlink_to("/dev/zero")
    with pytest.raises(DataError, match=r"a\.txt: .+ must be a small file; it holds more than 32 MB"):
        read(tmp_path / "a.txt")


def test_a_table_that_is_far_too_long(tmp_path):
    folder = put_btf(tmp_path / "d")
    with open(folder / "manifest.csv", "r+b") as stream:
        stream.truncate(32_000_001)
    with pytest.raises(DataError, match=r"manifest\.csv: the text must be a small file"):
        load_btf(folder)


def test_a_table_that_unpacks_to_far_too_much(tmp_path):
    archive = zip_of(tmp_path / "d.zip", members_of(put_btf(tmp_path / "d")) | {"manifest.csv": b"a"})
    data = archive.read_bytes()
    at = data.rindex(b"PK\x01\x02", 0, data.rindex(b"manifest.csv"))
    archive.write_bytes(data[: at + 24] + struct.pack("<I", 32_000_001) + data[at + 28 :])
    with pytest.raises(DataError, match=r"manifest\.csv: the text must be a small file"):
        load_btf(archive)


@pytest.mark.filterwarnings("ignore:Duplicate name")
@pytest.mark.parametrize("twin", ["sub/1.png", "sub\\1.png"])
def test_a_name_that_stands_twice_in_an_archive(tmp_path, twin):
    members = {f"sub/{name}": data for name, data in members_of(put_btf(tmp_path / "d")).items()}
    archive = zip_of(tmp_path / "d.zip", members)
    with zipfile.ZipFile(archive, "a") as twice:
        twice.writestr(twin, members["sub/0.png"])
    with pytest.raises(DataError, match=r"d\.zip: sub/1\.png: the name must be that of one file; it stands"):
        load_btf(archive)


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_a_folder_that_stands_twice_in_an_archive_is_harmless(tmp_path):
    archive = zip_of(tmp_path / "d.zip", members_of(put_btf(tmp_path / "d")))
    with zipfile.ZipFile(archive, "a") as twice:
        for _ in range(2):
            twice.writestr("sub/", b"")
    assert len(load_btf(archive)) == 4


def test_a_large_member_is_unpacked_piece_by_piece(tmp_path):
    content = np.random.default_rng(0).bytes(3_000_000)
    source = open_source(zip_of(tmp_path / "d.zip", {"a.bin": content}))
    with source.file("a.bin") as path:
        assert path.read_bytes() == content
    pieces = [len(piece) for piece in source._pieces("a.bin")]
    source.close()
    assert max(pieces) <= 2**20 and sum(pieces) == len(content)


@pytest.mark.parametrize("place", ["name of a channel", "name of an attribute"])
def test_an_exr_with_a_name_that_is_not_utf_8(tmp_path, place):
    path = put_image(tmp_path / "a.exr", random_codes(0, dtype="float16"))
    data = bytearray(path.read_bytes())
    data[data.index(b"channels\0chlist\0") + (20 if place == "name of a channel" else 0)] = 0xFF
    path.write_bytes(bytes(data))
    words = "channels must include" if place == "name of a channel" else "the image must be readable"
    with pytest.raises(DataError, match=rf"a\.exr: {words}") as caught:
        read_image(path)
    str(caught.value).encode()


@pytest.mark.parametrize("names", [("R", "G", "X"), ("B", "Depth", "R", "A"), ("A", "B", "G")])
def test_an_exr_that_lost_the_name_of_a_colour(tmp_path, names):
    path = tmp_path / "a.exr"
    write_image(path, random_codes(0, (2, 2, len(names)), "float16"), names)
    with pytest.raises(DataError, match=r"a\.exr: channels must include R, G and B, or none of them; they are"):
        read_image(path)


@pytest.mark.parametrize(
    "names", [("R", "G", "B"), ("X", "Y", "Z"), ("R", "G"), ("R", "G", "B", "A"), ("left.R", "left.G", "left.B")]
)
def test_an_exr_with_names_that_are_whole(tmp_path, names):
    pixels = random_codes(0, (2, 2, len(names)), "float16")
    write_image(tmp_path / "a.exr", pixels, names)
    found = read_image(tmp_path / "a.exr")
    assert sorted(found.flatten()) == sorted(pixels.flatten()) and found.shape == pixels.shape


@pytest.mark.parametrize("text", [DEEP, "[]", "1", "9" * 5000, "\0", ""])
def test_json_that_is_no_table(tmp_path, text):
    path = tmp_path / "a.json"
    path.write_text(text)
    with pytest.raises(DataError, match=r"a\.json: the table must be there; "):
        read_json(path, "the table", "be there")


@pytest.mark.parametrize("text", [DEEP, '{"height_low": 1' + "0" * 400 + ', "height_high": 1}'])
def test_a_relief_described_by_numbers_that_are_none(tmp_path, text):
    folder = good("height, folder", tmp_path / "d")
    (folder / "relief.json").write_text(text)
    with pytest.raises(DataError, match=r"relief\.json: the relief must be described"):
        load_height(folder)


@pytest.mark.parametrize(("low", "high"), [(1, 0), (float("nan"), 1), (0, float("inf")), (-1.7e308, 1.7e308)])
def test_a_relief_whose_range_runs_downward_or_nowhere(tmp_path, low, high):
    folder = good("height, folder", tmp_path / "d")
    (folder / "relief.json").write_text(json.dumps({"height_low": low, "height_high": high}))
    with pytest.raises(DataError, match=r"relief\.json: the range must be finite and run upward"):
        load_height(folder)


@pytest.mark.parametrize("change", [DEEP, {"channels": []}, {"low": 10**400}])
def test_a_packed_material_described_by_nonsense(tmp_path, change):
    folder = pack(distribution(4, 4, lobes=0, parts=()), tmp_path / "packed")
    described = json.loads((folder / DESCRIPTION).read_text())
    if isinstance(change, dict):
        entry = described["textures"][0]
        (entry if "channels" in change else entry["channels"][0]).update(change)
    (folder / DESCRIPTION).write_text(change if isinstance(change, str) else json.dumps(described))
    with pytest.raises(DataError, match=r"packed"):
        unpack(folder)


def test_an_error_does_not_repeat_a_whole_file(tmp_path):
    folder = good(".lp", tmp_path / "d")
    (folder / "dirs.lp").write_bytes(b"\0" * 1_000_000)
    with pytest.raises(DataError, match=r"dirs\.lp: line 1: the line must hold a name and x y z") as caught:
        load_btf(folder)
    assert len(str(caught.value)) < 2000
    assert message("a", "b", "be", "x" * 600, "Go.") == f"a: b must be; {'x' * 600}. Go."
    assert message("a", "b", "be", "x" * 300 + "y" * 9_000) == f"a: b must be; {'x' * 300} ... {'y' * 150}."


@pytest.mark.parametrize("name", ["lights.gz", "lights.bz2"])
def test_lights_are_never_unpacked(tmp_path, name):
    import gzip

    (tmp_path / name).write_bytes(gzip.compress(b"0 0 1\n" * 3))
    with pytest.raises(DataError, match="lights"):
        read_lights(tmp_path / name, 3)


@pytest.mark.parametrize("last", [1e4, 3e38, -1e4])
def test_a_logarithm_that_has_no_number(tmp_path, last):
    folder = good("material, shading map", tmp_path / "d")
    path = folder / "manifest.json"
    manifest = json.loads(path.read_text("utf-8"))
    manifest["constants"]["lobe"][-1] = last
    path.write_text(json.dumps(manifest), encoding="utf-8")
    with pytest.raises(DataError, match=r"manifest\.json: .*exponent must lie in .*; it is (inf|0)"):
        load_material(folder)


@pytest.mark.parametrize("number", [10**400, "a", None])
def test_a_parameter_that_is_no_number(number):
    with pytest.raises(RangeError, match="exponent must be numbers"):
        AnalyticBrdf("phong", exponent=number)


def test_a_bit_of_a_cached_image_is_not_lost(tmp_path):
    folder = good("store in the cache", tmp_path / "d")
    (raw,) = (folder / "cache").rglob("pixels.raw")
    read = BY_NAME["store in the cache"].read
    wanted = read(folder)[0]
    for place in range(raw.stat().st_size):
        data = bytearray(raw.read_bytes())
        data[place] ^= 1
        raw.write_bytes(bytes(data))
        assert torch.equal(read(folder)[0], wanted)
        assert raw.read_bytes() != bytes(data)


@pytest.mark.parametrize("name", ["header.json", "table.npz", "pixels.raw"])
def test_a_store_with_a_device_without_an_end(tmp_path, name):
    folder = good("store in the cache", tmp_path / "d")
    (path,) = (folder / "cache").rglob(name)
    path.unlink()
    path.symlink_to("/dev/zero")
    assert len(BY_NAME["store in the cache"].read(folder)[0]) == 4
    assert not path.is_symlink()


@pytest.mark.parametrize("far", [1e308, 1e200, 1e-200, 1e-308])
def test_lights_of_any_length(tmp_path, far):
    (tmp_path / "a.txt").write_text(f"0 0 {far}\n{0.6 * far} 0 {0.8 * far}\n")
    assert_close(read_lights(tmp_path / "a.txt", 2), torch.tensor([[0, 0, 1], [0.6, 0, 0.8]]), 1e-6)


LONG = "a" * 300


@pytest.mark.parametrize("suffix", ["", ".csv", ".3pm", ".bsdf", ".obj", ".png"])
@pytest.mark.parametrize(
    "read", [load_btf, load_brdf, load_mesh, read_image, load_height, unpack, read_text, read_linear]
)
def test_a_name_that_is_too_long(read, suffix):
    with pytest.raises(DataError, match="a{300}"):
        read(LONG + suffix)


def test_a_target_with_a_name_that_no_file_can_have(tmp_path):
    material = distribution(4, 4, lobes=0, parts=())
    for name in (LONG, "a\0b"):
        with pytest.raises(DataError, match=r"the folder must be writable"):
            pack(material, tmp_path / name)


@pytest.mark.parametrize("name", [LONG, LONG + ".3pm", "a\0b"])
def test_asking_what_a_name_is_never_fails(name):
    assert not is_material(name) and not is_brdf_file(name) and brdf_kind(name) is None


def _lost_number(manifest):
    manifest["textures"][0]["low"][0] = 10**400


def _long_file(manifest):
    manifest["textures"][0]["file"] = LONG + ".png"


@pytest.mark.parametrize("read", [load_material, check_target])
def test_a_material_described_by_brackets(tmp_path, read):
    folder = good("material, png8", tmp_path / "d")
    (folder / "manifest.json").write_text(DEEP)
    with pytest.raises(DataError, match="d"):
        read(folder)


def _no_textures(manifest):
    manifest["textures"] = 5
    manifest["model"] = "none"


@pytest.mark.parametrize("change", [_lost_number, _long_file, _no_textures])
def test_a_material_described_by_numbers_and_names_that_are_none(tmp_path, change):
    folder = good("material, png8", tmp_path / "d")
    path = folder / "manifest.json"
    manifest = json.loads(path.read_text("utf-8"))
    change(manifest)
    path.write_text(json.dumps(manifest), encoding="utf-8")
    with pytest.raises(DataError, match=r"d/"):
        load_material(folder)


@pytest.mark.parametrize("text", ["seed = " + "9" * 5000, "data = " + "[" * 5000, "data = " + "{a=" * 5000])
def test_a_config_that_is_too_much_for_the_parser(tmp_path, text):
    (tmp_path / "a.toml").write_text(text)
    with pytest.raises(DataError, match=r"a\.toml"):
        load_config(tmp_path / "a.toml")


def test_a_config_with_a_name_that_no_file_can_have():
    with pytest.raises(DataError, match=r"the config must be readable"):
        load_config("a\0b.toml")


# One content in many forms


@pytest.mark.parametrize("attributes", [
    {"compression": "none"}, {"compression": "rle"}, {"compression": "zips"}, {"compression": "piz"},
    {"openexr:lineOrder": "decreasingY"}, {"oiio:ColorSpace": "scene_linear"}, {"Make": "n" * 100_000},
])
def test_an_exr_however_it_is_written(tmp_path, attributes):
    pixels = random_codes(3, (9, 7, 3), "float16")
    assert np.array_equal(read_image(put_image(tmp_path / "a.exr", pixels, **attributes)), pixels)


@pytest.mark.parametrize("attributes", [
    {"compression": "none"}, {"compression": "lzw"}, {"compression": "zip"}, {"tiff:planarconfig": "separate"},
    {"tiff:RowsPerStrip": 1}, {"tiff:bigtiff": 1},
])
def test_a_tiff_however_it_is_written(tmp_path, attributes):
    pixels = random_codes(3, (9, 7, 3), "uint16")
    assert np.array_equal(read_image(put_image(tmp_path / "a.tif", pixels, **attributes)), pixels)


@pytest.mark.parametrize("suffix", ["tif", "bmp", "tga", "ppm"])
def test_a_picture_in_any_format(tmp_path, suffix):
    pixels = random_codes(3, (5, 7, 3))
    wanted = read_linear(put_image(tmp_path / "a.png", pixels))
    assert torch.equal(read_linear(put_image(tmp_path / f"a.{suffix}", pixels)), wanted)


def test_fields_of_a_tensor_file_in_any_order(tmp_path):
    fields = rgl_fields(5)
    paths = tmp_path / "a.bsdf", tmp_path / "b.bsdf"
    for path, names in zip(paths, (list(fields), sorted(fields, reverse=True)), strict=True):
        path.write_bytes(tensor_bytes({name: fields[name] for name in names}))
    read = BY_NAME[".bsdf, anisotropic"].read
    assert torch.equal(read(paths[0])[0], read(paths[1])[0])
    # What is not needed may be lost, what is needed may not.
    for name in fields:
        paths[1].write_bytes(tensor_bytes({other: fields[other] for other in fields if other != name}))
        if name in ("description", "luminance"):
            assert torch.equal(read(paths[0])[0], read(paths[1])[0])
        else:
            with pytest.raises(DataError, match=rf"b\.bsdf: .*{'spectra' if name == 'rgb' else name}"):
                load_brdf(paths[1])


def test_a_manifest_without_any_one_of_its_columns(tmp_path):
    folder = put_manifest(put_btf(tmp_path / "d"))
    columns = HEADER.split(",")
    rows = [columns, *([f"{number}.png", *map(str, angles)] for number, angles in enumerate(ANGLES))]
    for lost in range(len(columns)):
        text = "\n".join(",".join(row[:lost] + row[lost + 1 :]) for row in rows)
        (folder / "manifest.csv").write_text(text)
        with pytest.raises(DataError, match=rf"manifest\.csv: .*{columns[lost]}"):
            load_btf(folder)


@pytest.mark.parametrize("kind", ["obj", "ply", "ply_ascii", "stl", "stl_ascii", "off", "glb"])
def test_a_mesh_in_any_format(tmp_path, kind):
    path = tmp_path / f"a.{kind.removesuffix('_ascii')}"
    if kind == "obj":
        put_obj(path, SQUARE, TWO, SQUARE_UV)
    elif kind.startswith("ply"):
        put_ply(path, SQUARE, TWO, SQUARE_UV, binary=kind == "ply")
    elif kind == "stl":
        put_stl(path, SQUARE, TWO)
    elif kind == "glb":
        path.write_bytes(glb_of([{"position": SQUARE, "faces": TWO, "uv": SQUARE_UV}], [{"mesh": 0}]))
    elif kind == "off":
        rows = [*SQUARE.astype(int).tolist(), *([3, *face] for face in TWO.tolist())]
        path.write_text("OFF\n4 2 0\n" + "\n".join(" ".join(map(str, row)) for row in rows) + "\n")
    else:
        corners = ("".join("vertex %g %g %g\n" % tuple(SQUARE[k]) for k in face) for face in TWO)
        facets = "".join(f"facet normal 0 0 0\nouter loop\n{each}endloop\nendfacet\n" for each in corners)
        path.write_text(f"solid a\n{facets}endsolid a\n")
    mesh = load_mesh(path)
    corner = mesh.position[mesh.faces].double()
    wanted = torch.from_numpy(SQUARE[TWO])
    assert torch.equal(corner, wanted)
    slope = torch.tensor([-(0.5**0.5), 0.0, 0.5**0.5], dtype=torch.float64)
    assert_close(mesh.normal.double(), slope.expand(len(mesh.normal), 3), 1e-6)


@pytest.mark.parametrize("big", [False, True])
def test_a_ply_of_either_byte_order(tmp_path, big):
    path = put_ply(tmp_path / "a.ply", SQUARE, TWO, binary=True)
    if big:
        head, body = path.read_bytes().split(b"end_header\n")
        body = np.frombuffer(body[:48], "<f4").astype(">f4").tobytes()
        body += b"".join(struct.pack(">B3i", 3, *face) for face in TWO)
        path.write_bytes(head.replace(b"little", b"big") + b"end_header\n" + body)
    assert torch.equal(load_mesh(path).position[load_mesh(path).faces].double(), torch.from_numpy(SQUARE[TWO]))


def test_keys_of_a_material_in_any_order(tmp_path):
    folder = good("material, distribution", tmp_path / "d")
    before = load_material(folder)
    path = folder / "manifest.json"
    manifest = json.loads(path.read_text("utf-8"))
    path.write_text(json.dumps(dict(sorted(manifest.items(), reverse=True))), encoding="utf-8-sig")
    after = load_material(folder)
    assert all(torch.equal(before.maps[name], after.maps[name]) for name in before.maps)


def test_numbers_of_a_material_mean_what_they_say(tmp_path):
    folder = good("material, png8", tmp_path / "d")
    before = load_material(folder).maps["albedo"]
    path = folder / "manifest.json"
    manifest = json.loads(path.read_text("utf-8"))
    entry = next(entry for entry in manifest["textures"] if entry["map"] == "albedo")
    entry["low"], entry["high"] = [2 * low for low in entry["low"]], [2 * high for high in entry["high"]]
    path.write_text(json.dumps(manifest), encoding="utf-8")
    assert_close(load_material(folder).maps["albedo"], 2 * before.detach(), 1e-6)
