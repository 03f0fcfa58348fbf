"""What a page hears of saves, and what its wishes do to the folder."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time

import numpy as np
import pytest
import torch
from tests.studio.serving import served, wool

import torchmat as tm
from torchmat.create.edits import edited
from torchmat.images import read_image, write_image
from torchmat.models import blend
from torchmat.web.payload import describe, map_of

LONG = pytest.mark.filterwarnings("ignore::torchmat.errors.Notice")


@pytest.fixture
def folder(tmp_path):
    return wool(tmp_path / "wool")


def painted(path, change=lambda pixels: 255 - pixels):
    """Return the bytes of a picture after a change of its pixels."""
    other = path.with_name(".painted.png")
    write_image(other, change(read_image(path)))
    data = other.read_bytes()
    other.unlink()
    return data


def by_rename(path, data):
    partial = path.with_name(".partial")
    partial.write_bytes(data)
    os.replace(partial, path)


def shown(studio):
    """Return what a page would show: the description and the bytes of each map."""
    description = studio.json("/material.json")
    buffers = {name: studio.get(f"/map/{name}")[1] for name in description.pop("versions")}
    return description, buffers


def assert_shows(studio, material):
    description, buffers = shown(studio)
    wanted = describe(material)
    assert buffers == wanted.buffers
    assert description == json.loads(json.dumps(wanted.description))


def test_a_page_gets_the_material_and_each_save_in_place_or_by_rename_alone(folder):
    with served(folder) as studio, studio.page() as page:
        assert_shows(studio, tm.load_material(folder))
        assert page.hello["name"] == "wool" and page.hello["writable"] and page.hello["says"] == []
        for number, (save, name) in enumerate((
            (type(folder).write_bytes, "diffuse"), (by_rename, "diffuse"), (by_rename, "height"), (type(folder).write_bytes, "rotation"),
        )):
            path = folder / f"{name}.png"
            save(path, painted(path, np.flipud if name == "rotation" else lambda pixels: np.iinfo(pixels.dtype).max - pixels))
            assert page.wait("map")["name"] == name
            page.wait_states(number + 2)
            assert_shows(studio, tm.load_material(folder))
        maps = [message["name"] for message in page.heard if message["type"] == "map"]
        assert maps == ["diffuse", "diffuse", "height", "rotation"]
        assert [state.what for state in studio.live.history.states] == ["opened", *(f"saved {name}.png" for name in maps)]


@LONG
def test_what_a_paint_program_makes_otherwise_is_converted_as_it_is_loaded_and_said(folder):
    with served(folder) as studio, studio.page() as page:
        for name, change, said in (
            ("diffuse", lambda pixels: pixels[:8, :8], "8 x 8, and was resampled to 16 x 16"),
            ("fresnel", lambda pixels: np.repeat(255 - pixels, 3, axis=2), "its channels are equal"),
            ("specular_mask", lambda pixels: (255 - pixels).astype(np.uint16) * 257, None),
        ):
            (folder / f"{name}.png").write_bytes(painted(folder / f"{name}.png", change))
            if said:
                assert said in page.wait("says", level="note")["text"]
            assert page.wait("map")["name"] == name
            assert_shows(studio, tm.load_material(folder))


def test_half_a_file_blanks_nothing_and_the_whole_one_is_shown_when_it_is_there(folder):
    path = folder / "diffuse.png"
    with served(folder) as studio, studio.page() as page:
        before = shown(studio)
        data = painted(path)
        path.write_bytes(data[: len(data) // 2])
        error = page.wait("says", level="error")
        assert error["about"] == "diffuse" and "diffuse.png: the image must be readable" in error["text"]
        assert error["text"].endswith("The last good one is shown.") and shown(studio) == before
        assert not any(message["type"] == "map" for message in page.heard)
        path.unlink()
        assert "must exist" in page.wait("says", level="error")["text"] and shown(studio) == before
        path.write_bytes(data)
        assert page.wait("says", about="diffuse")["text"] == ""
        page.wait("map")
        assert_shows(studio, tm.load_material(folder))
        with open(path, "wb") as stream:  # a slow save
            for part in range(0, len(data), 100):
                stream.write(data[part : part + 100])
                stream.flush()
                time.sleep(0.01)
        time.sleep(0.6)
        assert studio.live.says == {} and shown(studio)[1] == describe(tm.load_material(folder)).buffers


def test_a_damaged_manifest_and_a_link_that_leads_out_are_said_and_change_nothing(folder):
    with served(folder) as studio, studio.page() as page:
        before, text = shown(studio), (folder / "manifest.json").read_text()
        (folder / "manifest.json").write_text(text[:200])
        assert "manifest" in page.wait("says", level="error")["text"] and shown(studio) == before
        (folder / "manifest.json").write_text(text)
        page.wait("says", about="material", text="")
        secret = folder.parent / "secret.png"
        secret.write_bytes(painted(folder / "diffuse.png"))
        (folder / "diffuse.png").unlink()
        (folder / "diffuse.png").symlink_to(secret)
        assert "leads elsewhere" in page.wait("says", level="error")["text"] and shown(studio) == before


def test_edits_are_seen_before_they_are_written_and_are_those_of_the_command(folder):
    edits = {"mask": {"brightness": 0.1, "contrast": 1.4}, "tilt": {"curve": "default"}}
    with served(folder) as studio, studio.page() as page:
        material = tm.load_material(folder)
        page.wish("preview", edits=edits)
        assert_shows(studio, edited(material, edits))
        assert torch.equal(tm.load_material(folder).maps["specular_mask"], material.maps["specular_mask"])
        page.wish("discard")
        assert_shows(studio, material)
        assert page.wish("apply", edits=edits) == {"changed": ["specular_mask", "tilt"], "backup": None}
        assert_shows(studio, tm.load_material(folder))
        assert_shows(studio, edited(material, edits).as_exported())
        page.wish("apply", edits={}, drop=["tilt"])
        assert "tilt" not in shown(studio)[1] and not (folder / "tilt.png").exists()
        for wrong, said in (({"mask": {"x": 1}}, "unexpected keyword"), ({"no": {}}, "must be one of"), ([1], "table of tables")):
            with pytest.raises(ValueError, match=said):
                page.wish("preview", edits=wrong)


def test_undo_and_redo_go_over_saves_of_any_program_and_of_the_page(folder):
    path = folder / "diffuse.png"
    with served(folder) as studio, studio.page() as page:
        materials = [tm.load_material(folder)]
        path.write_bytes(painted(path))
        page.wait_states(2)
        materials.append(tm.load_material(folder))
        page.wish("apply", edits={"darken": {"share": 0.5}, "height_scale": {"scale": 0}})
        materials.append(tm.load_material(folder))
        assert (folder.parent / "wool.backup-1").is_dir()  # the painted diffuse map was written anew
        path.write_bytes(painted(path))
        page.wish("undo")  # at once, before the save was seen or after
        assert_shows(studio, materials[2])
        for number in (1, 0):
            page.wish("undo")
            assert_shows(studio, materials[number])
        with pytest.raises(ValueError, match="this is the first of 4 states"):
            page.wish("undo")
        for number in (1, 2):
            page.wish("redo")
            assert_shows(studio, materials[number])
        page.wish("back", state=0)
        assert_shows(studio, materials[0])
        with pytest.raises(ValueError, match="be one of the 4 there are"):
            page.wish("back", state=9)


def test_another_file_becomes_a_texture_and_is_remembered_and_one_that_is_not_followed_waits(folder):
    (folder / "diffuse_blue.png").write_bytes(painted(folder / "diffuse.png"))
    with served(folder) as studio, studio.page() as page:
        page.wish("choose", texture="diffuse", file="diffuse_blue.png")
        chosen = tm.load_material(folder)
        assert_shows(studio, chosen)
        page.wish("follow", texture="diffuse", on=False)
        (folder / "diffuse_blue.png").write_bytes(painted(folder / "diffuse.png", lambda pixels: pixels // 2))
        page.wait_states(3)
        assert_shows(studio, chosen)
        page.wish("remember", look={"camera": 3})
        for file in ("../secret.png", "/etc/passwd", "missing.png", "manifest.json", ""):
            with pytest.raises(ValueError, match="the file must be one of"):
                page.wish("choose", texture="fresnel", file=file)
        with pytest.raises(ValueError, match="be one texture; it is diffuse"):
            page.wish("choose", texture="fresnel", file="diffuse_blue.png")
    with served(folder) as studio, studio.page() as page:
        assert page.hello["textures"]["diffuse"] == "diffuse_blue.png"
        assert page.hello["still"] == ["diffuse"] and page.hello["look"] == {"camera": 3}
        page.wish("follow", texture="diffuse", on=True)
        assert_shows(studio, tm.load_material(folder))
        page.wish("apply", edits={"darken": {"share": 0.5}})
        assert (folder / "diffuse_blue.png").exists()  # the user's own file stays beside the one that was written


def test_a_blend_is_that_of_python_to_the_bit(folder, tmp_path):
    other = wool(tmp_path / "silk", specular=("soft", "rim"))
    with served(folder, (str(other),)) as studio, studio.page() as page:
        first, second = tm.load_material(folder), tm.load_material(other)
        page.wish("blend", other=0, weight=0.3)
        mixed = blend(first, second, 0.3)
        assert studio.live.shown.buffers == describe(mixed).buffers
        assert studio.get("/map/diffuse")[1] == map_of(mixed, "diffuse")[1]
        page.wish("apply_blend", other=0, weight=0.3)
        again = tm.load_material(folder)
        for name, value in mixed.as_exported().maps.items():
            assert torch.equal(again.maps[name], value)
        for wrong in (1, -1, "0", True, None):
            with pytest.raises(ValueError, match="one of those that were named"):
                page.wish("blend", other=wrong, weight=0.3)


def test_the_next_start_shows_the_last_session_at_once_if_the_files_are_those(folder, monkeypatch):
    from tests.studio import serving

    with served(folder) as studio, studio.page():
        first = shown(studio)
    with monkeypatch.context() as patched:
        async def never(self, name, **keywords):
            raise AssertionError("nothing is asked of torch")

        patched.setattr(serving.Here, "call", never)
        with served(folder) as studio:
            assert shown(studio) == first
    (folder / "diffuse.png").write_bytes(painted(folder / "diffuse.png"))
    with served(folder) as studio:
        assert_shows(studio, tm.load_material(folder))


def test_a_new_material_of_a_form_that_was_seen_needs_no_torch_for_its_first_picture(folder, tmp_path, monkeypatch):
    from torchmat.studio.known import first_of

    other = wool(tmp_path / "silk", 24, specular=("soft", "rim"), height_scale=0.2)
    assert first_of(folder) is None
    with served(folder) as studio, studio.page():
        deadline = time.monotonic() + 10
        while first_of(other) is None:
            assert time.monotonic() < deadline
            time.sleep(0.05)
    code = "import sys, pathlib, torchmat.studio.app; from torchmat.studio.known import first_of" \
        "; print(first_of(pathlib.Path(sys.argv[1])) is None, 'torch' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code, str(other)], capture_output=True, text=True, check=True)
    assert done.stdout == "False False\n"
    description, buffers = first_of(other)
    wanted = describe(tm.load_material(other))
    assert buffers == wanted.buffers
    for entry, known in zip(wanted.description.pop("maps"), description.pop("maps"), strict=True):
        close = known.pop("range"), entry.pop("range")
        assert known == entry and (entry["transfer"] == "hue" or np.allclose(*close, rtol=1e-6))
    assert description == json.loads(json.dumps(wanted.description))
    assert first_of(wool(tmp_path / "flat", height_scale=0)) is None and first_of(wool(tmp_path / "one", lobes=1, specular=("rim",))) is None
    write_image(other / "diffuse.png", read_image(other / "diffuse.png")[:8])
    assert first_of(other) is None
    (other / "diffuse.png").write_bytes(b"half")
    assert first_of(other) is None


def test_a_folder_that_cannot_be_written_is_shown_and_nothing_is_saved(folder, monkeypatch):
    from torchmat.studio import place

    monkeypatch.setattr(place, "_can_write", lambda path: False)
    with served(folder) as studio, studio.page() as page:
        assert not page.hello["writable"] and "saves nothing" in page.hello["says"][0]["text"]
        page.wish("preview", edits={"darken": {"share": 0.5}})
        for wish in ({"kind": "apply", "edits": {}}, {"kind": "undo"}, {"kind": "choose", "texture": "diffuse", "file": "height.png"}):
            with pytest.raises(ValueError, match="the folder must be writable"):
                page.wish(**wish)
        assert sorted(os.listdir(folder.parent)) == ["torchmat-cache", "wool"]
