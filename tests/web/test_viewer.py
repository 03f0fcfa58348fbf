"""The page of a material: what hands, sliders and keys do to it, that it rests, and that nothing overlaps."""

from __future__ import annotations

import json
import math
import re

import pytest
import torch
from tests.web.pages import ROOT, asked, exported, opened, rested, smooth

import torchmat as tm
from torchmat.errors import RangeError

REPORT = {"held_out_after_export": {"relative_error": 0.03125, "psnr_db": 31.5, "ssim": None}, "train": {"relative_error": 0.02}}
ANGLES = "[viewer.state.view.theta, viewer.state.view.phi, viewer.state.lights[0].theta, viewer.state.lights[0].phi]"


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return exported(smooth("ptm"), tmp_path_factory.mktemp("pages") / "ptm.html", report=REPORT, title='A "title" <b>')


@pytest.fixture(scope="module")
def page(chromium, path):
    page = opened(chromium, path, 400, 460)
    yield page
    assert page.problems == []
    page.close()


@pytest.fixture(autouse=True)
def at_the_start(request):
    if "page" in request.fixturenames:
        asked(request.getfixturevalue("page"), "viewer.reset()")


def test_it_is_one_small_file_that_asks_for_nothing(path):
    text = path.read_text(encoding="utf-8")
    held = re.search(r'"data": "([^"]*)"', text)[1]
    assert len(text.encode()) - len(held) < 300_000 and len(held) > 48 * 48
    assert "http" not in text.replace("http://www.w3.org", "") and "<link" not in text and 'src="data:image/jpeg' in text
    assert "A &quot;title&quot; &lt;b&gt;" in text


def orbited(theta, phi, right, up):
    """Return the angles of a direction after a turn round the vertical axis and upward, degrees."""
    flat = math.sin(math.radians(theta))
    x, y, z = flat * math.cos(math.radians(phi)), flat * math.sin(math.radians(phi)), math.cos(math.radians(theta))
    azimuth, height = math.atan2(x, z) + math.radians(right), math.asin(y) + math.radians(up)
    x, y, z = math.cos(height) * math.sin(azimuth), math.sin(height), math.cos(height) * math.cos(azimuth)
    return math.degrees(math.acos(z)), math.degrees(math.atan2(y, x))


def test_drags_turn_the_view_and_with_shift_the_light(page):
    box = page.locator("canvas").first.bounding_box()
    middle = (box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    start = asked(page, ANGLES)

    def drag(right, down):
        page.mouse.move(*middle)
        page.mouse.down()
        page.mouse.move(middle[0] + right, middle[1] + down, steps=4)
        page.mouse.up()
        return asked(page, ANGLES)

    turned = drag(40, 25)
    assert turned[2:] == start[2:]
    # 0.4 degrees a pixel: the hand goes right, the camera left; the hand goes down, the camera up.
    assert turned[:2] == pytest.approx(orbited(*start[:2], -16, 10), abs=1e-6)
    page.keyboard.down("Shift")
    lit = drag(-30, 0)
    page.keyboard.up("Shift")
    assert lit[:2] == turned[:2] and lit[2:] != turned[2:]


def test_the_wheel_and_keys_do_what_the_page_says(page):
    page.locator("canvas").first.hover()
    page.mouse.wheel(0, -100)
    assert asked(page, "viewer.state.view.zoom") == pytest.approx(1.1)
    asked(page, "viewer.change((state) => { state.lights[0].kind = 'point'; })")
    page.keyboard.down("Shift")
    page.mouse.wheel(0, 100)
    page.keyboard.up("Shift")
    assert asked(page, "viewer.state.lights[0].distance") == pytest.approx(3.3)
    asked(page, "viewer.reset()")
    page.locator("canvas").first.focus()
    start = asked(page, ANGLES)
    for key, differs in (("ArrowLeft", (0, 1)), ("ArrowDown", (0, 1)), ("Shift+ArrowRight", (2, 3)), ("Alt+ArrowUp", (0, 1))):
        page.keyboard.press(key)
        now = asked(page, ANGLES)
        assert all((now[k] != start[k]) == (k in differs) for k in range(4)), key
        start = now
    page.keyboard.press("o")
    assert asked(page, "viewer.state.mesh") == "quad" and "quad" in page.inner_text("[role=status]")
    page.keyboard.press("PageUp")
    assert asked(page, "viewer.state.exposure") == 0.25
    page.keyboard.press("0")
    assert asked(page, "[viewer.state.mesh, viewer.state.exposure]") == ["teapot", 0]


def test_sliders_numbers_and_state_say_the_same(page):
    view = page.locator(".tmv-panel").first
    slider, typed = (view.locator(f"input[type={kind}]").first for kind in ("range", "number"))
    typed.fill("-120.5")
    assert asked(page, "viewer.state.view.theta") == -120.5 and float(slider.input_value()) == pytest.approx(-120, abs=1)
    slider.fill("25")
    assert asked(page, "viewer.state.view.theta") == 25 and typed.input_value() == "25"
    typed.fill("500")  # out of range: nothing changes
    assert asked(page, "viewer.state.view.theta") == 25
    typed.blur()
    assert typed.input_value() == "25"


def test_it_rests_without_drawing_and_sweeps_when_asked(page):
    rested(page)
    # At rest nothing is due that could draw: no frame is asked for, no picture is awaited, and no timer runs.
    still = "[viewer.frames, viewer.wanted, viewer.pace.sync, viewer.pace.moving, viewer.pace.coarse]"
    before = asked(page, still)
    assert before[1:] == [0, None, False, False]
    page.evaluate("() => new Promise((done) => { let k = 30; const next = () => (k-- ? requestAnimationFrame(next) : done()); next(); })")
    assert asked(page, still) == before
    start = asked(page, "viewer.state.lights[0].phi")
    sweep = page.get_by_role("button", name="Sweep the light's phi")
    sweep.dispatch_event("click")
    page.wait_for_function(f"{ROOT}.frames > {before[0] + 2} && {ROOT}.state.lights[0].phi !== {start}")
    # Out of sight it does not draw. Scrolled at once: to wait until nothing moves would be to wait for ever.
    page.evaluate("document.querySelector('.tmv-side').lastElementChild.scrollIntoView()")
    page.wait_for_function(f"{ROOT}.hidden && !{ROOT}.wanted")
    before = asked(page, "viewer.frames")
    page.evaluate(f"{ROOT}.canvas.scrollIntoView()")
    page.wait_for_function(f"!{ROOT}.hidden && {ROOT}.frames > {before}")
    sweep.dispatch_event("click")
    assert asked(page, "viewer.state.sweeps") == []
    rested(page)


SHOWN = """(() => {
  const rows = ['view', 'light'].flatMap((whose) => ['theta', 'phi'].map((angle) => [...document.querySelectorAll(`[aria-label="${whose} ${angle}, degrees"]`)]));
  return rows.map(([range, typed]) => [Number(range.value), Number(typed.value), range.min, range.max]);
})()"""


def test_angles_are_the_same_however_they_are_given(page):
    def said(expected=None):
        """Return the four angles, which sliders and fields must show as the state has them, to their steps."""
        state, shown = asked(page, ANGLES), page.evaluate(SHOWN)
        assert expected is None or state == pytest.approx(expected, abs=1e-6)
        for angle, (slider, typed, low, high), ends in zip(state, shown, (("-180", "180"), ("0", "360")) * 2, strict=True):
            assert slider == pytest.approx(angle, abs=0.5 + 1e-6) and typed == pytest.approx(angle, abs=0.05 + 1e-6)
            assert (low, high) == ends and float(low) <= angle <= float(high)
        return state

    def field(whose, angle, kind):
        return page.locator(f"[aria-label='{whose} {angle}, degrees'][type={kind}]")

    now = start = said()
    for at, (whose, angle) in enumerate((("view", "theta"), ("view", "phi"), ("light", "theta"), ("light", "phi"))):
        low, high = ((-180, 180), (0, 360))[at % 2]
        for value in (low, high, low + 91.5):  # typed
            field(whose, angle, "number").fill(str(value))
            field(whose, angle, "number").blur()
            now = said([*now[:at], value, *now[at + 1 :]])
        for value in (low - 1, high + 1):
            field(whose, angle, "number").fill(str(value))
            field(whose, angle, "number").blur()
            said(now)
        field(whose, angle, "range").fill(str(low + 40))
        now = said([*now[:at], low + 40, *now[at + 1 :]])
        field(whose, angle, "range").press("ArrowRight")  # keys on a slider
        now = said([*now[:at], low + 41, *now[at + 1 :]])
    assert [angle for angle in start if angle in now] == []
    page.get_by_role("button", name="Start again").click()
    said(start)
    page.locator("canvas").first.focus()  # keys on the picture
    for key, at, right in (("ArrowLeft", 0, 5), ("Shift+ArrowRight", 2, 5), ("Alt+Shift+ArrowLeft", 2, -1)):
        before = said()
        page.keyboard.press(key)
        theta, phi = orbited(*before[at : at + 2], right, 0)
        now = said()
        assert [direction(*now[:2]), direction(*now[2:])] == [
            pytest.approx(direction(theta, phi) if at == place else direction(*before[place : place + 2]), abs=1e-6) for place in (0, 2)
        ]
    box = page.locator("canvas").first.bounding_box()
    for shift in (False, True):  # drags, round and over the pole, where angles must stay within their ends
        page.mouse.move(box["x"] + 200, box["y"] + 100)
        if shift:
            page.keyboard.down("Shift")
        page.mouse.down()
        for step in range(12):
            page.mouse.move(box["x"] + 200 - 60 * (step % 4), box["y"] + 100 + 20 * step)
            said()
        page.mouse.up()
        page.keyboard.up("Shift")
        assert said()[2 * shift : 2 * shift + 2] != pytest.approx(start[2 * shift : 2 * shift + 2], abs=1)
    page.locator("canvas").first.hover()
    page.mouse.wheel(0, -300)
    assert asked(page, "viewer.state.view.zoom") == pytest.approx(1.1**3)
    distance = page.locator(".tmv-panel", has_text="Camera").locator("input[type=number]").last
    assert float(distance.input_value()) == pytest.approx(1.1**-3, abs=0.005)
    page.get_by_role("button", name="Start again").click()
    said(start)
    assert float(distance.input_value()) == 1 == asked(page, "viewer.state.view.zoom")


def direction(theta, phi):
    """Return x, y, z of two angles in degrees."""
    theta, phi = math.radians(theta), math.radians(phi)
    return [math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta)]


def test_lights_come_and_go_up_to_four(page):
    for count in (2, 3, 4):
        page.get_by_role("button", name="Add a light").click()
        assert asked(page, "viewer.state.lights.length") == count
    assert page.get_by_role("button", name="Add a light").count() == 0
    page.get_by_role("button", name="Light 2").click()
    assert asked(page, "viewer.state.active") == 1
    page.get_by_role("button", name="Take this light away").click()
    assert asked(page, "[viewer.state.lights.length, viewer.state.active]") == [3, 1]


def test_an_environment_adds_its_light(page):
    mean = "((more) => { const p = viewer.scene.picture({ ...viewer.picture(), background: [0, 0, 0], ...more }, 40, 40);" \
        " return p.reduce((sum, one) => sum + one, 0) / p.length; })"
    alone = asked(page, f"{mean}({{}})")
    for name in ("sky", "studio", "evening"):
        assert asked(page, f"{mean}({{ environment: '{name}' }})") > alone + 3
    assert asked(page, f"{mean}({{ lights: [] }})") == pytest.approx(255 / 4, abs=0.01)  # black, but for the opacity


def test_what_is_known_stands_beside_it(page):
    page.evaluate("() => document.querySelectorAll('details').forEach((one) => { one.open = true; })")
    words = page.inner_text(".tmv-side")
    assert "polynomial" in words and "0.0312" in words and "31.5" in words and "SSIM)" not in words
    assert "turn the object" in words
    assert page.locator(".tmv-thumb canvas").count() == 1
    assert page.locator("canvas").first.get_attribute("aria-label").startswith("The material on: teapot. Arrow keys")
    fields = "[...document.querySelectorAll('input, select, button')]"
    unnamed = page.evaluate(f"() => {fields}.filter((one) => !one.ariaLabel && !one.labels?.length && !one.innerText).length")
    assert unnamed == 0


LAID_OUT = """() => {
  const parts = 'h1, header p, .tmv-stage, .tmv-row > *, summary, .tmv-buttons > *, .tmv-tabs > *, .tmv-maps li, .tmv-table';
  const boxes = [...document.querySelectorAll(parts)]
    .filter((one) => one.checkVisibility() && one.getBoundingClientRect().width > 0)
    .map((one) => [one.textContent.slice(0, 20) || one.tagName, one.getBoundingClientRect()]);
  const over = [];
  const side = document.querySelector('.tmv-side').getBoundingClientRect();
  boxes.forEach(([name, a], k) => boxes.slice(k + 1).forEach(([other, b]) => {
    const [wide, high] = [Math.min(a.right, b.right) - Math.max(a.left, b.left), Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top)];
    if (wide > 1 && high > 1) over.push(`${name} / ${other}`);
  }));
  const out = boxes.filter(([, box]) => box.right > innerWidth + 1 || box.left < -1).map(([name]) => name);
  return { over, out, scrolls: document.documentElement.scrollWidth > innerWidth, side: side.width, count: boxes.length };
}"""


@pytest.mark.parametrize("width, height", [(1280, 720), (390, 844)])
def test_nothing_overlaps(chromium, path, width, height):
    page = opened(chromium, path, width, height)
    page.evaluate("() => document.querySelectorAll('details').forEach((one) => { one.open = true; })")
    found = page.evaluate(LAID_OUT)
    assert (found["over"], found["out"], found["scrolls"]) == ([], [], False) and found["count"] > 40
    assert page.problems == []
    page.close()


def test_fingers_turn_and_two_zoom(chromium, path):
    page = opened(chromium, path, 390, 600, has_touch=True)
    assert asked(page, "viewer.canvas.width") <= 2 * 390
    found = page.evaluate(f"""() => {{
      const viewer = {ROOT}, {{ canvas }} = viewer;
      const send = (kind, pointerId, clientX, clientY) =>
        canvas.dispatchEvent(new PointerEvent(kind, {{ pointerId, clientX, clientY, pointerType: 'touch', bubbles: true }}));
      canvas.setPointerCapture = () => {{}};
      const told = () => [viewer.state.view.theta, viewer.state.view.zoom, viewer.state.lights[0].theta];
      const all = [told()];
      send('pointerdown', 1, 100, 200); send('pointermove', 1, 130, 200); all.push(told());
      send('pointerdown', 2, 200, 200); send('pointermove', 2, 235, 200); all.push(told());
      send('pointerup', 1, 0, 0); send('pointerup', 2, 0, 0); send('pointermove', 2, 10, 10); all.push(told());
      return all;
    }}""")
    assert found[1][0] != found[0][0] and found[1][1:] == found[0][1:]
    assert found[2][1] == pytest.approx(1.5) and found[2][0] == found[1][0] and found[2][2] != found[1][2]
    assert found[3] == found[2]
    page.close()


def test_a_browser_without_webgl_says_so_and_has_pictures(chromium, path):
    before = "const old = HTMLCanvasElement.prototype.getContext;" \
        "HTMLCanvasElement.prototype.getContext = function (kind, ...more) { return kind === 'webgl2' ? null : old.call(this, kind, ...more); };"
    page = opened(chromium, path, ready=False, before=before)
    page.wait_for_selector("[role=note]")
    assert "WebGL 2" in page.inner_text("[role=note]") and "0.0312" in page.text_content(".tmv-side")
    assert page.evaluate("document.querySelector('.tmv-stills img').naturalWidth") > 200
    assert page.problems == []
    page.close()


def test_a_shader_that_is_refused_is_said(chromium, tmp_path):
    path = exported(smooth("texture", side=8), tmp_path / "broken.html")
    path.write_text(path.read_text(encoding="utf-8").replace("in vec3 scene_normal;", "in vec3 scene_lost;"), encoding="utf-8")
    page = opened(chromium, path, ready=False)
    page.wait_for_selector("[role=note]")
    assert "could not be drawn here" in page.inner_text("[role=note]") and page.locator(".tmv-stills img").count() == 1
    page.close()


def test_a_phone_without_floating_point_targets_draws_the_same(chromium, page, path):
    picture = "[...viewer.scene.picture(viewer.picture(), 64, 64)]"
    expected = torch.tensor(asked(page, picture))
    without = "const old = WebGL2RenderingContext.prototype.getExtension;" \
        "WebGL2RenderingContext.prototype.getExtension = function (name) { return /float/.test(name) ? null : old.call(this, name); };"
    phone = opened(chromium, path, 390, 560, before=without, device_scale_factor=3, has_touch=True, is_mobile=True)
    assert asked(phone, "viewer.context.caps.float") is False and asked(phone, "viewer.canvas.width") <= 2 * 390
    asked(phone, "viewer.reset()")
    found = torch.tensor(asked(phone, picture))
    # Half floats of coefficients that nearly cancel; measured 1.
    assert int((found - expected).abs().max()) <= 3 and phone.problems == []
    phone.close()


def test_a_context_that_was_lost_comes_back(page):
    picture = "(() => { const p = viewer.scene.picture(viewer.picture(), 30, 30); return p.reduce((sum, one) => sum + one, 0); })()"
    before = asked(page, picture)
    page.evaluate(f"""async () => {{
      const {{ gl, canvas }} = {ROOT}.context;
      const loss = gl.getExtension('WEBGL_lose_context');
      const heard = (name) => new Promise((done) => canvas.addEventListener(name, () => setTimeout(done, 20), {{ once: true }}));
      const lost = heard('webglcontextlost');
      loss.loseContext();
      await lost;
      const back = heard('webglcontextrestored');
      loss.restoreContext();
      await back;
    }}""")
    assert asked(page, picture) == before > 0


def test_models_without_a_shader_are_shown_by_pictures(chromium, tmp_path):
    path = tmp_path / "pca.html"
    losses = tm.export(smooth("pca", side=8), path, "html")
    assert losses.exact == () and set(losses.lost) >= {"component", "weight"}
    page = opened(chromium, path, ready=False)
    page.wait_for_selector("[role=note]")
    assert page.locator(".tmv-stills img").count() == 8 and "no shader" in page.inner_text("[role=note]")
    assert path.stat().st_size < 300_000 and page.problems == []
    page.close()


def test_losses_and_size(tmp_path):
    small = smooth("distribution", {"parts": ["normal"]}, relief=True)
    losses = tm.export(small, tmp_path / "a.html", "html")
    assert losses.lost == {} and set(losses.exact) | set(losses.approximated) == {spec.name for spec in small.specs()}
    losses = tm.export(small, tmp_path / "b.html", "html", texels=20)
    assert losses.approximated["height"] == "(1, 48, 48) becomes (1, 20, 20)"
    assert "The maps are shown in 20 x 20 texels; the material has 48 x 48." in (tmp_path / "b.html").read_text(encoding="utf-8")
    table = json.loads((tmp_path / "b.html.loss.json").read_text())
    assert table["options"] == {"mesh": "teapot", "title": "", "report": None, "texels": 20}
    for options, words in (
        ({"mesh": "bunny"}, "mesh must be one of quad, .*; it is 'bunny'"), ({"mesh": 3}, "mesh must be a shape's name or a mesh; it is 3"),
        ({"texels": 0}, "texels must be a whole number of at least 1; it is 0"), ({"report": 3}, "report must be a mapping; it is int"),
    ):
        with pytest.raises(RangeError, match=words):
            tm.export(small, tmp_path / "c.html", "html", **options)
    assert not (tmp_path / "c.html").exists()


def test_the_command_takes_a_mesh_file_and_the_report_beside_the_material(tmp_path, monkeypatch):
    from torchmat.cli import main

    monkeypatch.chdir(tmp_path)
    tm.save_material(smooth("texture", side=8), "wool")
    (tmp_path / "wool" / "report.json").write_text(json.dumps(REPORT))
    (tmp_path / "tent.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n")
    for options, words in ((["--mesh", "tent.obj"], ['"name": "tent"', "0.0312"]), (["--to", "html", "--mesh", "torus"], ['"shape": "torus"'])):
        main(["export", "wool", "--out", f"{len(options)}.html", *options])
        text = (tmp_path / f"{len(options)}.html").read_text(encoding="utf-8")
        assert all(word in text for word in words)


def test_a_mesh_of_ones_own_is_held(chromium, tmp_path):
    from torchmat.rendering.shapes import make_mesh

    mesh = make_mesh("torus", segments=30)
    object.__setattr__(mesh, "name", "my ring")
    page = opened(chromium, exported(smooth("lambert", side=12), tmp_path / "ring.html", mesh=mesh))
    assert asked(page, "viewer.state.mesh") == "my ring"
    own = asked(page, "Object.fromEntries(['position', 'normal', 'uv', 'tangent', 'faces'].map((part) => [part, [...viewer.scene.mesh[part]]]))")
    for part, bound in (("position", 2e-5), ("normal", 1e-4), ("uv", 0)):
        assert float((torch.tensor(own[part]) - getattr(mesh, part).flatten()).abs().max()) <= bound
    tangent = torch.tensor(own["tangent"]).reshape(-1, 4)
    assert float((tangent[:, :3] - mesh.tangent).abs().max()) < 1e-4 and bool((tangent[:, 3] == mesh.handedness).all())
    assert own["faces"] == mesh.faces.flatten().tolist() and page.problems == []
    page.close()
