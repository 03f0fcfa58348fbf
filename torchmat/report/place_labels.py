"""Labels beside the points of a plot, where they cover neither points nor each other."""

from __future__ import annotations

import math
from typing import Any

_REACH = (6, 16, 26, 38, 52, 68, 86, 106)  # points from the marker to the nearest edge of its label
_ANGLES = tuple(math.radians(a) for a in (30, -30, 150, -150, 55, -55, 125, -125, 90, -90))
_LINE_FROM = 16  # labels that stand as far or farther are joined to their point by a line
_MARGIN = 1.5  # pixels around a label
_POINT = 4.0  # half the side of a marker, in pixels

Box = tuple[float, float, float, float]  # left, bottom, right, top in pixels


def overlap(one: Box, other: Box) -> float:
    """Return the area that two boxes share."""
    width = min(one[2], other[2]) - max(one[0], other[0])
    height = min(one[3], other[3]) - max(one[1], other[1])
    return max(0.0, width) * max(0.0, height)


def _outside(box: Box, room: Box) -> float:
    area = (box[2] - box[0]) * (box[3] - box[1])
    return area - overlap(box, room)


def place(
    points: list[tuple[float, float]], sizes: list[tuple[float, float]], room: Box, scale: float
) -> list[tuple[Box, int]]:
    """Return for each point, all in pixels, the box of its label and how many points (1/72 inch) it stands away.

    Each takes the nearest free place in turn, those in a crowd first; where none is free, the one that covers least.
    `scale` is pixels per point.
    """
    taken = [(x - _POINT, y - _POINT, x + _POINT, y + _POINT) for x, y in points]
    crowd = [sum(math.dist(one, other) < 60 * scale for other in points) for one in points]
    found: dict[int, tuple[Box, int]] = {}
    for number in sorted(range(len(points)), key=lambda n: (-crowd[n], n)):
        choices = []
        for reach in _REACH:
            for angle in _ANGLES:
                box = _beside(points[number], sizes[number], reach * scale, angle)
                covered = sum(overlap(box, other) for other in taken) + 3 * _outside(box, room)
                choices.append((covered, reach, box))
            if min(choice[0] for choice in choices) == 0:
                break
        _, reach, box = min(choices, key=lambda choice: choice[:2])
        taken.append(box)
        found[number] = box, reach
    return [found[number] for number in range(len(points))]


def _beside(point: tuple[float, float], size: tuple[float, float], reach: float, angle: float) -> Box:
    width, height = size[0] + 2 * _MARGIN, size[1] + 2 * _MARGIN
    x, y = point[0] + reach * math.cos(angle), point[1] + reach * math.sin(angle)
    left = x if math.cos(angle) > 0.1 else x - width if math.cos(angle) < -0.1 else x - width / 2
    bottom = y if math.sin(angle) > 0 else y - height
    return left, bottom, left + width, bottom + height


def label_points(
    axis: Any, points: list[tuple[float, float]], texts: list[str], colours: list[Any], bold: list[bool]
) -> None:
    """Write a text beside each point (in data coordinates) of an axis whose limits and scales are set."""
    from matplotlib.patheffects import withStroke

    figure = axis.figure
    figure.canvas.draw()
    renderer = figure.canvas.get_renderer()
    scale = figure.dpi / 72
    looks = [
        {"fontsize": 6.5, "color": colour, "weight": "bold" if heavy else "normal"}
        for colour, heavy in zip(colours, bold, strict=True)
    ]
    drawn = [axis.text(0, 0, text, transform=None, **look) for text, look in zip(texts, looks, strict=True)]
    boxes = [text.get_window_extent(renderer) for text in drawn]
    pixels = [tuple(axis.transData.transform(point)) for point in points]
    room = tuple(axis.get_window_extent(renderer).extents)
    places = place(pixels, [(box.width, box.height) for box in boxes], room, scale)
    inverse = axis.transData.inverted()
    halo = withStroke(linewidth=2, foreground="white")  # lines pass behind the words
    for text, look, (spot, reach), pixel in zip(drawn, looks, places, pixels, strict=True):
        text.remove()
        corner = inverse.transform((spot[0] + _MARGIN, spot[1] + _MARGIN))
        axis.text(*corner, text.get_text(), va="bottom", ha="left", zorder=5, path_effects=[halo], **look)
        if reach >= _LINE_FROM:
            near = min(max(pixel[0], spot[0]), spot[2]), min(max(pixel[1], spot[1]), spot[3])
            line = inverse.transform([pixel, near])
            axis.plot(line[:, 0], line[:, 1], color=look["color"], linewidth=0.5, alpha=0.7, zorder=1)
