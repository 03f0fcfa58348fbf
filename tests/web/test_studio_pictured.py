"""The studio's page of a material that no shader draws: pictures, and nothing that changes it."""

from __future__ import annotations

import numpy as np
import pytest
from tests.studio.serving import served
from tests.studio.test_pictured import codes, pictured, rendered
from tests.web.pages import smooth
from tests.web.test_studio import until

import torchmat as tm
from torchmat.images import read_image, write_image
from torchmat.studio.pictured import camera_of

pytest.importorskip("uvicorn")
RESTED = "() => { const v = window.torchmat?.viewer; return v && v.frames > 0 && !v.asking && !v.wanted && !v.pace.moving && !v.pace.coarse; }"


def picture(page):
    until(page, RESTED)
    return codes(page.evaluate("window.torchmat.viewer.canvas.toDataURL('image/png')").partition(",")[2])[..., :3]


def expected(material, state, size):
    """Return what `render` gives of the page's mesh, view and light, on black, [rows, columns, 3]."""
    camera = camera_of(state["mesh"], direction(state["view"]), 1, False, size)
    return rendered(material, mesh=state["mesh"], lights=[direction(state["lights"][0])], camera=camera, size=size)


def direction(angles):
    theta, phi = np.radians([angles["theta"], angles["phi"]])
    return tuple(map(float, (np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta))))


def test_pictures_follow_light_view_and_saves_and_nothing_changes_the_material(chromium, tmp_path):
    folder = pictured(tmp_path / "wool", "neural")
    other = pictured(tmp_path / "silk", "neural")
    with served(folder, (str(other),)) as studio:
        page = chromium.open(width=900, height=500)
        page.goto(studio.address)
        until(page, RESTED)
        assert not page.is_visible("[role=note]")
        # As of a machine on which a full picture takes four seconds: sizes must not go by what else this one does.
        page.evaluate("() => { const { viewer } = window.torchmat; Object.assign(viewer.pace, { whole: 4000, took: () => {} });"
                      " viewer.change((state) => { state.background = 'black'; }); }")
        before = picture(page)
        state = page.evaluate("window.torchmat.viewer.state")
        wanted = expected(tm.load_material(folder), state, before.shape[:2])
        assert (np.abs(before - wanted).max(axis=2) > 1).mean() < 1e-3 and before.std() > 10  # angles are floats of 64 bits in both

        page.locator(".tmv-panel", has_text="View").locator("input[type=number]").first.fill("-35")
        page.locator("[aria-label='light theta, degrees'][type=number]").fill("10")
        turned = picture(page)
        assert turned.shape == before.shape and np.abs(turned - before).mean() > 3

        frames, box = page.evaluate("window.torchmat.viewer.frames"), page.locator("canvas").first.bounding_box()
        page.wait_for_timeout(400)
        assert page.evaluate("window.torchmat.viewer.frames") == frames  # at rest nothing is asked for
        page.mouse.move(box["x"] + 100, box["y"] + 100)
        page.mouse.down()
        page.mouse.move(box["x"] + 160, box["y"] + 120, steps=3)
        page.mouse.up()
        assert np.abs(picture(page) - turned).mean() > 1

        titles = page.locator("summary").all_inner_texts()
        assert titles == ["Saves and undo", "View", "Light", "Object", "Maps", "How true it is", "Files", "Keys and gestures"]
        assert "31.5" in page.text_content(".tmv-table") and page.locator(".tmv-thumb canvas").count() > 0
        assert page.get_by_role("button", name="Expand").count() == 0

        dragged = picture(page)
        path = next(folder.glob("latent*"))
        write_image(path, np.flipud(read_image(path)).copy())
        version = "() => window.torchmat.live.versions.latent > 1"
        until(page, version)
        assert np.abs(picture(page) - dragged).mean() > 0.5
        assert page.problems == []
        page.close()


def test_coarse_pictures_while_something_moves_and_one_at_a_time(chromium, tmp_path):
    folder = pictured(tmp_path / "wool")
    with served(folder) as studio:
        page = chromium.open(width=900, height=500)
        page.goto(studio.address)
        until(page, RESTED)
        found = page.evaluate("""async () => {
          const { viewer } = window.torchmat;
          const { ask } = viewer;
          const asked = [];
          let [at, most] = [0, 0];
          Object.assign(viewer.pace, { whole: 1500, took: () => {} }); // as of a slow machine, whatever this one does
          viewer.ask = async (look) => {
            at += 1;
            most = Math.max(most, at);
            asked.push([look.size[1], viewer.state.view.phi, look.view]);
            const png = await ask(look);
            at -= 1;
            return png;
          };
          for (let phi = 1; phi <= 60; phi += 1) {
            viewer.change((state) => { state.view.phi = phi; });
            await new Promise((done) => { setTimeout(done, 5); });
          }
          while (viewer.asking || viewer.wanted || viewer.pace.moving || viewer.pace.coarse) await new Promise((done) => { setTimeout(done, 20); });
          return { asked, most, wide: viewer.box.width };
        }""")
        told = page.evaluate("""() => {
          const { pace } = window.torchmat.viewer;
          delete pace.took;
          Object.assign(pace, { pictures: 0, whole: 400 });
          return [[1, 60000], [0.5, 200], [1, 400], [0.5, 100]].map(([share, took]) => {
            pace.coarse = false;
            pace.took(share, took);
            return [pace.whole, pace.coarse];
          });
        }""")
        assert told == [[400, False], [800, True], [600, False], [500, True]]  # the first waits for what is loaded
        sizes = [size for size, _, _ in found["asked"]]
        assert found["most"] == 1 and len(sizes) < 60  # the newest wish wins: those between were never asked for
        assert sizes[0] < 0.6 * sizes[-1] and sizes[-1] == max(sizes) and found["asked"][-1][1] == 60
        assert page.problems == []
        page.close()


def test_a_material_of_another_kind_in_its_place_is_shown_as_what_it_is(chromium, tmp_path):
    folder = pictured(tmp_path / "wool")
    with served(folder) as studio:
        page = chromium.open(width=360, height=300)
        page.goto(studio.address)
        until(page, RESTED)
        (folder / "report.json").unlink()
        tm.save_material(smooth("texture", side=8), folder)
        until(page, "() => window.torchmat?.viewer.context && window.torchmat.viewer.frames > 0")
        assert page.evaluate("window.torchmat.viewer.description.model") == "texture" and page.problems == []
        page.close()
