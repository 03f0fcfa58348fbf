"""What a user painted or edited is never replaced in silence: refused with what to do, or kept as a backup."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest
import torch
from tests.models.distributions import distribution

from torchmat import DataError, export, load_material, pack, save_material
from torchmat.geometry import Relief
from torchmat.images import read_image, write_image
from torchmat.material_io import check_target, save_relief
from torchmat.models import Texture


def material(value: float = 0.5) -> Texture:
    return Texture({"albedo": torch.full((3, 4, 4), value)}, storage="png8")


def files(folder) -> dict[str, bytes]:
    return {one.relative_to(folder).as_posix(): one.read_bytes() for one in folder.rglob("*") if one.is_file()}


def paint(path, code: int = 7) -> bytes:
    pixels = read_image(path)
    write_image(path, np.full_like(pixels, code))
    return path.read_bytes()


@pytest.fixture
def folder(tmp_path):
    return save_material(material(), tmp_path / "m", companions=lambda built: (built / "report.json").write_text("{}"))


def test_what_was_not_touched_is_replaced(folder):
    save_material(material(0.25), folder)
    assert float(load_material(folder).maps["albedo"].detach().mean()) == pytest.approx(0.25)
    assert sorted(path.name for path in folder.parent.iterdir()) == ["m"]


def test_a_painted_texture_stays_and_is_named(folder):
    painted = paint(folder / "albedo.png")
    before = files(folder)
    for act in (lambda: save_material(material(0.25), folder), lambda: check_target(folder)):
        with pytest.raises(DataError, match=r"m: what stands there must be as torchmat wrote it.*'albedo.png'.*--force"):
            act()
    assert files(folder) == before and before["albedo.png"] == painted


def test_touching_a_file_without_changing_it_is_no_work(folder):
    (folder / "albedo.png").touch()
    save_material(material(0.25), folder)


def test_numbers_edited_in_the_manifest_are_work_and_its_layout_is_not(tmp_path):
    folder = save_material(distribution(4, 4, 1), tmp_path / "m")
    table = json.loads((folder / "manifest.json").read_text())
    (folder / "manifest.json").write_text(json.dumps(table, indent=4))
    check_target(folder)
    table["provenance"] = {"artist": "me"}
    (folder / "manifest.json").write_text(json.dumps(table))
    with pytest.raises(DataError, match="'manifest.json'"):
        check_target(folder)


def test_a_folder_without_digests_is_not_known_to_be_untouched(folder):
    table = json.loads((folder / "manifest.json").read_text())
    del table["digests"]
    (folder / "manifest.json").write_text(json.dumps(table))
    with pytest.raises(DataError, match="earlier torchmat, which kept no digests.*--force"):
        save_material(material(0.25), folder)
    load_material(folder)


def test_force_keeps_backups_each_whole(folder):
    (folder / "notes.txt").write_text("mine")
    paint(folder / "albedo.png")
    first = files(folder)
    save_material(material(0.25), folder, force=True)
    assert "notes.txt" not in files(folder)
    paint(folder / "albedo.png", 9)
    second = files(folder)
    save_material(material(0.125), folder, force=True)
    assert files(folder.with_name("m.backup-1")) == first and files(folder.with_name("m.backup-2")) == second
    save_material(material(0.5), folder, force=True)  # nothing of the user's: no backup
    assert sorted(path.name for path in folder.parent.iterdir()) == ["m", "m.backup-1", "m.backup-2"]


def test_force_does_not_take_a_folder_that_is_no_material(tmp_path):
    (tmp_path / "home").mkdir()
    (tmp_path / "home" / "thesis.txt").write_text("mine")
    with pytest.raises(DataError, match="be empty or a material folder"):
        save_material(material(), tmp_path / "home", force=True)
    assert files(tmp_path / "home") == {"thesis.txt": b"mine"}


def test_a_backup_is_there_when_the_write_fails(folder, monkeypatch):
    paint(folder / "albedo.png")
    before = files(folder)

    def fail(built):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        save_material(material(0.25), folder, companions=fail, force=True)
    assert files(folder) == before and sorted(path.name for path in folder.parent.iterdir()) == ["m"]


@pytest.mark.parametrize("kind", ["folder", "packed"])
def test_a_changed_export_is_kept(tmp_path, kind):
    source, target = distribution(4, 4, 1), tmp_path / "e"
    export(source, target, kind)
    export(source, target, kind)
    name = next(one.name for one in target.iterdir() if one.suffix == ".png") if kind == "packed" else "diffuse.exr"
    painted = paint(target / name)
    with pytest.raises(DataError, match=f"'{name}'"):
        export(source, target, kind)
    assert (target / name).read_bytes() == painted
    export(source, target, kind, force=True)
    assert (tmp_path / "e.backup-1" / name).read_bytes() == painted


def test_packed_textures_and_reliefs_are_kept(tmp_path):
    pack(distribution(4, 4, 1), tmp_path / "p")
    height = torch.rand(1, 4, 4)
    relief = Relief(height, torch.tensor([0.0, 0.0, 1.0])[:, None, None].expand(3, 4, 4))
    save_relief(relief, tmp_path / "r")
    pack(distribution(4, 4, 1), tmp_path / "p")
    save_relief(relief, tmp_path / "r")
    name = next(one.name for one in (tmp_path / "p").iterdir() if one.suffix == ".png")
    painted = paint(tmp_path / "p" / name), paint(tmp_path / "r" / "height.png")
    for act in (lambda **more: pack(distribution(4, 4, 1), tmp_path / "p", **more),
                lambda **more: save_relief(relief, tmp_path / "r", **more)):
        with pytest.raises(DataError, match="be as torchmat wrote it"):
            act()
        act(force=True)
    assert (tmp_path / "p.backup-1" / name).read_bytes() == painted[0]
    assert (tmp_path / "r.backup-1" / "height.png").read_bytes() == painted[1]


def test_an_exported_file_that_was_changed_is_kept(tmp_path):
    from tests.models.examples import make

    source, target = make("shading_map", {"slices": 3, "brdf": "phong"}, 4, 4, dtype=torch.float32), tmp_path / "wool.3pm"
    export(source, target)
    export(source, target)
    target.write_bytes(target.read_bytes() + b"mine")
    changed = target.read_bytes()
    with pytest.raises(DataError, match=r"wool\.3pm: .*changed since.*--force"):
        export(source, target)
    assert target.read_bytes() == changed
    export(source, target, force=True)
    assert (tmp_path / "wool.3pm.backup-1").read_bytes() == changed and target.read_bytes() != changed


def test_a_copied_folder_is_as_good_as_the_first(folder, tmp_path):
    shutil.copytree(folder, tmp_path / "copy")
    save_material(material(0.25), tmp_path / "copy")
