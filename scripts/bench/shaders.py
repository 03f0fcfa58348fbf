"""How far pages' shaders are from `shade`, and how long a changed map takes: ``python scripts/bench/shaders.py``, with Chromium."""

from __future__ import annotations

import sys
from pathlib import Path
from statistics import median
from typing import Any

import torch

ROOT = Path(__file__).resolve().parents[2]
sys.path[:1] = [str(ROOT), str(ROOT / "scripts" / "bench")]

from measure import save  # noqa: E402
from tests.models.examples import directions, make, per_image  # noqa: E402
from tests.web.browser import Chromium, missing  # noqa: E402
from tests.web.cases import CASES, bumps, hard_and_random, make_exact  # noqa: E402
from tests.web.drawing import Drawing, relative_error  # noqa: E402

from torchmat.models import Material  # noqa: E402
from torchmat.models.storage import StoredAs  # noqa: E402

_SIZE, _REPEATS = 512, 21
# A pass that reads the texture, so that its picture is there before the clock is read.
_UPDATES = """
([name, repeats]) => {
  const {context, material} = drawing, target = context.texture(1, 1, 4);
  const source = `precision highp float; precision highp sampler2DArray; uniform sampler2DArray map; out vec4 seen;
    void main() { seen = texelFetch(map, ivec3(0), 0); }`;
  return Array.from({length: repeats}, () => {
    const start = performance.now();
    material.update(name, material.entries.get(name), material.buffers[name]);
    context.pass(source, [target], [1, 1], (made) => context.sample(made, "map", material.maps.get(name).texture, 0));
    context.read(target, [1, 1]);
    return performance.now() - start;
  });
}
"""


def errors(drawing: Drawing, material: Material, light: torch.Tensor, view: torch.Tensor) -> list[float]:
    """Return the relative squared error of the picture under each light and view."""
    drawing.load(material)
    with torch.no_grad():
        return list(map(relative_error, drawing.evaluate(light, view, material.size), material.shade(light, view)))


def on_relief(material: Material, relief: str) -> Material:
    """Return a material on bumps, with ambient light."""
    raised = material.on_relief(bumps(*material.size), 0.1 * torch.rand(3, *material.size)).with_relief(relief)
    return raised.stored_at({"height": StoredAs(storage="float")}).as_exported()


def equality(drawing: Drawing) -> list[dict[str, Any]]:
    """Measure every model with every option."""
    rows, hard = [], hard_and_random()
    random = [per_image(directions(6, torch.float32, seed, lowest=0.15)) for seed in (5, 6)]
    for case in CASES:
        name, options = case.values
        torch.manual_seed(0)
        row = {"model": name, "options": options, "flat": max(errors(drawing, make_exact(name, options, 5, 7), *hard))}
        for relief in ("fast", "fine"):
            row[relief] = max(errors(drawing, on_relief(make_exact(name, options, 18, 23), relief), *random))
        rows.append(row)
        print(name, *(f"{row[what]:.0e}" for what in ("flat", "fast", "fine")), options, flush=True)
    return rows


def updates(drawing: Drawing) -> list[dict[str, Any]]:
    """Measure what a changed map of 8 bits takes, its smaller levels with it."""
    rows = []
    flat = make("distribution", {"lobes": 1, "parts": ["normal", "specular_mask"]}, _SIZE, _SIZE, torch.float32, storage="png8")
    for what, material in (("flat", flat), ("relief", flat.on_relief(bumps(_SIZE, _SIZE)))):
        drawing.load(material)
        for name in ("diffuse", "specular_mask", "normal", *(["height"] if what == "relief" else [])):
            found = drawing.page.evaluate(_UPDATES, [name, _REPEATS])
            rows.append({"what": f"{what}, {name}", "milliseconds": median(found), "least": min(found), "runs": _REPEATS})
            print(rows[-1], flush=True)
    return rows


def main() -> None:
    """Measure and keep."""
    why = missing()
    if why:
        sys.exit(why)
    browser = Chromium()
    drawing = Drawing(browser)
    save("shaders", [*equality(drawing), *updates(drawing)])
    browser.close()


if __name__ == "__main__":
    main()
