"""BRDF files as a BTF of one texel: where they are asked, what comes out, packed files, and fits over the common road."""

from __future__ import annotations

import gzip
import json
import math
import zipfile

import numpy as np
import pytest
import torch
from tests.brdf.files import merl_bytes, rgl_fields, write_tensor_file
from tests.support import assert_close

import torchmat as tm
from torchmat import DataError
from torchmat.brdf import AnalyticBrdf, MerlBrdf, is_brdf_file, load_brdf, tabulate, write_merl
from torchmat.btf.brdf_file import hemispheres
from torchmat.cli import main

STORED = (1500.0, 1500.0 / 1.15, 1500.0 / 1.66)  # of f_r = 1 in red, green and blue (BRDFRead.cpp)


def even_merl(path, colour=(0.3, 0.2, 0.1)):
    """Write a small MERL file whose f_r is the same for all directions."""
    table = np.ones((3, 4, 4, 6)) * (np.array(colour) * STORED)[:, None, None, None]
    path.write_bytes(merl_bytes(table))
    return path


@pytest.mark.parametrize(("isotropic", "views"), [(True, 21), (False, 61)])
def test_where_a_brdf_is_asked(isotropic, views):
    light, view = hemispheres(isotropic)
    assert len(view.unique(dim=0)) == views and len(light) == len(view) == len(torch.cat((light, view), 1).unique(dim=0))
    for directions, lowest in ((light, 85), (view, 75)):
        assert_close(directions.norm(dim=1), torch.ones(len(light), dtype=torch.float64), 1e-12)
        assert float(directions[:, 2].min()) >= math.cos(math.radians(lowest)) - 1e-12
    again = hemispheres(isotropic)
    assert torch.equal(light, again[0]) and torch.equal(view, again[1])
    # Every view has lights within 0.1 degrees of its mirror direction, and the half vectors' angles grow with the square.
    half = torch.nn.functional.normalize(light + view, dim=1)
    angle = torch.rad2deg(torch.acos(half[:, 2].clamp(max=1)))
    for one in view.unique(dim=0):
        near = angle[(view == one).all(dim=1)].sort().values
        assert float(near[0]) < 0.1 and int((near < 5).sum()) >= 40
    wanted = 90 * ((torch.arange(4, dtype=torch.float64) + 0.5) / 24) ** 2
    assert_close(angle[:32:8], wanted, 1e-6)  # of the first view, along the normal


def test_merl_against_its_file(tmp_path):
    btf = tm.load_btf(even_merl(tmp_path / "paint.binary"), cache=False)
    assert (btf.source.kind, btf.height, btf.width, btf.encoding) == ("brdf", 1, 1, "linear")
    assert len(btf) == len(hemispheres(True)[0]) and btf.source.files[0].startswith("light 0.08 0.00 view 0 0.00")
    wanted = math.pi * torch.tensor([0.3, 0.2, 0.1]) * btf.light[:, 2:]
    assert_close(btf.images(range(len(btf)))[:, :, 0, 0], wanted, 1e-6)


def test_a_table_of_merl_entry_by_entry(tmp_path):
    # Bins as BRDFRead.cpp counts them: half polar by its square root, the difference evenly.
    table = np.random.default_rng(0).uniform(10, 1000, (3, 5, 6, 7))
    (tmp_path / "t.binary").write_bytes(merl_bytes(table))
    nearest = tm.load_brdf(tmp_path / "t.binary")
    nearest = MerlBrdf(nearest.table, interpolation="nearest")
    btf = tm.load_btf(tmp_path / "t.binary", cache=False)
    linear = load_brdf(tmp_path / "t.binary")
    found = btf.images(range(len(btf)))[:, :, 0, 0]
    for number in range(0, len(btf), 97):
        light, view = btf.light[number].double(), btf.view[number].double()
        half = torch.nn.functional.normalize(light + view, dim=0)
        polar, difference = math.acos(min(1, float(half[2]))), math.acos(min(1, float(light @ half)))
        row, column = int(5 * math.sqrt(polar / (math.pi / 2))), int(6 * difference / (math.pi / 2))
        near = table[:, max(0, row - 1) : row + 2, max(0, column - 1) : column + 2] / np.array(STORED)[:, None, None, None]
        value = found[number].numpy() / (math.pi * float(light[2]))
        assert bool((value >= near.min(axis=(1, 2, 3)) - 1e-6).all() and (value <= near.max(axis=(1, 2, 3)) + 1e-6).all())
        planes = (btf.light[number, :, None, None], btf.view[number, :, None, None])
        assert_close(found[number], linear.shade(*planes)[:, 0, 0], 5e-6)  # another batch, float32
    assert nearest.resolution == (5, 6, 7)


@pytest.mark.parametrize("azimuths", [1, 5])
def test_rgl_files_give_what_they_shade_as(tmp_path, azimuths):
    path = write_tensor_file(tmp_path / "x.bsdf", rgl_fields(azimuths))
    btf = tm.load_btf(path, cache=tmp_path / "cache")
    light, view = hemispheres(azimuths == 1)
    assert_close(btf.light, light.float(), 1e-6)
    wanted = load_brdf(path).shade(light.float().T[:, None], view.float().T[:, None])[:, 0].T
    assert_close(btf.images(range(len(btf)))[:, :, 0, 0], wanted, 1e-5)
    assert tm.load_btf(path, cache=tmp_path / "cache").source.from_cache


def test_lambert_comes_back_from_a_file(tmp_path):
    write_merl(tmp_path / "a.binary", tabulate(AnalyticBrdf("lambert", diffuse=(0.2, 0.4, 0.8)), (6, 6, 8)))
    result = tm.fit(tm.load_btf(tmp_path / "a.binary", cache=False), "lambert")
    assert_close(result.material.maps["albedo"].detach().flatten(), torch.tensor([0.2, 0.4, 0.8]), 1e-4)


@pytest.mark.parametrize("name", ["ptm", "phong_srf", "sphere_images", "shading_map"])
def test_models_of_one_texel(tmp_path, name):
    write_merl(tmp_path / "a.binary", tabulate(AnalyticBrdf("ggx", diffuse=0.3, roughness=0.5), (12, 12, 16)))
    result = tm.fit(tm.load_btf(tmp_path / "a.binary", cache=False), name)
    assert result.material.size == (1, 1)
    assert result.report["held_out"]["relative_error"] < 1


def test_a_model_that_needs_texels_says_so(tmp_path):
    with pytest.raises(tm.FitError, match="clusters must not exceed what the data determines; it is 8 of 1"):
        tm.fit(tm.load_btf(even_merl(tmp_path / "a.binary"), cache=False), "local_pca")


def test_fit_compare_and_info_take_a_file(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = write_tensor_file(tmp_path / "paint.bsdf", rgl_fields(5))
    assert main(["fit", "phong_srf", "--data", str(path), "--no-cache"]) == 0
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert (report["model"], report["texels"], report["samples"]) == ("phong_srf", 1, len(hemispheres(False)[0]))
    assert main(["compare", str(path), "--models", "lambert", "ptm", "--no-cache"]) == 0
    capsys.readouterr()
    assert main(["info", str(path)]) == 0
    assert "anisotropic" in capsys.readouterr().out


def zipped(path, members: dict[str, bytes]):
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return path


@pytest.mark.parametrize("form", ["gz", "zip", "zip with a readme"])
def test_packed_files(tmp_path, form):
    plain = even_merl(tmp_path / "paint.binary")
    content = plain.read_bytes()
    path = tmp_path / ("paint.binary.gz" if form == "gz" else "paint.zip")
    if form == "gz":
        path.write_bytes(gzip.compress(content))
    else:
        zipped(path, {"brdfs/paint.binary": content} | ({"brdfs/readme.txt": b"paint"} if "readme" in form else {}))
    assert is_brdf_file(path)
    light, view = torch.tensor([0.6, 0.0, 0.8])[:, None, None], torch.tensor([0.0, 0.0, 1.0])[:, None, None]
    assert torch.equal(load_brdf(path).shade(light, view), load_brdf(plain).shade(light, view))
    assert torch.equal(tm.load_btf(path, cache=False).image(7), tm.load_btf(plain, cache=False).image(7))


def test_an_anisotropic_one_in_a_zip(tmp_path):
    content = write_tensor_file(tmp_path / "x.bsdf", rgl_fields(5)).read_bytes()
    assert len(tm.load_btf(zipped(tmp_path / "x.zip", {"x.bsdf": content}), cache=False)) == len(hemispheres(False)[0])


def test_packed_files_that_are_damaged_or_several(tmp_path):
    content = even_merl(tmp_path / "paint.binary").read_bytes()
    both = zipped(tmp_path / "both.zip", {"a.binary": content, "b.binary": content})
    with pytest.raises(DataError, match=r"both\.zip: the archive must hold one BRDF; it holds 2: a\.binary, b\.binary"):
        load_brdf(both)
    cut = tmp_path / "cut.binary.gz"
    cut.write_bytes(gzip.compress(content)[:-20])
    with pytest.raises(DataError, match=r"cut\.binary\.gz: the archive must unpack without damage"):
        load_brdf(cut)
    short = zipped(tmp_path / "short.zip", {"a.binary": content[:-8]})
    with pytest.raises(DataError, match=r"short\.zip: a\.binary: the file must have the size that its head promises"):
        tm.load_btf(short, cache=False)
    assert not list(tmp_path.glob("torchmat-brdf-*"))


def test_a_zip_of_pictures_with_a_brdf_beside_them_is_a_btf(tmp_path):
    path = zipped(tmp_path / "x.zip", {"a.binary": b"", "tl000_pl000_tv000_pv000.png": b""})
    assert not is_brdf_file(path)


def test_a_damaged_file_is_refused_in_its_readers_words(tmp_path):
    (tmp_path / "x.bsdf").write_bytes(b"tensor")
    with pytest.raises(DataError, match=r"x\.bsdf.*the head must be complete"):
        tm.load_btf(tmp_path / "x.bsdf", cache=False)
