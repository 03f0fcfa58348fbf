"""Pictures of a fit: target | fit | difference, error by angle, coverage, sphere. Matplotlib, to files."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchmat import colour
from torchmat.btf import Btf
from torchmat.errors import DataError, message
from torchmat.fitting import FitResult
from torchmat.geometry import Relief, normals_from_slopes, slopes_from_height
from torchmat.progress import progress
from torchmat.rendering import Scene
from torchmat.rendering.files import on_neutral
from torchmat.rendering.lights import as_light
from torchmat.rendering.mipmap import Pyramid
from torchmat.rendering.objects import shade_visible
from torchmat.report.inline import PNG_LEVEL
from torchmat.report.samples import Shown, degrees, difference_range, polar_deg

DPI = 120
_MASK_SAMPLES = 16  # images of which the brightest is drawn beneath a mask
LARGEST = 320  # pixels along a side of one picture: three stand side by side on a page
DIFFERENCE_COLOURS = "RdBu_r"


def plotting() -> Any:
    """Return pyplot, imported on first use and drawing to files only."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as pyplot

    return pyplot


def thinned(planes: Tensor, largest: int = LARGEST) -> Tensor:
    """Return planes [C, H, W] averaged over whole blocks of texels, so that neither side is above `largest`."""
    block = math.ceil(max(planes.shape[1:]) / largest)
    if block == 1:
        return planes
    down, across = (min(block, size) for size in planes.shape[1:])
    return torch.nn.functional.avg_pool2d(planes[None].float(), (down, across))[0]


def colour_strip(steps: int = 100) -> Tensor:
    """Return the values -1 to 1 of a colour bar as one row of a picture, [1, 1, steps]."""
    return torch.linspace(-1, 1, steps)[None, None]


def _shown(image: Tensor) -> Any:
    return colour.display(image).permute(1, 2, 0).numpy()


def bare(axis: Any) -> None:
    """Leave an axis nothing but what is drawn in it.

    Ticks that nobody sees would still be made and measured to place the title: half the time that a sheet of maps takes.
    """
    axis.set_axis_off()
    axis.set_xticks([])
    axis.set_yticks([])


def save_figure(figure: Any, path: Path, placed: bool = False) -> Path:
    """Write and close a figure, cut to what is drawn unless it was `placed` by hand or has a layout of its own.

    Raises DataError, which names the file, when that fails.
    """
    placed = placed or figure.get_layout_engine() is not None
    packing = {"pil_kwargs": {"compress_level": PNG_LEVEL}} if path.suffix.lower() == ".png" else {}  # a PDF takes no such word
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        # To find what is drawn, everything is drawn twice.
        figure.savefig(path, dpi=DPI, bbox_inches=None if placed else "tight", metadata={"Software": None}, **packing)
    except (OSError, ValueError) as error:
        step = "Choose a name that ends in .png, in a folder that can be written to."
        raise DataError(message(str(path), "the picture", "be writable", str(error), step)) from error
    finally:
        plotting().close(figure)
    return path


def comparison_picture(rows: Sequence[Shown], path: Path) -> Path:
    """Draw target | fit | difference of chosen photographs, with one colour bar for all differences."""
    most = difference_range(rows)
    height = 2.9 * len(rows) + 0.75
    figure, axes = plotting().subplots(len(rows), 3, figsize=(9, height), squeeze=False, gridspec_kw={
        "left": 0.01, "right": 0.99, "bottom": 0.65 / height, "top": 1 - 0.45 / height, "wspace": 0.03, "hspace": 0.22,
    })
    for line, row in zip(axes, rows, strict=True):
        pictures = (_shown(thinned(row.target)), _shown(thinned(row.fit)), thinned(row.difference[None])[0].numpy())
        for axis, picture, name in zip(line, pictures, ("target", "fit", "fit less target"), strict=True):
            drawn = axis.imshow(picture, cmap=DIFFERENCE_COLOURS, vmin=-most, vmax=most, interpolation="nearest")
            axis.set_title(name, fontsize=8, pad=2)
            bare(axis)
        beyond = "; beyond what the fit saw" if row.beyond else ""
        said = f"{row.why}: {row.directions}; {row.figures}; {row.brightness}{beyond}"
        line[0].text(0, 1.09, said, fontsize=8.5, transform=line[0].transAxes, weight="bold")
    bar = figure.add_axes((0.67, 0.45 / height, 0.31, 0.1 / height))
    figure.colorbar(drawn, cax=bar, orientation="horizontal").ax.tick_params(labelsize=7)
    words = "fit less target of the pictures as shown, where white is 1: blue is too dark, red too bright"
    figure.text(0.65, 0.45 / height, words, fontsize=8, ha="right")
    return save_figure(figure, path, placed=True)


def angle_picture(result: FitResult, path: Path) -> Path:
    """Plot relative error and PSNR against the polar angle of light and of view, for train and held-out samples."""
    figure, axes = plotting().subplots(1, 2, figsize=(9, 3.4), layout="constrained")
    styles = (("train", "--"), ("held_out", "-"))
    for which, style in styles:
        part = result.report[which]
        if not part:
            continue
        for angle in ("light", "view"):
            rows = [row for row in part["by_angle"] if row["angle"] == angle]
            middle = [(row["from_deg"] + row["to_deg"]) / 2 for row in rows]
            label = f"{angle}, {'held out' if which == 'held_out' else 'train'}"
            errors = [float("nan") if row["relative_error"] is None else row["relative_error"] for row in rows]
            axes[0].plot(middle, errors, style, marker="o", label=label)
            axes[1].plot(middle, [row["psnr_db"] for row in rows], style, marker="o", label=label)
    axes[0].set_ylabel("relative error")
    axes[1].set_ylabel("PSNR (dB)")
    for axis in axes:
        axis.set_xlabel("polar angle (degrees)")
        axis.set_xlim(0, 90)
        axis.grid(alpha=0.3)
    if axes[0].lines:
        axes[0].legend(fontsize=8)
    return save_figure(figure, path)


def coverage_picture(result: FitResult, path: Path, mask: Tensor | None = None) -> Path | None:
    """Draw which share of its unknowns each texel's samples determine; None when all determine the same.

    What is outside an object's `mask`, bool [H, W], is left blank.
    """
    if result.coverage is None:
        return None
    coverage = result.coverage[0]
    inside = torch.ones_like(coverage, dtype=torch.bool) if mask is None or mask.shape != coverage.shape else mask
    if float(coverage[inside].max() - coverage[inside].min()) < 1e-6:
        return None  # a sentence says it
    figure, axis = plotting().subplots(figsize=(4.4, 3.6), layout="constrained")
    drawn = axis.imshow(coverage.where(inside, torch.nan).numpy(), vmin=0, vmax=1, cmap="viridis", interpolation="nearest")
    axis.set_title("share of unknowns determined", fontsize=9)
    bare(axis)
    figure.colorbar(drawn)
    return save_figure(figure, path)


def history_picture(result: FitResult, path: Path) -> Path | None:
    """Plot the error of an iterative fit against seconds; None for a closed form."""
    if len(result.history) < 2:
        return None
    seconds, errors = zip(*result.history, strict=True)
    figure, axis = plotting().subplots(figsize=(4.4, 3.4), layout="constrained")
    axis.semilogy(seconds, errors, marker=".")
    axis.set_xlabel("seconds")
    axis.set_ylabel("mean squared residual of the solver")
    axis.grid(alpha=0.3)
    return save_figure(figure, path)


def sphere_picture(result: FitResult, path: Path, size: int = 320) -> Path:
    """Draw the material on a sphere under two lights, one picture each, before a neutral grey."""
    lights = ((-0.4, 0.5, 0.768), (0.85, 0.2, 0.487))
    figure, axes = plotting().subplots(1, len(lights), figsize=(6.4, 3.5), layout="constrained")
    # What the camera sees is found once, and with more than one ray only where a pixel lies on an edge.
    visible = Scene("sphere", size=size, repeat=2.0, edges_only=True).visible(result.material.dtype)
    pyramid = Pyramid(result.material)
    for axis, light in zip(axes, lights, strict=True):
        picture = on_neutral(shade_visible(pyramid, visible, [as_light(light)], soften=True), visible.coverage)
        axis.imshow(_shown(picture.float()))
        axis.set_title(f"light {degrees(polar_deg(torch.tensor(light)))}", fontsize=9)
        bare(axis)
    return save_figure(figure, path)


def directions_picture(btf: Btf, path: Path) -> Path:
    """Draw where lights and views lie on the projected hemisphere, rings every 30 degrees."""
    pyplot = plotting()
    figure, axes = pyplot.subplots(1, 2, figsize=(7, 3.7), layout="constrained")
    for axis, name, directions in zip(axes, ("lights", "views"), (btf.lights, btf.views), strict=True):
        for polar in (30, 60, 90):
            radius = math.sin(math.radians(polar))
            axis.add_patch(pyplot.Circle((0, 0), radius, fill=False, color="0.8", linewidth=0.8))
            axis.text(0, -radius, f"{polar}°", fontsize=7, color="0.5", ha="center", va="center", backgroundcolor="white")
        axis.plot(directions[:, 0].numpy(), directions[:, 1].numpy(), ".", markersize=5)
        axis.set_title(f"{len(directions)} {name}, by polar angle", fontsize=9)
        axis.set_xlim(-1.1, 1.1)
        axis.set_ylim(-1.1, 1.1)
        axis.set_aspect("equal")
        bare(axis)
    return save_figure(figure, path)


def mask_picture(btf: Btf, path: Path) -> Path | None:
    """Draw the brightest of some images with the outline of the object mask, what is outside dimmed; None without a mask."""
    if btf.mask is None:
        return None
    whole, rows = btf.unmasked(), torch.linspace(0, len(btf) - 1, min(len(btf), _MASK_SAMPLES)).round().long().unique()
    brightest = whole.images(rows).amax(dim=0)
    bright = brightest[:, btf.mask].flatten().sort().values
    shown = _shown(brightest / bright[int(0.99 * (len(bright) - 1))].clamp(min=1e-6))
    shown = np.where(btf.mask.numpy()[:, :, None], shown, 0.35 * shown + 0.3 * np.array([1.0, 0.2, 0.2]))
    figure, axis = plotting().subplots(figsize=(5, 5))
    axis.imshow(shown, interpolation="nearest")
    axis.contour(btf.mask.numpy(), levels=[0.5], colors="tab:red", linewidths=0.8)
    axis.set_title(f"object ({100 * btf.object_share:.1f} % of the texels) by {Path(btf.source.mask).name}", fontsize=9)
    bare(axis)
    return save_figure(figure, path)


def write_pictures(btf: Btf, result: FitResult, folder: Path, rows: Sequence[Shown], show: bool | None = False) -> list[Path]:
    """Write all pictures of a fit into `folder`, of `rows` the comparison; return their paths.

    `show` the progress, None on a terminal only.
    """
    drawings: list[Callable[[], Path | None]] = [
        lambda: comparison_picture(rows, folder / "comparison.png"),
        lambda: angle_picture(result, folder / "error_by_angle.png"),
        # One thing before a background covers no other.
        lambda: None if btf.mask is not None else sphere_picture(result, folder / "sphere.png"),
        lambda: coverage_picture(result, folder / "coverage.png", btf.mask),
        lambda: history_picture(result, folder / "error_by_seconds.png"),
        lambda: directions_picture(btf, folder / "directions.png"),
        lambda: mask_picture(btf, folder / "object_mask.png"),
    ]
    if result.material.has_relief:
        drawings.append(lambda: relief_picture(_relief_of(result), folder / "relief.png"))
        drawings.append(lambda: oblique_picture(btf, result, folder / "oblique.png"))
    written = [draw() for draw in progress(drawings, "drawing pictures", show=show)]
    return [path for path in written if path is not None]


def _relief_of(result: FitResult) -> Relief:
    if result.relief is not None:
        return result.relief
    height = result.material.maps["height"].detach()
    return Relief(height, normals_from_slopes(slopes_from_height(height, tiles=result.material.tiles)))


def oblique_picture(btf: Btf, result: FitResult, path: Path) -> Path:
    """Draw the flattest views of the held-out samples: measured, as the relief predicts them, and without parallax."""
    indices = result.split.held_out if len(result.split.held_out) else result.split.train
    lit = indices[btf.light[indices, 2] > 0.5]
    indices = lit if len(lit) else indices
    rows = indices[btf.view[indices, 2].argsort()[:: max(1, len(indices) // 8)][:3]]
    figure, axes = plotting().subplots(len(rows), 3, figsize=(9, 3.2 * len(rows)), squeeze=False)
    flat = result.material.surface()
    for line, sample in zip(axes, rows.tolist(), strict=True):
        light, view = (planes[0] for planes in btf.directions([sample], result.material.dtype))
        with torch.no_grad():
            pictures = (btf.image(sample), result.material.shade(light, view), flat.shade(light, view))
        scale = max(float(pictures[0].flatten().sort().values[int(0.99 * (pictures[0].numel() - 1))]), 1e-6)
        directions = f"light {degrees(polar_deg(btf.light[sample]))}, view {degrees(polar_deg(btf.view[sample]))}"
        names = (f"measured: {directions}", "predicted on the relief", "without parallax and shadow")
        for axis, picture, name in zip(line, pictures, names, strict=True):
            axis.imshow(_shown(picture.float() / scale), interpolation="nearest")
            axis.set_title(name, fontsize=8)
            bare(axis)
    return save_figure(figure, path)


def relief_picture(relief: Relief, path: Path) -> Path:
    """Draw a relief: shaded from the upper left, its height, its normals, and how far they are trusted."""
    light = torch.tensor([-0.5, 0.5, 0.707])
    shaded = torch.einsum("chw,c->hw", relief.normal.float(), light / light.norm()).clamp(0, 1)
    panels = [
        ("shaded from the upper left", shaded.numpy(), "gray"),
        ("height (texture widths)", relief.height[0].numpy(), "viridis"),
        ("normal (x, y, z as colour)", (relief.normal * 0.5 + 0.5).clamp(0, 1).permute(1, 2, 0).numpy(), None),
    ]
    if relief.confidence is not None:
        panels.append(("confidence", relief.confidence[0].numpy(), "viridis"))
    figure, axes = plotting().subplots(1, len(panels), figsize=(4 * len(panels), 3.6))
    for axis, (title, picture, colours) in zip(axes, panels, strict=True):
        drawn = axis.imshow(picture, cmap=colours, interpolation="nearest")
        axis.set_title(title, fontsize=9)
        bare(axis)
        if colours == "viridis":
            figure.colorbar(drawn, ax=axis, shrink=0.8)
    return save_figure(figure, path)
