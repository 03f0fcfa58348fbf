"""What a fit may replace: its own files and renders, never a picture that somebody put beside them."""

from __future__ import annotations

import json

import pytest
import torch

from torchmat.errors import DataError
from torchmat.material_io import save_material
from torchmat.models import Texture


def material(value: float = 0.5) -> Texture:
    return Texture({"albedo": torch.full((3, 2, 2), value)})


def with_report(folder) -> None:
    (folder / "report.json").write_text("{}")
    (folder / "pictures").mkdir()
    (folder / "pictures" / "sphere.png").write_bytes(b"picture")


def test_the_manifest_lists_what_was_written_beside_it(tmp_path):
    save_material(material(), tmp_path / "m", companions=with_report)
    manifest = json.loads((tmp_path / "m" / "manifest.json").read_text())
    assert manifest["companions"] == ["pictures/sphere.png", "report.json"]


def test_own_files_are_replaced_and_renders_stay(tmp_path):
    save_material(material(), tmp_path / "m", companions=with_report)
    (tmp_path / "m" / "pictures" / "render_sphere.exr").write_bytes(b"render")
    save_material(material(0.25), tmp_path / "m")
    found = sorted(path.relative_to(tmp_path / "m").as_posix() for path in (tmp_path / "m").rglob("*") if path.is_file())
    assert found == ["albedo.exr", "manifest.json", "pictures/render_sphere.exr"]
    assert (tmp_path / "m" / "pictures" / "render_sphere.exr").read_bytes() == b"render"
    save_material(material(0.125), tmp_path / "m")  # and they are in nobody's way


@pytest.mark.parametrize("name", ["pictures/holiday.png", "notes.txt", "albedo_old.exr", "sub/render_patch.png"])
def test_a_file_of_somebody_elses_is_kept_and_named(tmp_path, name):
    save_material(material(), tmp_path / "m", companions=with_report)
    (tmp_path / "m" / name).parent.mkdir(exist_ok=True)
    (tmp_path / "m" / name).write_bytes(b"mine")
    before = (tmp_path / "m" / "manifest.json").read_bytes()
    with pytest.raises(DataError, match=name.replace(".", r"\.")):
        save_material(material(0.25), tmp_path / "m")
    assert (tmp_path / "m" / name).read_bytes() == b"mine"
    assert (tmp_path / "m" / "manifest.json").read_bytes() == before
