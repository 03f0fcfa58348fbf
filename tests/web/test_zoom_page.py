"""The page beside relight's tiles: it shows, from disk and served, what the material is, pans, zooms and asks for what is in sight alone."""

from __future__ import annotations

import base64
import io
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from tests.web.browser import SITE
from tests.web.pages import smooth

import torchmat as tm
from torchmat.colour import linear_to_srgb
from torchmat.models.edit import resized

HEIGHT, WIDTH = 300, 560  # three levels, of 3 x 2, 2 x 1 and one tile
LIGHT = (0.3, -0.5)
_READY = "window.zoom && zoom.atRest"
_SHOWN = "() => { zoom.draw(); return zoom.canvas.toDataURL('image/png'); }"


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("tiles") / "m"
    material = resized(smooth("ptm", {"space": "srgb"}), (HEIGHT, WIDTH))
    tm.export(material, path, "relight", image="png", layout="deepzoom")
    return path


def expected(material: tm.Material, light=LIGHT) -> np.ndarray:
    """Return what a screen shows of a material [H, W, 3] in codes, by its own shade."""
    x, y = light
    direction = torch.tensor([x, y, (1 - x * x - y * y) ** 0.5])[:, None, None]
    colour = material.shade(direction, torch.tensor([0.0, 0.0, 1.0])[:, None, None])
    return 255 * linear_to_srgb(colour.clamp(0, 1)).permute(1, 2, 0).detach().numpy()


def shown(page, light=LIGHT) -> np.ndarray:
    page.evaluate(f"() => zoom.lit({light[0]}, {light[1]})")
    page.wait_for_function(_READY)
    picture = page.evaluate(_SHOWN).partition(",")[2]
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(picture))).convert("RGB")).astype(float)


def from_disk(chromium, folder, width=WIDTH, height=HEIGHT, **settings):
    page = chromium.open(width, height, **settings)
    page.context.set_offline(True)
    page.goto((folder / "index.html").as_uri())
    page.wait_for_function(_READY)
    return page


def test_from_disk_it_shows_the_material_at_any_light(chromium, folder):
    material = tm.load_material(folder)
    page = from_disk(chromium, folder)
    for light in (LIGHT, (0.0, 0.0), (-0.6, 0.6)):
        assert np.abs(shown(page, light) - expected(material, light)).max() < 1.01
    assert page.problems == []
    page.close()


def test_it_zooms_about_the_pointer_and_pans(chromium, folder):
    material = tm.load_material(folder)
    page = from_disk(chromium, folder)
    page.mouse.move(140, 75)
    page.mouse.wheel(0, -300)  # twice as large; what is under the pointer stays
    page.wait_for_function("zoom.zoom > 1.99")
    found, wanted = shown(page), expected(material)
    assert np.abs(found[1::2, 1::2][:149] - wanted[37:187, 70:350][:149]).max() < 4  # between texels
    page.mouse.down()
    page.mouse.move(40, 25, steps=3)
    page.mouse.up()
    assert page.evaluate("zoom.centre") == pytest.approx([70 + 140 + 50, 37.5 + 75 + 25])
    page.keyboard.press("0")
    assert np.abs(shown(page) - wanted).max() < 1.01
    before = page.evaluate("zoom.light")
    page.keyboard.press("ArrowUp")
    box = page.evaluate("(() => { const b = document.getElementById('light').getBoundingClientRect(); return [b.left, b.top, b.width]; })()")
    assert page.evaluate("zoom.light") == pytest.approx([before[0], before[1] + 0.05])
    page.mouse.click(box[0] + 0.75 * box[2], box[1] + 0.25 * box[2])
    assert page.evaluate("zoom.light") == pytest.approx([0.5, 0.5], abs=0.02)
    page.close()


def test_served_it_asks_for_what_is_in_sight_alone(chromium, folder):
    page, asked = chromium.open(140, 75), []

    def answer(route) -> None:
        name = route.request.url.removeprefix(SITE).partition("?")[0]
        asked.append(name)
        kind = {".html": "text/html", ".png": "image/png"}.get(Path(name).suffix, "text/plain")
        route.fulfill(body=(folder / name).read_bytes(), content_type=kind)

    page.route(f"{SITE}**", answer)
    page.goto(f"{SITE}index.html")
    page.wait_for_function(_READY)
    assert sorted(asked[1:]) == [f"plane_{number}_files/0/0_0.png" for number in range(6)]
    info = json.loads((folder / "info.json").read_text())
    scale, bias = (np.array(info["materials"][0][name]).reshape(6, 3) for name in ("scale", "bias"))
    planes = [np.asarray(Image.open(folder / f"plane_{k}_files/0/0_0.png")) / 255 for k in range(6)]
    x, y = LIGHT
    total = sum(weight * (plane - bias[k]) * scale[k] for k, (weight, plane) in enumerate(zip((1, x, y, x * x, x * y, y * y), planes, strict=True)))
    assert np.abs(shown(page) - 255 * total.clip(0, 1)).max() < 1.01
    page.evaluate("() => zoom.zoomed(4, 0, 0)")
    page.wait_for_function(_READY)
    later = set(asked[7:])
    assert later == {f"plane_{k}_files/{place}.png" for k in range(6) for place in ("1/0_0", "2/0_0")}
    page.close()


def test_a_tile_that_is_missing_is_said(chromium, folder, tmp_path):
    copy = tmp_path / "copy"
    shutil.copytree(folder, copy)
    (copy / "page_tiles" / "2" / "1_0.js").unlink()
    page = from_disk(chromium, copy)
    assert "page_tiles/2/1_0.js is missing" in page.text_content("#told")
    assert np.abs(shown(page)[:, :250] - expected(tm.load_material(folder))[:, :250]).max() < 1.01  # the rest is there
    page.close()
