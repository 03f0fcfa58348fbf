"""Materials, and pages of them opened from disk as a user opens them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch
from tests.models.examples import make
from tests.web.browser import Chromium, Page

import torchmat as tm
from torchmat.models import Material
from torchmat.models.edit import resized

ROOT = "document.getElementById('torchmat-viewer').viewer"


def smooth(name: str, options: dict[str, Any] | None = None, side: int = 48, relief: bool = False) -> Material:
    """Return a material whose maps change over several texels, as a real one's do."""
    material = resized(make(name, options or {}, 6, 6, torch.float32), (side, side))
    if not relief:
        return material
    x = torch.arange(side, dtype=torch.float32) / side * 2 * torch.pi
    height = 0.02 * (torch.sin(2 * x)[:, None] * torch.cos(3 * x)[None])[None]
    return material.on_relief(height)


def exported(material: Material, path: Path, **options: Any) -> Path:
    """Return the page that the exporter writes of a material."""
    tm.export(material, path, "html", **options)
    return path


def opened(chromium: Chromium, path: Path, width: int = 640, height: int = 480, ready: bool = True, before: str = "", **settings: Any) -> Page:
    """Return a page from disk, without a network, at rest; `before` is a script that runs before those of the page."""
    page = chromium.open(width, height, reduced_motion="reduce", **settings)
    page.context.set_offline(True)
    if before:
        page.add_init_script(before)
    page.goto(path.as_uri())
    if ready:
        rested(page)
    return page


def rested(page: Page) -> None:
    """Wait until a page has drawn its full picture."""
    page.wait_for_function(f"{ROOT} && {ROOT}.frames > 0 && !{ROOT}.pace.moving && !{ROOT}.wanted && !{ROOT}.pace.sync && !{ROOT}.pace.coarse")


def asked(page: Page, what: str) -> Any:
    """Return what an expression of `viewer` is in a page."""
    return page.evaluate(f"() => {{ const viewer = {ROOT}; return {what}; }}")
