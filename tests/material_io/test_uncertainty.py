"""Standard errors in a material folder: written with it, read back, and gone with the map that they were of."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch
from tests.models.examples import make
from tests.report.reading import Reading
from tests.support import assert_close

import torchmat as tm
from torchmat.errors import DataError, RangeError
from torchmat.material_io import change_material, check_target, load_uncertainty
from torchmat.models.uncertainty import Uncertainty
from torchmat.report import write_fit
from torchmat.report.describe import describe_material


@pytest.fixture(scope="module")
def btf():
    return tm.load_btf(tm.sample_path(), cache=False, crop=(0, 0, 5, 6), progress=False)


@pytest.fixture(scope="module")
def result(btf):
    return tm.fit(btf, "lambert", uncertainty=True, measure="none", tiles=False)


@pytest.fixture
def folder(btf, result, tmp_path):
    return write_fit(btf, result, tmp_path / "cloth", pictures=False)


def test_errors_come_back_from_the_folder(folder, result):
    found = load_uncertainty(folder)
    assert set(found.error) == {"albedo", "normal"} and found.samples == result.uncertainty.samples
    for name, error in result.uncertainty.error.items():
        assert_close(found.error[name], error, 1e-3)
    assert_close(found.interval(0.9)["albedo"], result.uncertainty.interval(0.9)["albedo"], 1e-3)
    assert found.sigma == result.uncertainty.sigma and found.span == result.uncertainty.span
    assert tm.load_material(folder).name == "lambert" and "| albedo" in describe_material(folder).partition("standard error of")[2]
    report = json.loads((folder / "report.json").read_text("utf-8"))
    assert report["uncertainty"]["maps"]["albedo"]["median"] == pytest.approx(float(result.uncertainty.error["albedo"].median()))


def test_they_are_files_of_the_folder_that_torchmat_wrote(folder):
    assert check_target(folder) is False
    (folder / "uncertainty" / "albedo.exr").write_bytes(b"painted")
    with pytest.raises(DataError, match="albedo.exr"):
        check_target(folder)
    with pytest.raises(DataError, match="albedo.exr"):
        load_uncertainty(folder)
    (folder / "uncertainty" / "albedo.exr").unlink()
    with pytest.raises(DataError, match="albedo.exr: the texture must stand in uncertainty"):
        load_uncertainty(folder)


def test_a_map_that_is_changed_has_no_error_any_more(folder):
    change_material(folder, lambda material: material.with_maps(albedo=material.maps["albedo"].detach() * 0.5))
    assert set(load_uncertainty(folder).error) == {"normal"}
    assert not (folder / "uncertainty" / "albedo.exr").exists() and (folder / "uncertainty" / "normal.exr").exists()
    up = torch.zeros(3, 5, 6)
    up[2] = 1
    change_material(folder, lambda material: material.with_maps(normal=up))
    assert load_uncertainty(folder) is None and tm.load_material(folder).size == (5, 6)


def test_a_folder_without_errors_has_none(tmp_path):
    assert load_uncertainty(tm.save_material(make("ptm", {}, dtype=torch.float32), tmp_path / "one")) is None


def test_errors_of_other_maps_are_refused(tmp_path):
    other = Uncertainty({"height": torch.ones(1, 2, 3)}, torch.ones(1, 2, 3), (1.0, 1.0, 1.0), "linear", {"height": 1.0}, (3, 3))
    with pytest.raises(RangeError, match="uncertainty must be that of the material's maps"):
        tm.save_material(make("ptm", {}, dtype=torch.float32), tmp_path / "one", uncertainty=other)
    large = Uncertainty({"polynomial": torch.full((18, 2, 3), 1e6)}, torch.ones(1, 2, 3), (1.0, 1.0, 1.0), "linear", {"polynomial": 1e6}, (3, 3))
    with pytest.raises(RangeError, match="uncertainty of polynomial must be at most 65504"):
        tm.save_material(make("ptm", {}, dtype=torch.float32), tmp_path / "one", uncertainty=large)
    assert not (tmp_path / "one").exists()


def test_the_page_shows_them_with_their_scale(btf, result):
    from torchmat.report.error_cards import error_cards
    from torchmat.report.html import fit_page
    from torchmat.report.viewer import viewer_of

    cards = error_cards(result.material, result.uncertainty, Path("nowhere"))
    assert [card.name for card in cards] == ["albedo, standard error", "normal, standard error"]
    page = fit_page(result.report, [], errors=cards)
    read = Reading(page)
    assert "How certain the maps are" in read.text and cards[0].extent in read.text and cards[0].picture in page
    assert json.dumps(cards[1].picture)[1:-1] in viewer_of(result.material, cards)


def test_models_without_errors_are_refused_before_the_fit(btf):
    with pytest.raises(RangeError, match="uncertainty of neural must be asked of maps that have one"):
        tm.fit(btf, "neural", uncertainty=True)
    with pytest.raises(RangeError, match="uncertainty of lptm"):
        tm.fit(btf, make("lptm", {}, 5, 6, torch.float32), uncertainty=True)
    assert tm.fit(btf, "texture", measure="none").uncertainty is None
