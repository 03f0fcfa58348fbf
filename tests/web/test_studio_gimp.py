"""GIMP itself paints a map in its batch mode, and the picture in the browser changes."""

from __future__ import annotations

import shutil
import subprocess

import pytest
from tests.studio.serving import served, wool
from tests.web.test_studio import PIXEL, opened, until

from torchmat.images import read_image

GIMP = shutil.which("gimp-console-2.10") or shutil.which("gimp-console") or shutil.which("gimp")
PAINT = """(let* ((image (car (gimp-file-load RUN-NONINTERACTIVE "{path}" "{path}")))
       (drawable (car (gimp-image-get-active-drawable image))))
  (gimp-context-set-foreground (list 255 0 0))
  (gimp-image-select-rectangle image CHANNEL-OP-REPLACE 0 0 16 16)
  (gimp-edit-fill drawable FILL-FOREGROUND)
  (gimp-file-save RUN-NONINTERACTIVE image drawable "{path}" "{path}"))"""


def test_what_gimp_paints_and_saves_is_seen(chromium, tmp_path):
    if GIMP is None:
        pytest.skip("no gimp: apt-get install --no-install-recommends gimp")
    folder = wool(tmp_path / "wool")
    path = folder / "diffuse.png"
    with served(folder) as studio:
        page = opened(chromium, studio)
        page.evaluate("window.torchmat.viewer.setMesh('quad')")
        before = page.evaluate(PIXEL)
        command = [GIMP, "-i", "-d", "-f", "--no-data", "--batch-interpreter", "plug-in-script-fu-eval"]
        script = PAINT.format(path=path)
        home = {"HOME": str(tmp_path), "GIMP2_DIRECTORY": str(tmp_path / "gimp"), "PATH": "/usr/bin:/bin"}
        done = subprocess.run([*command, "-b", script, "-b", "(gimp-quit 0)"], env=home, capture_output=True, text=True, timeout=180)
        painted = read_image(path)
        assert (painted == (255, 0, 0)).all(), done.stderr
        until(page, "() => { const b = new Uint8Array(window.torchmat.viewer.buffers.diffuse); return b[0] === 255 && b[1] === 0; }")
        red, green, blue = page.evaluate(PIXEL)
        assert red > green + 40 and red > blue + 40 and [red, green, blue] != before
        assert page.problems == [] and studio.live.says == {}
