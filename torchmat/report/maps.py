"""The maps of a material on one sheet, as an artist looks at them, and the material from nine sides."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torchmat import colour
from torchmat.create.controls import rotation_to_hue
from torchmat.errors import RangeError, ShapeError, check_finite, message
from torchmat.models import Material
from torchmat.models.storage import MapSpec
from torchmat.rendering import render
from torchmat.report.pictures import plotting, save_figure
from torchmat.report.tables import number

_COLUMNS = 4
_LARGEST = 512  # texels along a side of a panel; the sheet shows no more
_DECADES = 1e3  # from the brightest to where the logarithm turns linear
_LIGHT = (-0.5, 0.5, 0.707)
POLAR_DEG = (0.0, 25.0, 50.0)
# Seen against the light, where its mirror direction lies, from the side, and from where the light comes.
AZIMUTH_DEG = (315.0, 45.0, 135.0)


class _Panel(NamedTuple):
    """A title and what draws on an axis."""

    title: str
    draw: Callable[[Any], None]


def maps_picture(material: Material, path: Path, half: Tensor | None = None) -> Path:
    """Draw every map of a material on one sheet.

    Colour is shown in sRGB, one channel in grey from its least to its largest value, a normal as colour, a rotation as
    hue, other signed triples about grey, tables and curves as such. Specular maps are on a logarithmic scale inside
    the disc's rim, with the half vectors `half` [n, 3] marked on them: what data or a viewer says about them.
    """
    marks = None if half is None else _marks(half)
    panels = [panel for spec in material.specs() for panel in _panels(spec, material.maps[spec.name].detach(), marks)]
    columns = min(_COLUMNS, len(panels))
    rows = math.ceil(len(panels) / columns)
    size = (3.2 * columns, 3.2 * rows)
    figure, axes = plotting().subplots(rows, columns, figsize=size, squeeze=False, layout="constrained")
    for axis in axes.flat[len(panels) :]:
        axis.set_axis_off()
    for axis, panel in zip(axes.flat, panels, strict=False):
        axis.set_title(panel.title, fontsize=8)
        panel.draw(axis)
    return save_figure(figure, Path(path))


def _marks(half: Tensor) -> Tensor:
    """Return where on the parabolic disc half vectors [n, 3] lie, [n, 2]."""
    if half.ndim != 2 or half.shape[1] != 3:
        raise ShapeError(message("maps_picture", "half", "be [n, 3]", f"it is {tuple(half.shape)}"))
    check_finite("maps_picture", "half", half)
    below = half[:, 2] <= -1 + 1e-6
    if bool(below.any()):
        fact = f"row {int(below.nonzero()[0])} is {half[below][0].tolist()}"
        raise RangeError(message("maps_picture", "half", "point away from -z", fact, "It has no place on the disc."))
    return half[:, :2] / (1 + half[:, 2:])


def _panels(spec: MapSpec, value: Tensor, marks: Tensor | None) -> list[_Panel]:
    if spec.constant:
        return [_Panel(_title(spec.name, value), lambda axis: _bars(axis, value))]
    if spec.name == "tilt":
        return [_Panel("tilt: 1 - d against degrees", lambda axis: _curve(axis, value.flatten()))]
    if spec.name == "rotation":
        length = value.norm(dim=0, keepdim=True)
        return [_Panel("rotation (+x is red)", _image(rotation_to_hue(torch.where(length > 0, value, 1.0))))]
    textures = zip(spec.textures, value.split(spec.layer_channels), strict=True)
    if spec.name == "specular":
        return [_Panel(_title(name, part) + ", log", _disc(part, marks)) for name, part in textures]
    return [_Panel(_title(name, part), _shown(spec, part)) for name, part in textures]


def _title(name: str, part: Tensor) -> str:
    low, high = number(float(part.min())), number(float(part.max()))
    return f"{name} ({low} to {high})" if low != high else f"{name} ({low})"


def _shown(spec: MapSpec, part: Tensor) -> Callable[[Any], None]:
    """Return what draws one texture [C, H, W]."""
    if spec.index:
        return _image(part[:1], cmap="tab20")
    if spec.colour and len(part) == 3:
        return _image(colour.display(part))
    if not spec.per_texel or len(part) != 3:
        # Tables and odd numbers of channels: plane under plane.
        return _image(part.flatten(0, 1)[None], cmap="viridis" if not spec.per_texel else "gray")
    most = 1.0 if spec.name == "normal" else max(float(part.abs().max()), 1e-12)
    return _image((part / (2 * most) + 0.5).clamp(0, 1))


def _image(planes: Tensor, cmap: str = "gray", **settings: Any) -> Callable[[Any], None]:
    """Return what draws planes [1 or 3, H, W], thinned out to what the sheet can show."""
    down, across = (max(1, size // _LARGEST) for size in planes.shape[1:])
    pixels = planes[:, ::down, ::across].permute(1, 2, 0).float().numpy()
    pixels = pixels[:, :, 0] if pixels.shape[2] == 1 else pixels
    aspect = "auto" if max(planes.shape[1:]) > 8 * min(planes.shape[1:]) else "equal"

    def draw(axis: Any) -> None:
        axis.imshow(pixels, cmap=cmap, interpolation="nearest", aspect=aspect, **settings)
        axis.set_axis_off()

    return draw


def _disc(part: Tensor, marks: Tensor | None) -> Callable[[Any], None]:
    most = max(float(part.max()), 1e-30)
    scaled = torch.log1p(part / most * _DECADES) / math.log1p(_DECADES)
    draw_map = _image(scaled.clamp(0, 1), extent=(-1, 1, -1, 1))

    def draw(axis: Any) -> None:
        draw_map(axis)
        axis.add_patch(plotting().Circle((0, 0), 1, fill=False, color="tab:orange", linewidth=1))
        if marks is not None:
            axis.plot(marks[:, 0].numpy(), marks[:, 1].numpy(), ".", color="tab:red", markersize=2)
            axis.set_xlim(-1, 1)
            axis.set_ylim(-1, 1)

    return draw


def _curve(axis: Any, values: Tensor) -> None:
    axis.plot(values.numpy())
    axis.set_xlim(0, len(values) - 1)
    axis.set_ylim(-0.02, 1.02)
    axis.grid(alpha=0.3)


def _bars(axis: Any, values: Tensor) -> None:
    axis.bar(range(len(values)), values.numpy())
    axis.set_xticks([])
    axis.grid(alpha=0.3, axis="y")


def hemisphere_picture(material: Material, path: Path, size: int = 192) -> Path:
    """Draw nine views of the flat patch under one light from the upper left: how it changes as one moves round it.

    Rows are polar angles of the view, columns its azimuth: toward the mirror direction, across, back to the light.
    """
    if size < 1:
        raise RangeError(message("hemisphere_picture", "size", "be at least 1", f"it is {size}"))
    height, width = material.size
    across = max(1, min(size, round(size * width / height)))  # a tall patch keeps its height
    figure, axes = plotting().subplots(3, 3, figsize=(7.5, 8), squeeze=False)
    for line, polar in zip(axes, POLAR_DEG, strict=True):
        for axis, azimuth in zip(line, AZIMUTH_DEG, strict=True):
            sine, angle = math.sin(math.radians(polar)), math.radians(azimuth)
            view = (sine * math.cos(angle), sine * math.sin(angle), math.cos(math.radians(polar)))
            picture = render(material, "patch", [_LIGHT], view=view, size=across)
            axis.imshow(colour.display(picture.float()).permute(1, 2, 0).numpy(), interpolation="nearest", aspect="auto")
            axis.set_box_aspect(min(max(height / width, 0.1), 10))
            axis.set_title(f"view {polar:.0f}°/{azimuth:.0f}°", fontsize=8)
            axis.set_axis_off()
    return save_figure(figure, Path(path))
