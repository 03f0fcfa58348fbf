"""The plan of the next photographs: as a table, as a picture of the hemisphere, and as files that a dome or a hand follows."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from torchmat import atomic, frames
from torchmat.btf.light_table import lp_text
from torchmat.fitting.certainty.plan import Plan
from torchmat.progress import phase
from torchmat.report.pictures import plotting, save_figure
from torchmat.report.tables import number, text_table
from torchmat.written import changed_files, write_record

_RECORD = "plan.json"
_FEW = 30  # lights: between so few nothing is drawn
_LABEL = {"boxstyle": "round,pad=0.15", "fc": "white", "ec": "none", "alpha": 0.8}
_FILES = (_RECORD, "plan.lp", "manifest.csv", "plan.png")


def degrees_of(direction: Tensor) -> list[tuple[float, float]]:
    """Return polar angle and azimuth, in degrees, of directions [n, 3]."""
    polar, azimuth = frames.to_polar(direction.double())
    return list(zip(torch.rad2deg(polar).tolist(), torch.rad2deg(azimuth).tolist(), strict=True))


def plan_table(plan: Plan) -> str:
    """Return a table of the photographs to take, the one that helps most first, with the error expected after each."""
    several = len(torch.unique(torch.cat((plan.view, plan.taken_view)), dim=0)) > 1
    header = ["photograph", "light polar", "light azimuth", *(["view polar", "view azimuth"] if several else []), "expected error after it"]
    rows = [["before", "", "", *(["", ""] if several else []), number(float(plan.expected[0]))]]
    pairs = zip(degrees_of(plan.light), degrees_of(plan.view), plan.expected[1:].tolist(), strict=True)
    for place, (light, view, error) in enumerate(pairs):
        angles = [f"{angle:.1f}" for angle in (*light, *(view if several else ()))]
        rows.append([str(place + 1), *angles, number(error)])
    return text_table(header, rows)


def plan_picture(plan: Plan, path: Path) -> Path:
    """Draw the hemisphere of lights from above, before and after: the expected error as colour, lights taken and proposed.

    Of several views the error is the mean over those of a light.
    """
    light, where = torch.unique(plan.target_light, dim=0, return_inverse=True)
    parts = [torch.zeros(len(light), dtype=torch.float64).index_add_(0, where, one.double()) for one in (plan.before, plan.after)]
    before, after = (part / torch.bincount(where, minlength=len(light)) for part in parts)
    most = max(float(before.max()), 1e-12)
    figure, axes = plotting().subplots(1, 2, figsize=(10, 5), layout="constrained")
    for axis, values, title in zip(axes, (before, after), ("before", f"with {len(plan.light)} more"), strict=True):
        drawn = _field(axis, light, values, most)
        axis.plot(*_places(plan.taken_light), "o", color="white", markeredgecolor="black", markersize=5, label="taken")
        if values is after:
            axis.plot(*_places(plan.light), "*", color="tab:cyan", markeredgecolor="black", markersize=13, label="to take")
            for place, (x, y) in enumerate(zip(*_places(plan.light), strict=True)):
                axis.annotate(str(place + 1), (x, y), textcoords="offset points", xytext=(8, 6), fontsize=8, bbox=_LABEL)
        error = float(plan.expected[0 if values is before else -1])
        axis.set_title(f"expected error {title}: {number(error)}", fontsize=10)
        axis.add_patch(plotting().Circle((0, 0), 90, fill=False, color="gray", linewidth=1))
        axis.set_xlim(-95, 95)
        axis.set_ylim(-95, 95)
        axis.set_aspect("equal")
        axis.set_axis_off()
    axes[1].legend(loc="lower right", fontsize=8)
    figure.colorbar(drawn, ax=list(axes), shrink=0.8, label=f"expected error of a light ({plan.space})")
    return save_figure(figure, Path(path))


def _field(axis: Any, light: Tensor, values: Tensor, most: float) -> Any:
    """Draw errors [m] toward lights [m, 3]: as a surface between them, or where they are few or on a line as dots."""
    colours = {"cmap": "magma", "vmin": 0, "vmax": most}
    spread = torch.linalg.matrix_rank(light[:, :2] - light[:, :2].mean(dim=0), atol=1e-3)
    if len(light) > _FEW and int(spread) == 2:
        return axis.tripcolor(*_places(light), values.numpy(), shading="gouraud", **colours)
    return axis.scatter(*_places(light), c=values.numpy(), s=150, linewidths=0, **colours)


def _places(direction: Tensor) -> tuple[Any, Any]:
    """Return x and y of lights on a disc whose radius is the polar angle in degrees."""
    polar, azimuth = frames.to_polar(direction.double())
    radius = torch.rad2deg(polar)
    return (radius * torch.cos(azimuth)).numpy(), (radius * torch.sin(azimuth)).numpy()


def check_target(target: str | Path, force: bool = False) -> bool:
    """Raise DataError unless `target` may be replaced: absent, empty, or an earlier plan as torchmat wrote it.

    With `force` an earlier plan may be replaced even so; True is returned when a backup must be kept.
    """
    record = Path(target) / _RECORD
    changed = changed_files(record) if os.path.isfile(record) else []
    return atomic.refuse_foreign(Path(target), lambda name: name in _FILES, "an earlier plan", changed, force)


def write_plan(plan: Plan, folder: str | Path, force: bool = False, pictures: bool = True) -> Path:
    """Write a plan as a folder that appears whole or not at all: `plan.json`, `plan.png`, and the directions as files.

    Those are an ``.lp`` of the new lights where all have the view along the normal, else a ``manifest.csv``: with the new
    photographs under those names beside it, it is read as any capture is.
    """
    target = Path(folder)
    backup = check_target(target, force)
    names = [f"next_{place + 1:03d}.jpg" for place in range(len(plan.light))]
    with atomic.building(target, backup=backup) as building:
        if bool((plan.view[:, 2] > 1 - 1e-6).all()):
            (building / "plan.lp").write_text(lp_text(names, plan.light), encoding="utf-8")
        else:
            (building / "manifest.csv").write_text(_manifest(names, plan), encoding="utf-8")
        if pictures:
            with phase("drawing the plan"):
                plan_picture(plan, building / "plan.png")
        rows = [
            {"file": name, "light": light, "view": view, "light_deg": angles, "expected": error}
            for name, light, view, angles, error in zip(
                names, plan.light.tolist(), plan.view.tolist(), degrees_of(plan.light), plan.expected[1:].tolist(), strict=True
            )
        ]
        write_record(building / _RECORD, json.loads(json.dumps({
            "space": plan.space, "taken": len(plan.taken_light), "expected": float(plan.expected[0]), "photographs": rows,
        })))
    return target


def _manifest(names: list[str], plan: Plan) -> str:
    lines = ["file,view_polar_deg,view_azimuth_deg,light_polar_deg,light_azimuth_deg"]
    for name, view, light in zip(names, degrees_of(plan.view), degrees_of(plan.light), strict=True):
        lines.append(",".join([name, *(f"{angle:.4f}" for angle in (*view, *light))]))
    return "\n".join([*lines, ""])
