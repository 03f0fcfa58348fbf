"""The studio's page in a browser: what is saved is seen."""

from __future__ import annotations

import pytest
from tests.studio.serving import served, wool

from torchmat.images import read_image, write_image

pytest.importorskip("uvicorn")


def opened(chromium, studio, **settings):
    page = chromium.open(**settings)
    page.goto(studio.address)
    try:
        page.wait_for_function("window.torchmat && window.torchmat.viewer.frames > 0", timeout=8000)
    except Exception:
        raise AssertionError(page.problems) from None
    return page


PIXEL = """async () => {
  const { viewer } = window.torchmat;
  const pixels = viewer.scene.picture(viewer.picture(), 32, 32);
  return [...pixels.subarray(4 * (32 * 16 + 16), 4 * (32 * 16 + 16) + 3)];
}"""


def until(page, condition, argument=None):
    page.wait_for_function(condition, arg=argument, timeout=10_000)


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
