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
from torchmat.models import Distribution, Material
from torchmat.models.parabolic import EVEN, places
from torchmat.models.storage import MapSpec
from torchmat.rendering import render
from torchmat.rendering.mipmap import Pyramid
from torchmat.report.pictures import bare, plotting, save_figure
from torchmat.report.samples import Measured, degrees, polar_deg
from torchmat.report.tables import number

_COLUMNS = 4
_LARGEST = 512  # texels along a side of a panel; the sheet shows no more
_DECADES = 1e3  # from the brightest to where the logarithm turns linear
_LIGHT = (-0.5, 0.5, 0.707)
# Where one stands, as (polar angle, azimuth) in degrees, seen from above: the light falls in from the upper left, its
# mirror direction is at the lower right. Nine that differ, all azimuths every 45 degrees among them.
COMPASS = (
    ((50.0, 135.0), (25.0, 90.0), (50.0, 45.0)),
    ((25.0, 180.0), (0.0, 0.0), (25.0, 0.0)),
    ((50.0, 225.0), (25.0, 270.0), (50.0, 315.0)),
)
_ALIKE = 1 / 510  # display values that no 8-bit picture tells apart
_BEYOND = "tab:orange"


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
    spacing = material.specular_spacing if isinstance(material, Distribution) else EVEN
    marks = None if half is None else _marks(half, spacing)
    panels = [panel for spec in material.specs() for panel in _panels(spec, material.maps[spec.name].detach(), marks)]
    columns = min(_COLUMNS, len(panels))
    rows = math.ceil(len(panels) / columns)
    size = (3.2 * columns, 3.2 * rows)
    figure, axes = plotting().subplots(rows, columns, figsize=size, squeeze=False, layout="constrained")
    for axis in axes.flat[len(panels) :]:
        bare(axis)
    for axis, panel in zip(axes.flat, panels, strict=False):
        axis.set_title(panel.title, fontsize=8)
        panel.draw(axis)
    return save_figure(figure, Path(path))


def _marks(half: Tensor, spacing: str = EVEN) -> Tensor:
    """Return where on specular maps of a spacing half vectors [n, 3] lie, [n, 2]."""
    if half.ndim != 2 or half.shape[1] != 3:
        raise ShapeError(message("maps_picture", "half", "be [n, 3]", f"it is {tuple(half.shape)}"))
    check_finite("maps_picture", "half", half)
    below = half[:, 2] <= -1 + 1e-6
    if bool(below.any()):
        fact = f"row {int(below.nonzero()[0])} is {half[below][0].tolist()}"
        raise RangeError(message("maps_picture", "half", "point away from -z", fact, "It has no place on the disc."))
    return places(half.double().T[:, :, None], spacing)[:, :, 0].T


def _panels(spec: MapSpec, value: Tensor, marks: Tensor | None) -> list[_Panel]:
    if spec.constant:
        return [_Panel(_title(spec.name, value), lambda axis: _bars(axis, value))]
    if spec.name == "tilt":
        return [_Panel("tilt: 1 - d against degrees", lambda axis: _curve(axis, value.flatten()))]
    if spec.name == "rotation":
        return [_Panel("rotation (+x is red)", _image(hue(value)))]
    textures = zip(spec.textures, value.split(spec.layer_channels), strict=True)
    if spec.name == "specular":
        return [_Panel(_title(name, part) + ", log", _disc(part, marks)) for name, part in textures]
    return [_Panel(_title(name, part), _image(*seen(spec, part))) for name, part in textures]


def hue(rotation: Tensor) -> Tensor:
    """Return a rotation [2, H, W] as colours [3, H, W]; +x is red, as is what has no direction."""
    return rotation_to_hue(torch.where(rotation.norm(dim=0, keepdim=True) > 0, rotation, 1.0))


def _title(name: str, part: Tensor) -> str:
    low, high = number(float(part.min())), number(float(part.max()))
    return f"{name} ({low} to {high})" if low != high else f"{name} ({low})"


def seen(spec: MapSpec, part: Tensor) -> tuple[Tensor, str]:
    """Return the planes [1 or 3, H, W] in which people see one texture [C, H, W] of a map, and the colours of a single one."""
    if spec.index:
        return part[:1], "tab20"
    if spec.colour and len(part) == 3:
        return colour.display(part), "gray"
    if not spec.per_texel or len(part) != 3:
        # Tables and odd numbers of channels: plane under plane.
        return part.flatten(0, 1)[None], "gray" if spec.per_texel else "viridis"
    most = 1.0 if spec.name == "normal" else max(float(part.abs().max()), 1e-12)
    return (part / (2 * most) + 0.5).clamp(0, 1), "gray"


def logarithmic(part: Tensor) -> Tensor:
    """Return a map [3, H, W] from 0 to its largest value on a logarithmic scale, 0 to 1."""
    most = max(float(part.max()), 1e-30)
    return (torch.log1p(part / most * _DECADES) / math.log1p(_DECADES)).clamp(0, 1)


def _image(planes: Tensor, cmap: str = "gray", **settings: Any) -> Callable[[Any], None]:
    """Return what draws planes [1 or 3, H, W], thinned out to what the sheet can show."""
    down, across = (max(1, size // _LARGEST) for size in planes.shape[1:])
    pixels = planes[:, ::down, ::across].permute(1, 2, 0).float().numpy()
    pixels = pixels[:, :, 0] if pixels.shape[2] == 1 else pixels
    aspect = "auto" if max(planes.shape[1:]) > 8 * min(planes.shape[1:]) else "equal"

    def draw(axis: Any) -> None:
        axis.imshow(pixels, cmap=cmap, interpolation="nearest", aspect=aspect, **settings)
        bare(axis)

    return draw


def _disc(part: Tensor, marks: Tensor | None) -> Callable[[Any], None]:
    draw_map = _image(logarithmic(part), extent=(-1, 1, -1, 1))

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


def hemisphere_picture(material: Material, path: Path, size: int = 192, measured: Measured | None = None) -> Path:
    """Draw nine views of the flat patch under one light from the upper left: how it changes as one moves round it.

    Each stands where one stands; no picture is there twice. A material that looks alike from everywhere is shown from above
    under lights from there instead. What lies beyond the `measured` directions is marked.
    """
    if size < 1:
        raise RangeError(message("hemisphere_picture", "size", "be at least 1", f"it is {size}"))
    places = torch.tensor([[_direction(*angles) for angles in row] for row in COMPASS]).flatten(0, 1)
    light, above = torch.tensor([_LIGHT]).expand(9, 3) / math.hypot(*_LIGHT), torch.tensor([[0.0, 0.0, 1.0]]).expand(9, 3)
    drawn, what, lights, views = _distinct(material, light, places, size), "view", light, places
    said = f"light {degrees(polar_deg(light[0]))}"
    if len(drawn) == 1:
        drawn, what, lights, views = _distinct(material, places, above, size), "light", places, above
        said = "alike from everywhere: from above, under light from"
    beyond = [False] * 9 if measured is None else measured.beyond(lights, views)
    figure, axes = plotting().subplots(3, 3, figsize=(7.5, 8), squeeze=False, gridspec_kw={
        "left": 0.02, "right": 0.98, "bottom": 0.02, "top": 0.92, "wspace": 0.05, "hspace": 0.14,
    })
    figure.suptitle(said + ("; orange: beyond the measured directions" if any(beyond) else ""), fontsize=9)
    for number_of, (axis, angles) in enumerate(zip(axes.flat, [place for row in COMPASS for place in row], strict=True)):
        if number_of not in drawn:
            bare(axis)
            continue
        _place(axis, drawn[number_of], material.size, beyond[number_of])
        axis.set_title(f"{what} {degrees(angles)}", fontsize=8, pad=3, color=_BEYOND if beyond[number_of] else "black")
    return save_figure(figure, Path(path), placed=True)


def _direction(polar_deg: float, azimuth_deg: float) -> list[float]:
    polar, azimuth = math.radians(polar_deg), math.radians(azimuth_deg)
    return [math.sin(polar) * math.cos(azimuth), math.sin(polar) * math.sin(azimuth), math.cos(polar)]


def _distinct(material: Material, lights: Tensor, views: Tensor, size: int) -> dict[int, Tensor]:
    """Return displayed pictures [3, H, W] of the patch by their numbers, without those that another one looks like."""
    height, width = material.size
    across = max(1, min(size, round(size * width / height)))  # a tall patch keeps its height
    found: dict[int, Tensor] = {}
    pyramid = Pyramid(material)
    for number_of in (4, 0, 1, 2, 3, 5, 6, 7, 8):  # straight above first, which every material has
        light, view = lights[number_of].tolist(), views[number_of].tolist()
        picture = colour.display(render(pyramid, "patch", [light], view=view, size=across).float())
        if all(float((picture - other).abs().max()) > _ALIKE for other in found.values()):
            found[number_of] = picture
    return found


def _place(axis: Any, picture: Tensor, size: tuple[int, int], beyond: bool) -> None:
    axis.imshow(picture.permute(1, 2, 0).numpy(), interpolation="nearest", aspect="auto")
    axis.set_box_aspect(min(max(size[0] / size[1], 0.1), 10))
    axis.set_xticks([])
    axis.set_yticks([])
    for side in axis.spines.values():
        side.set(visible=beyond, color=_BEYOND, linestyle="--", linewidth=2)
