"""The studio's page in a browser: what is saved is seen."""

from __future__ import annotations

import time

import numpy as np
import pytest
import torch
from tests.studio.serving import served, wool

import torchmat as tm
from torchmat import colour
from torchmat.create.edits import edited
from torchmat.images import read_image, write_image
from torchmat.models import blend
from torchmat.rendering.nine_views import half_at, marks, nine_pairs
from torchmat.web.payload import describe

pytest.importorskip("uvicorn")


def opened(chromium, studio, **settings):
    page = chromium.open(**{"width": 360, "height": 260, **settings})
    page.goto(studio.address)
    try:
        page.wait_for_function("window.torchmat && window.torchmat.viewer.frames > 0", timeout=40_000)
    except Exception:
        raise AssertionError(page.problems) from None
    return page


PIXEL = """async () => {
  const { viewer } = window.torchmat;
  const pixels = viewer.scene.picture(viewer.picture(), 32, 32);
  return [...pixels.subarray(4 * (32 * 16 + 16), 4 * (32 * 16 + 16) + 3)];
}"""


def until(page, condition, argument=None):
    page.wait_for_function(condition, arg=argument, timeout=30_000)


def test_a_save_changes_the_picture_and_half_a_file_does_not(chromium, tmp_path):
    folder = wool(tmp_path / "wool", tilt="default")
    path = folder / "diffuse.png"
    with served(folder) as studio:
        page = opened(chromium, studio)
        assert "token" not in page.url
        page.evaluate("window.torchmat.viewer.setMesh('quad')")
        pixels = read_image(path)
        for colour in ([255, 0, 0], [0, 0, 255]):
            pixels[:] = colour
            write_image(path, pixels)
            until(page, "c => { const b = new Uint8Array(window.torchmat.viewer.buffers.diffuse); return b[0] === c[0] && b[2] === c[2]; }", colour)
            red, _, blue = page.evaluate(PIXEL)
            assert (red > blue + 60) == (colour[0] > 0)
        before = page.evaluate(PIXEL)
        data = path.read_bytes()
        path.write_bytes(data[:60])
        until(page, "() => document.querySelector('.tms-says .tms-error')?.textContent.includes('The last good one is shown')")
        assert page.evaluate(PIXEL) == before
        path.write_bytes(data)
        until(page, "() => !document.querySelector('.tms-says .tms-error')")
        page.get_by_role("button", name="Undo").click()
        until(page, "() => new Uint8Array(window.torchmat.viewer.buffers.diffuse)[0] === 255")
        red, _, blue = page.evaluate(PIXEL)
        assert red > blue + 60
        assert page.problems == []


def open_panel(page, title):
    page.evaluate("t => { [...document.querySelectorAll('summary')].find(one => one.textContent === t).parentElement.open = true; }", title)


def test_nine_views_are_shade_at_their_pairs_and_their_marks_lead_back(chromium, tmp_path):
    folder = wool(tmp_path / "wool", tilt="default")
    with served(folder) as studio:
        page = opened(chromium, studio)
        open_panel(page, "Nine views")
        page.evaluate("() => { const { nine } = window.torchmat; nine.turn('light', 25); nine.turn('view', 55); }")
        until(page, "() => window.torchmat.nine.marked && !window.torchmat.nine.waiting.length")
        found = page.evaluate("""() => window.torchmat.nine.pairs.map(({ light, view }, place) => {
          const canvas = window.torchmat.nine.canvases[place];
          return { light, view, codes: [...canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data] };
        })""")
        material = tm.load_material(folder)
        for one, light, view in zip(found, *nine_pairs(25, 55), strict=True):
            assert np.allclose(one["light"], light) and np.allclose(one["view"], view)
            with torch.no_grad():
                value = material.shade(light.float()[:, None, None], view.float()[:, None, None])
            codes = np.array(one["codes"]).reshape(16, 16, 4)[:, :, :3]
            assert np.abs(codes - (colour.display(value) * 255).permute(1, 2, 0).numpy()).max() < 0.51
        places = page.evaluate("""() => [...document.querySelectorAll('.tms-mark')].map(({ style }) => [parseFloat(style.left), parseFloat(style.top)])""")
        expected = marks(*nine_pairs(25, 55)).numpy()
        assert np.allclose(np.array(places) / 100, np.stack((expected[:, 0], 1 - expected[:, 1]), axis=1), atol=1e-4)
        half = page.evaluate("""() => {
          const { nine } = window.torchmat;
          nine.choose(2);
          nine.frame.scrollIntoView();
          const box = nine.frame.getBoundingClientRect();
          nine.frame.dispatchEvent(new MouseEvent("click", { clientX: box.left + 0.7 * box.width, clientY: box.top + 0.6 * box.height }));
          return nine.pairs[2];
        }""")
        wanted = half_at(torch.tensor([[0.7, 0.4]], dtype=torch.float64))[0]
        assert np.allclose(half["light"], wanted, atol=0.02) and half["light"] == half["view"]
        assert page.problems == []


def test_the_picture_of_a_save_comes_before_small_pictures_and_those_that_nobody_sees_wait(chromium, tmp_path):
    folder = wool(tmp_path / "wool")
    path = folder / "diffuse.png"
    with served(folder) as studio:
        page = opened(chromium, studio, width=1000, height=900)
        until(page, "() => document.querySelector('.tmv-thumb canvas') && document.querySelector('.tms-select:not(.tms-marks) canvas')")
        page.evaluate("""() => {
          const { viewer, nine } = window.torchmat;
          const titles = [...document.querySelectorAll('summary')];
          titles.forEach((one) => { one.parentElement.open = one.textContent === 'Maps'; });
          window.order = [];
          viewer.on("maps", (name) => { window.order = [name]; });
          viewer.on("frame", () => window.order.push("picture"));
          const told = (what) => (found) => { if (found.some((one) => one.addedNodes.length)) window.order.push(what); };
          document.querySelectorAll('.tmv-thumb').forEach((one) => new MutationObserver(told("small")).observe(one, { childList: true }));
          new MutationObserver(told("selection")).observe(document.querySelector('.tms-select:not(.tms-marks)'), { childList: true });
          nine.draw = () => window.order.push("nine");
        }""")
        write_image(path, 255 - read_image(path))
        until(page, "() => window.order.includes('small')")
        order = page.evaluate("window.order")
        assert order[:2] == ["diffuse", "picture"] and not {"selection", "nine"} & set(order)
        open_panel(page, "Rotation: draw 360")
        page.evaluate("document.querySelector('.tms-select:not(.tms-marks)').scrollIntoView()")
        until(page, "() => window.order.includes('selection')")
        open_panel(page, "Nine views")
        until(page, "() => window.order.includes('nine')")
        shown = """() => { const { data } = document.querySelector('.tms-select:not(.tms-marks) canvas').getContext('2d').getImageData(0, 0, 4, 4); return [...data]; }"""
        assert np.abs(np.array(page.evaluate(shown)).reshape(4, 4, 4)[..., :3] - read_image(path)[:4, :4]).max() <= 1
        assert page.problems == []


def test_expand_hides_and_brings_back_the_nine_views_and_nothing_else(chromium, tmp_path):
    with served(wool(tmp_path / "wool")) as studio:
        page = opened(chromium, studio, width=900, height=500)
        seen = """() => ({
          nine: window.torchmat.nine.canvases.filter((one) => one.checkVisibility()).length,
          others: [...document.querySelectorAll('.tmv-side summary')].filter((one) => one.checkVisibility()).map((one) => one.textContent),
          picture: document.querySelector('.tmv-stage canvas').checkVisibility(), expanded: document.querySelector('.tms-expand').ariaExpanded,
        })"""
        open_panel(page, "Nine views")
        before = page.evaluate(seen)
        assert before["nine"] == 9 and before["picture"] and len(before["others"]) > 6 and before["expanded"] == "true"
        page.evaluate("window.torchmat.nine.choose(7)")
        page.get_by_role("button", name="Sweep the light").last.dispatch_event("click")
        page.get_by_role("button", name="Expand").click()
        until(page, "() => document.querySelector('.tms-expand').ariaExpanded === 'false'")
        assert page.evaluate(seen) == {**before, "nine": 0, "expanded": "false"}
        page.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
        hidden = page.evaluate("window.torchmat.nine.light")
        page.evaluate("() => new Promise((done) => setTimeout(done, 200))")
        assert page.evaluate("window.torchmat.nine.light") == hidden  # nobody sees it: it does not sweep
        page.evaluate("() => { window.torchmat.nine.changed(0); return new Promise((done) => setTimeout(done, 100)); }")
        assert page.evaluate("window.torchmat.nine.waiting.length") == 9  # nor is it drawn
        page.get_by_role("button", name="Nine views").click()
        until(page, "() => document.querySelector('.tms-expand').ariaExpanded === 'true'")
        assert page.evaluate(seen) == before and page.evaluate("window.torchmat.nine.chosen") == 7
        until(page, "light => window.torchmat.nine.light !== light", hidden)
        assert page.problems == []


def test_controls_show_at_once_what_the_command_would_write_and_write_it(chromium, tmp_path):
    folder = wool(tmp_path / "wool")
    other = wool(tmp_path / "silk", specular=("soft", "rim"))
    with served(folder, (str(other),)) as studio:
        page = opened(chromium, studio)
        for title in ("Controls", "Tilt curve", "Rotation: draw 360", "Blend"):
            open_panel(page, title)
        shown = "async () => { const e = window.torchmat.edits; while (e.asking) await e.asking; return e.edits; }"

        def fill(label, value):
            page.get_by_label(label).last.fill(str(value))

        for label, value in (("Height scale", 0.08), ("Normals, times", 4), ("Darken", 0.3), ("Specular mask: contrast", 1.7),
                             ("Specular mask: brightness", 0.2), ("Fresnel: brightness", -0.3)):
            fill(label, value)
        page.get_by_role("button", name="Default: 1").click()
        page.evaluate("""() => {
          const frame = document.querySelector('.tms-select:not(.tms-marks)');
          frame.setPointerCapture = () => {};
          frame.scrollIntoView();
          const box = frame.getBoundingClientRect();
          const at = (name, x, y) => frame.dispatchEvent(new PointerEvent(name, { clientX: box.left + x * box.width, clientY: box.top + y * box.height }));
          at("pointerdown", 0.25, 0.25); at("pointermove", 0.5, 0.5); at("pointerup", 0.75, 0.75);
        }""")
        page.get_by_role("button", name="Draw 360").click()
        edits = page.evaluate(shown)
        assert edits["rotation"]["centres"] == [] and np.allclose(edits["rotation"]["region"], [0.25, 0.25, 0.75, 0.75], atol=0.01)
        assert {name: value for name, value in edits.items() if name != "rotation"} == {
            "height_scale": {"scale": 0.08}, "normal_strength": {"strength": 4}, "darken": {"share": 0.3}, "tilt": {"curve": "default"},
            "mask": {"brightness": 0.2, "contrast": 1.7}, "fresnel": {"brightness": -0.3, "contrast": 0.1},
        }
        wanted = edited(tm.load_material(folder), edits)
        assert studio.live.shown.buffers == describe(wanted).buffers
        assert torch.equal(wanted.maps["tilt"].flatten().double(), (1 - torch.cos(torch.deg2rad(torch.arange(91.0, dtype=torch.float64)))).float().double())
        page.get_by_role("button", name="Write into the folder").first.click()
        until(page, "() => window.torchmat.edits.empty && document.querySelectorAll('.tms-states li').length > 1")
        again = tm.load_material(folder)
        for name, value in wanted.as_exported().maps.items():
            assert torch.equal(again.maps[name], value), name
        page.get_by_label("Weight").last.fill("0.25")
        mixed = blend(again, tm.load_material(other), 0.25)
        until(page, "n => window.torchmat.live.versions.specular > n", page.evaluate("window.torchmat.live.versions.specular"))
        assert studio.live.shown.buffers == describe(mixed).buffers and page.problems == []


@pytest.mark.parametrize("press", [False, True], ids=["selection", "centre"])
def test_draw_360_has_no_seam_where_the_angle_wraps(chromium, tmp_path, press):
    side, (left, bottom, right, top) = 32, (0.25, 0.125, 0.875, 0.75)
    folder = wool(tmp_path / "wool", size=side)
    before = tm.load_material(folder).maps["rotation"].detach()
    with served(folder) as studio:
        page = opened(chromium, studio)
        open_panel(page, "Rotation: draw 360")
        page.evaluate("""(places) => {
          const frame = document.querySelector('.tms-select:not(.tms-marks)');
          frame.setPointerCapture = () => {};
          frame.scrollIntoView();
          const box = frame.getBoundingClientRect();
          const names = ["pointerdown", "pointermove", "pointerup"];
          places.forEach(([u, v], k) => frame.dispatchEvent(new PointerEvent(names[Math.min(k, 2)], {
            clientX: box.left + u * box.width, clientY: box.top + (1 - v) * box.height,
          })));
        }""", [[0.5625, 0.4375]] * 3 if press else [[left, bottom], [0.5, 0.5], [right, top]])
        page.get_by_role("button", name="Draw 360").click()
        edit = page.evaluate("async () => { const e = window.torchmat.edits; while (e.asking) await e.asking; return e.edits.rotation; }")
        page.get_by_role("button", name="Write into the folder").first.click()
        until(page, "() => window.torchmat.edits.empty && document.querySelectorAll('.tms-states li').length > 1")
        assert page.problems == []
    written = tm.load_material(folder).maps["rotation"].detach().double().numpy()
    x, y = (np.arange(side) + 0.5) / side, 1 - (np.arange(side) + 0.5) / side
    if press:
        (u, v), inside = edit["centres"][0], np.ones((side, side), bool)
        assert abs(u - 0.5625) < 0.01 and abs(v - 0.4375) < 0.01
    else:
        one, low, other, high = edit["region"]
        assert np.abs(np.array(edit["region"]) - (left, bottom, right, top)).max() < 0.01
        (u, v), inside = (0.5625, 0.4375), ((y > low) & (y < high))[:, None] & ((x > one) & (x < other))[None]
        assert np.array_equal(written[:, ~inside], before.double().numpy()[:, ~inside])
    # The very angle about the centre, as cosine and sine, to the step of a hue of 8 bits: a full turn in 6 x 255 steps.
    exact = np.arctan2(y[:, None] - v, x[None] - u)
    found = np.arctan2(written[1], written[0])
    off = np.abs(np.angle(np.exp(1j * (found - exact))))[inside]
    assert off.max() < 2 * np.pi / (6 * 255) / 2 * 1.01 and np.ptp(found[inside]) > 6
    # Across the wrap, left of the centre, the written map turns by what the angle itself does, and by no more than that.
    row, columns = int(round((1 - v) * side)), np.nonzero(inside.any(axis=0) & (x < u - 1 / side))[0]
    step = np.abs(np.angle(np.exp(1j * (found[row - 1, columns] - found[row, columns]))))
    wanted = np.abs(np.angle(np.exp(1j * (exact[row - 1, columns] - exact[row, columns]))))
    assert len(columns) > 5 and (exact[row - 1, columns] > 2).all() and (exact[row, columns] < -2).all()
    assert np.abs(step - wanted).max() < 2 * np.pi / (6 * 255) * 1.01


def test_what_it_is_looked_at_with_comes_back_and_other_files_are_offered_by_their_names(chromium, tmp_path):
    folder = wool(tmp_path / "wool")
    (folder / "Diffuse_2.PNG").write_bytes((folder / "diffuse.png").read_bytes())
    with served(folder) as studio:
        page = opened(chromium, studio)
        page.evaluate("window.torchmat.viewer.setMesh('torus'); window.torchmat.viewer.change((state) => { state.repeat = 3; })")
        open_panel(page, "Files")
        offered = page.evaluate("[...document.querySelector('[aria-label=\"File of diffuse\"]').options].map(one => one.value)")
        assert offered == ["Diffuse_2.PNG", "diffuse.png"]
        page.select_option("[aria-label='File of diffuse']", "Diffuse_2.PNG")
        until(page, "() => document.querySelectorAll('.tms-states li').length > 1")
        page.locator("[aria-label='Show saves of fresnel at once']").uncheck()
        deadline = time.monotonic() + 10
        while studio.live.settings.look.get("state", {}).get("repeat") != 3 or studio.live.settings.still != ["fresnel"]:
            assert time.monotonic() < deadline
            time.sleep(0.05)
    with served(folder) as studio:
        page = opened(chromium, studio)
        until(page, "() => window.torchmat.viewer.state.mesh === 'torus' && window.torchmat.viewer.state.repeat === 3")
        open_panel(page, "Files")
        assert page.locator("[aria-label='File of diffuse']").input_value() == "Diffuse_2.PNG"
        assert not page.locator("[aria-label='Show saves of fresnel at once']").is_checked() and page.problems == []
