"""Edits: known values by hand, what an edit does not name keeps its bits, and files that are not concerned their bytes."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
import torch
from tests.models.distributions import ALL_PARTS, distribution
from tests.support import assert_close

from torchmat import DataError, RangeError, ShapeError, load_material, save_material
from torchmat.create import EDITS, edited, material_from_picture
from torchmat.create.edits import (
    darken, fresnel, height_scale, index, mask, normal_strength, rotation, specular, tiles, tilt, without,
)
from torchmat.create.specular_maps import TILTS, glossy, tilt_curve
from torchmat.geometry import slopes_from_normals
from torchmat.images import read_image, write_image
from torchmat.material_io import change_material
from torchmat.models import Texture

MODEL = distribution(6, 8, 2, ALL_PARTS, relief=True, storage="paint16")


def others_kept(before, after, *changed):
    """Assert that all maps but those named are the very same."""
    for name, value in before.maps.items():
        if name not in changed:
            assert torch.equal(after.maps[name], value), name


def files(folder) -> dict[str, bytes]:
    return {one.relative_to(folder).as_posix(): one.read_bytes() for one in folder.rglob("*") if one.is_file()}


def test_height_scale_is_black_to_white():
    picture = torch.rand(3, 6, 7)
    material = material_from_picture(picture, height_scale=0.05)
    wanted = material_from_picture(picture, height_scale=0.02)
    found = height_scale(material, 0.02)
    assert_close(found.maps["height"].detach(), wanted.maps["height"].detach(), 1e-6)
    assert found.stored["height"].span == pytest.approx(wanted.stored["height"].span, abs=1e-7)
    others_kept(material, found, "height")
    measured = height_scale(MODEL, 0.5).maps["height"].detach()
    assert float(measured.max() - measured.min()) == pytest.approx(0.5, rel=1e-5)
    flat = height_scale(material, 0)
    assert not flat.has_relief and "height" not in flat.stored
    made = height_scale(flat, 0.03)
    assert made.has_relief and made.stored["height"].span[1] - made.stored["height"].span[0] == pytest.approx(0.03)
    with pytest.raises(RangeError, match="height_scale"):
        height_scale(material, -1.0)


def test_normal_strength_is_a_factor_on_all_slopes():
    def slopes(material):
        return slopes_from_normals(material.surface().maps["normal"].detach())

    gentle = material_from_picture(torch.rand(3, 6, 7), height_scale=0.005)
    assert_close(slopes(normal_strength(gentle, 2.5)), 2.5 * slopes(gentle), 1e-5)
    again = normal_strength(normal_strength(MODEL, 2.0), 0.5)
    assert_close(again.maps["normal"].detach(), MODEL.maps["normal"].detach(), 1e-5)
    assert torch.equal(normal_strength(MODEL, 3.0).maps["height"], MODEL.maps["height"])
    flat = height_scale(gentle, 0)
    with pytest.raises(RangeError, match="have a height or normals"):
        normal_strength(flat, 2.0)
    for strength in (0.0, 8.1, math.nan):
        with pytest.raises(RangeError, match="strength"):
            normal_strength(MODEL, strength)


def test_mask_and_fresnel_are_of_the_diffuse_luminance_or_of_themselves():
    grey = MODEL.with_maps(diffuse=torch.full((3, 6, 8), 0.25))
    for edit, name in ((mask, "specular_mask"), (fresnel, "fresnel")):
        found = edit(grey, 0.1, 2.0)
        assert_close(found.maps[name].detach(), torch.full((1, 6, 8), 0.1), 1e-6)  # 0.25 * 2 - 0.5 + 0.1
        others_kept(grey, found, name)
        own = edit(MODEL, 0.0, 1.0, source="itself")
        assert_close(own.maps[name].detach(), MODEL.maps[name].detach().clamp(0, 1), 0)
    bare = without(without(MODEL, "fresnel"), "specular_mask")
    assert "fresnel" in fresnel(bare).maps and len(mask(bare).maps["specular_mask"]) == 1
    with pytest.raises(RangeError, match="have a fresnel"):
        fresnel(bare, source="itself")


def test_darken_tilt_tiles_and_without():
    assert_close(darken(MODEL, 0.25).maps["diffuse"].detach(), 0.75 * MODEL.maps["diffuse"].detach(), 1e-7)
    assert torch.equal(tilt(MODEL, "velvet").maps["tilt"], TILTS["velvet"])
    curve = tilt(MODEL, [(90, 1), (0, 0), (30, 0.6)]).maps["tilt"].detach().flatten()
    assert_close(curve[[0, 15, 30, 60, 90]], torch.tensor([0.0, 0.3, 0.6, 0.8, 1.0]), 1e-6)
    assert torch.equal(tilt_curve("0:0,30:0.6,90:1").flatten(), curve)
    assert tiles(MODEL, False).tiles is False
    assert "tilt" not in without(MODEL, "tilt").maps
    for points in ("0:0,0:1", "91:0", "3:2", "a:b", "1:2:3"):
        with pytest.raises(RangeError, match="tilt"):
            tilt(MODEL, points)


def test_draw_360_about_a_centre_in_a_region():
    found = rotation(MODEL, [(0.5, 0.5)], (0.0, 0.0, 0.5, 1.0)).maps["rotation"].detach()
    assert torch.equal(found[:, :, 4:], MODEL.maps["rotation"].detach()[:, :, 4:])
    assert found[:, 2, 0].tolist() == pytest.approx([-3.5 / math.hypot(3.5, 0.5), 0.5 / math.hypot(3.5, 0.5)])
    middle = rotation(MODEL, region=(0.5, 0.0, 1.0, 1.0)).maps["rotation"].detach()
    right = rotation(MODEL, [(0.75, 0.5)], (0.5, 0.0, 1.0, 1.0)).maps["rotation"].detach()
    assert_close(middle, right, 1e-6)
    weights = torch.zeros(1, 6, 8)
    weights[0, 1, 2] = 1
    drawn = rotation(without(MODEL, "rotation"), [(0.9, 0.9)], weights).maps["rotation"].detach()
    assert int((drawn[0] != 1).sum()) == 1
    for region in ((0.5, 0, 0.5, 1), (0, 0, 1), torch.ones(1, 2, 2)):
        with pytest.raises((RangeError, ShapeError), match="region"):
            rotation(MODEL, region=region)


def test_specular_maps_by_name_keep_the_others():
    found = specular(MODEL, ["keep", "glossy:width=0.2"])
    side = MODEL.maps["specular"].shape[-1]
    assert torch.equal(found.maps["specular"][:3], MODEL.maps["specular"][:3])
    assert torch.equal(found.maps["specular"][3:], glossy(size=side, width=0.2))
    others_kept(MODEL, found, "specular")
    with pytest.raises(ShapeError, match="be 2, as the material has"):
        specular(MODEL, ["glossy"])


def test_index_lays_maps_on_colours():
    dark, bright = torch.tensor([0.1, 0.02, 0.02]), torch.tensor([0.3, 0.6, 0.9])
    left = torch.arange(8) < 4
    picture = torch.where(left, dark[:, None, None], bright[:, None, None]).expand(3, 6, 8).contiguous()
    material = MODEL.with_maps(diffuse=picture)
    found = index(material)
    assert torch.equal(found.maps["index"][0].bool(), left.expand(6, 8)) and found.options["lobes"] == 2
    others_kept(material, found, "index")
    one = index(material, 1)
    assert "index" not in one.maps and torch.equal(one.maps["specular"], material.maps["specular"][:3])
    again = index(one, 2)
    assert torch.equal(again.maps["specular"][3:], again.maps["specular"][:3])


def test_edited_runs_the_table_in_its_order():
    both = edited(MODEL, {"darken": {"share": 0.5}, "mask": {"brightness": 0.1}})
    assert torch.equal(both.maps["specular_mask"], mask(MODEL, 0.1).maps["specular_mask"])
    with pytest.raises(RangeError, match="Did you mean 'mask'"):
        edited(MODEL, {"masc": {}})
    with pytest.raises(RangeError, match="be a distribution material"):
        EDITS["mask"](Texture({"albedo": torch.rand(3, 2, 2)}))


@pytest.fixture
def folder(tmp_path):
    def more(built):
        (built / "report.json").write_text("{}")

    out = save_material(MODEL, tmp_path / "m", companions=more)
    (out / "pictures").mkdir()
    (out / "pictures" / "render_sphere.png").write_bytes(b"render")
    (out / "notes.txt").write_text("mine")
    return out


@pytest.mark.parametrize(("edit", "concerned"), [
    ({"height_scale": {"scale": 0.01}}, {"height.png"}), ({"normal_strength": {"strength": 2.0}}, {"normal.png"}),
    ({"mask": {"contrast": 0.5}}, {"specular_mask.png"}), ({"fresnel": {"contrast": 0.5}}, {"fresnel.png"}),
    ({"tilt": {"curve": "velvet"}}, {"tilt.png"}), ({"rotation": {"centres": [(0.5, 0.5)]}}, {"rotation.png"}),
    ({"specular": {"maps": ["glossy", "rim"]}}, {"specular_1.png", "specular_2.png"}),
    ({"index": {"lobes": 2}}, {"index_1.png", "index_2.png"}), ({"without": {"part": "tilt"}}, {"tilt.png"}),
    ({"tiles": {"repeats": False}}, set()),
])
def test_only_the_files_of_the_maps_concerned_are_touched(folder, edit, concerned):
    pixels = read_image(folder / "diffuse.png")
    write_image(folder / "diffuse.png", pixels[:, :, ::-1].astype(np.uint8))  # painted, in other bits
    before = files(folder)
    done = change_material(folder, lambda material: edited(material, edit), edit)
    after = files(folder)
    assert {name for name in {*before, *after} if before.get(name) != after.get(name)} == concerned | {"manifest.json"}
    assert done.backup is None and set(done.files) <= concerned
    wanted = edited(load_material_of(before, folder.parent / "old"), edit)
    for name, value in load_material(folder).maps.items():
        off = float((value - wanted.as_exported().maps[name]).detach().abs().max())
        assert off <= (2e-5 if name != "diffuse" else 1e-2), name
    assert json.loads(after["manifest.json"])["edits"] == [json.loads(json.dumps(edit))]


def load_material_of(content, folder):
    for name, data in content.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)
    return load_material(folder)


def test_a_painted_map_that_is_edited_stays_in_a_backup(folder):
    write_image(folder / "fresnel.png", np.full((6, 8, 1), 9, np.uint8))
    before = files(folder)
    done = change_material(folder, lambda material: fresnel(material, 0.1))
    assert done.backup == folder.with_name("m.backup-1") and files(done.backup) == before
    second = change_material(folder, lambda material: fresnel(material, 0.2))
    assert second.backup is None  # nobody painted since


def test_edits_are_the_users_work_too(folder):
    (folder / "notes.txt").unlink()
    change_material(folder, lambda material: fresnel(material, 0.1))
    before = files(folder)
    with pytest.raises(DataError, match="'fresnel.png'.*--force"):
        save_material(MODEL, folder)
    assert files(folder) == before
    save_material(MODEL, folder, force=True)
    assert files(folder.with_name("m.backup-1")) == before


def test_an_edit_that_fails_leaves_all_as_it_was(folder, monkeypatch):
    before = files(folder)

    def stop(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("torchmat.material_io.change_folder.write_table", stop)
    with pytest.raises(KeyboardInterrupt):
        change_material(folder, lambda material: fresnel(material, 0.1))
    assert files(folder) == before and [path.name for path in folder.parent.iterdir()] == ["m"]


def test_an_edit_to_another_folder_leaves_the_first(folder):
    before = files(folder)
    done = change_material(folder, lambda material: fresnel(material, 0.1), out=folder.with_name("other"))
    assert files(folder) == before and files(done.folder)["notes.txt"] == b"mine"
    assert files(done.folder)["diffuse.png"] == before["diffuse.png"]
    assert files(done.folder)["fresnel.png"] != before["fresnel.png"]


def test_a_map_stored_small_and_painted_large_stays_so(tmp_path):
    from torchmat.models.storage import StoredAs

    folder = save_material(MODEL.stored_at({"diffuse": StoredAs((3, 4))}), tmp_path / "m")
    write_image(folder / "diffuse.png", np.full((6, 8, 3), 200, np.uint8))
    before = load_material(folder).maps["diffuse"]
    change_material(folder, lambda material: fresnel(material, 0.1))
    assert torch.equal(load_material(folder).maps["diffuse"], before)
