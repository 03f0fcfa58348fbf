"""The page of a capture: what each step found, with the figure that would show that it went wrong, and its pictures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Tensor

from torchmat.capturing.scene import Step
from torchmat.report.inline import data_uri
from torchmat.report.page import Markup, Picture, details, figure, listed, page, paragraph, section, table

_LARGEST = 900  # pixels along the longer side of a picture on the page


def steps_table(steps: Sequence[Step]) -> str:
    """Return what each step found and its residual as lines of text."""
    width = max(len(step.name) for step in steps)
    return "\n".join(f"{step.name:<{width}}  {step.found}{f'; {step.residual}' if step.residual else ''}" for step in steps)


def capture_page(out: str | Path, steps: Sequence[Step]) -> str:
    """Return the page of a capture."""
    body = [table(("step", "found", "residual"), [(step.name, step.found, step.residual) for step in steps], words=(1, 2))]
    body += [section(step.name.capitalize(), *_shown(step)) for step in steps]
    return page(f"Capture of {Path(out).name}", body)


def _shown(step: Step) -> list[Markup]:
    parts = [paragraph(f"{step.found}. {step.residual}"), listed(step.notes, "cautions")]
    pictures = "".join(figure(Picture(data_uri(small(planes))), caption) for caption, planes in step.pictures.items())
    parts += [Markup(f'<div class="plots">{pictures}</div>')] if pictures else []
    if step.rows:
        words = [place for place, cell in enumerate(step.rows[0]) if isinstance(cell, str)]
        parts.append(details(f"{len(step.rows)} rows", table(step.header, step.rows, words=words)))
    return parts


def small(planes: Tensor) -> Tensor:
    """Return planes [3, H, W] averaged by a whole factor to at most 900 pixels along the longer side."""
    factor = -(-max(planes.shape[-2:]) // _LARGEST)
    return planes if factor == 1 else torch.nn.functional.avg_pool2d(planes[None], factor)[0]
