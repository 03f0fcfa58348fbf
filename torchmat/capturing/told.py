"""What light and colour say of themselves: a step each for the report, with its figure that would show a wrong guess."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from torchmat.capturing.chart import NAMES, Colour
from torchmat.capturing.evenness import Course, Vignetting
from torchmat.capturing.light import Light
from torchmat.capturing.observe import Observed
from torchmat.capturing.scene import Scene, Step
from torchmat.capturing.sheen import Sheen
from torchmat.capturing.sphere_lights import SphereLights
from torchmat.capturing.white import White
from torchmat.colour import display

_SHOWN = 6  # photographs whose highlights are shown
_UNEVEN = 0.1  # relative, in a corner of the window, of which it is said
_ODD = 0.015, 1.8  # rms of a photograph's paper, and times the usual one, of which it is said
_SIDE = 160  # pixels of a picture of a sphere
_MARK = (1.0, 0.2, 0.1)


def lights_step(
    scene: Scene, lights: Sequence[Light | None], faults: Sequence[str], found: SphereLights | None, observed: Sequence[Observed]
) -> Step:
    """Return what was found of the lamps."""
    rows: list[tuple] = []
    figures = {}
    for one, light, fault in zip(scene.photographs, lights, faults, strict=True):
        if light is None:
            rows.append((one.name, "", "", "", "", fault))
            continue
        x, y, z = light.direction
        polar, azimuth = np.degrees(np.arctan2(np.hypot(x, y), z)), np.degrees(np.arctan2(y, x)) % 360
        rows.append((one.name, polar, azimuth, "far" if light.distance is None else light.distance, light.sigma_deg, fault or light.how))
        figures[one.name] = {
            "direction": light.direction.tolist(), "sigma_deg": light.sigma_deg, "residual": light.residual, "how": light.how,
            "position_mm": None if light.position is None else light.position.tolist(),
        }
    good = [light for light, fault in zip(lights, faults, strict=True) if light is not None and not fault]
    near = sum(light.position is not None for light in good)
    said = f"{len(good)} of {len(lights)} lamps, {near} of them near; from {', '.join(sorted({light.how for light in good}))}"
    residual = f"known to {np.median([light.sigma_deg for light in good]):.2f} degrees (median), {max(light.sigma_deg for light in good):.2f} at most"
    missed = [light.residual for light in good if light.residual is not None]
    if missed:
        residual += f"; rays miss each other by {np.median(missed):.1f} mm" if found else f"; {100 * np.median(missed):.1f} % of the paper's brightness"
    notes = [fault for fault in faults if fault] + ([] if found is None else found.notes)
    pictures = {} if found is None else _highlights(scene, found, observed)
    return Step("lights", said, residual, figures, ("photograph", "polar", "azimuth", "mm away", "known to degrees", "from"), rows, pictures, notes)


def _highlights(scene: Scene, found: SphereLights, observed: Sequence[Observed]) -> dict[str, Tensor]:
    """Return the spheres of some photographs, each highlight that was found in a cross."""
    shown = [index for index in range(len(observed)) if any(cutout is not None for cutout in observed[index].spheres)]
    shown = [shown[round(place)] for place in np.linspace(0, len(shown) - 1, min(_SHOWN, len(shown)))]
    tiles = [[_tile(observed[index].spheres[number], found.highlights[index, number]) for number in range(len(found.standing))] for index in sorted(set(shown))]
    if not tiles:
        return {}
    names = ", ".join(scene.photographs[index].name for index in sorted(set(shown)))
    return {f"Highlights on the spheres of {names}": torch.cat([torch.cat(row, dim=1) for row in tiles], dim=2)}


def _tile(cutout, pixel: np.ndarray) -> Tensor:
    if cutout is None:
        return torch.zeros(3, _SIDE, _SIDE)
    planes = display(torch.from_numpy(cutout.linear))
    height, width = planes.shape[-2:]
    tile = torch.nn.functional.interpolate(planes[None], (_SIDE, _SIDE), mode="bilinear", align_corners=False)[0]
    if np.isfinite(pixel).all():
        column, row = ((pixel - cutout.corner + 0.5) * _SIDE / [width, height]).astype(int)
        mark = torch.tensor(_MARK)[:, None]
        for reach in (slice(5, 15), slice(-14, -4)):
            across = torch.arange(column + reach.start, column + reach.stop).clamp(0, _SIDE - 1)
            down = torch.arange(row + reach.start, row + reach.stop).clamp(0, _SIDE - 1)
            tile[:, min(max(row, 0), _SIDE - 1), across] = mark
            tile[:, down, min(max(column, 0), _SIDE - 1)] = mark
    return tile


def vignetting_step(
    scene: Scene, vignetting: Vignetting | None, courses: Sequence[Course], faults: Sequence[str], sheen: Sheen | None = None
) -> Step:
    """Return what was found of the lens's and the lamps' evenness, and of the paper's gloss."""
    left, bottom, right, top = scene.board.window
    corner = np.array([right, top, 0.0])
    kept = [course for course, fault in zip(courses, faults, strict=True) if not fault]
    uneven = 100 * max(float(np.abs(course.slope) @ corner[:2]) for course in kept)
    residual = f"paper deviates by {100 * np.median([course.residual for course in kept]):.2f} % rms (median), {100 * max(course.residual for course in kept):.2f} at most"
    light = f"light up to {uneven:.1f} % stronger in a corner of the window than its distance explains"
    rows = [(one.name, *(100 * course.slope), 100 * course.residual) for one, course, fault in zip(scene.photographs, courses, faults, strict=True) if not fault]
    notes = [
        f"{one.name}: light is {100 * float(np.abs(course.slope) @ corner[:2]):.0f} % stronger to one side than its lamp explains"
        for one, course, fault in zip(scene.photographs, courses, faults, strict=True) if not fault and np.abs(course.slope) @ corner[:2] > _UNEVEN
    ]
    if sheen is not None:
        notes.append(
            f"the paper is glossy: {100 * sheen.strength:.0f} % brighter in the mirror direction of a lamp above it (give or take {100 * sheen.sigma:.0f}), which is "
            "taken out; matte paper is safer"
        )
    shine = None if sheen is None else {"strength": sheen.strength, "exponent": sheen.exponent, "sigma": sheen.sigma}
    usual = float(np.median([course.residual for course in kept]))
    notes += [
        f"{one.name}: its paper deviates by {100 * course.residual:.1f} % rms, that of others by {100 * usual:.1f} %: a shadow or a highlight, and its exposure may be off by several times as much"
        for one, course, fault in zip(scene.photographs, courses, faults, strict=True) if not fault and course.residual > max(_ODD[0], _ODD[1] * usual)
    ]
    header = ("photograph", "% a mm to the right", "% a mm up", "residual in %")
    if vignetting is None:
        note = "the board's paper does not reach far enough to tell vignetting: none is taken out; give a flat field"
        return Step("evenness", light, residual, {"vignetting": None, "sheen": shine}, header, rows, notes=(note, *notes))
    found = f"corners keep {100 * vignetting.corner:.1f} % (known to {100 * vignetting.sigma:.1f}), from {vignetting.how}; {light}"
    width, height = vignetting.size
    small = np.stack(np.meshgrid(np.linspace(0, width - 1, 240), np.linspace(0, height - 1, round(240 * height / width))), axis=-1)
    picture = torch.from_numpy(vignetting.at(small)).float().clamp(0, 1).expand(3, -1, -1)
    figures = {"corner": vignetting.corner, "sigma": vignetting.sigma, "weights": vignetting.weights.tolist(), "from": vignetting.how, "sheen": shine}
    return Step("evenness", found, residual, figures, header, rows, {"What the lens keeps of even light": picture}, notes)


def white_step(scene: Scene, white: White, courses: Sequence[Course], faults: Sequence[str], notes: Sequence[str]) -> Step:
    """Return what was found of exposure and white balance."""
    kept = [index for index, fault in enumerate(faults) if not fault]
    scale = white.scale[kept]
    balance = scale / scale[:, 1:2]
    spread = 100 * float((balance.std(0) / balance.mean(0)).max())
    stops = float(np.log2(scale[:, 1].max() / scale[:, 1].min()))
    found = f"exposures within {stops:.2f} stops; red {balance[:, 0].mean():.3f} and blue {balance[:, 2].mean():.3f} of green, paper reflects {white.paper.mean():.3f}"
    residual = f"white balance differs by {spread:.2f} % between photographs; grey {white.grey.mean():.3f}, by {100 * white.spread:.2f} %"
    rows = [(scene.photographs[index].name, *white.scale[index]) for index in kept]
    figures = {
        "scale": {scene.photographs[index].name: white.scale[index].tolist() for index in kept}, "paper": white.paper.tolist(),
        "grey": white.grey.tolist(), "grey_spread": white.spread, "bend": white.bend,
    }
    return Step("white", found, residual, figures, ("photograph", "red", "green", "blue"), rows, notes=(*white.notes, *notes))


def colour_step(colour: Colour) -> Step:
    """Return what a chart made of the camera's colours."""
    residual = f"CIEDE2000 {colour.mean:.2f} on average, {colour.largest:.2f} at most ({colour.before:.2f} before)"
    rows = list(zip(NAMES, colour.differences.tolist(), strict=True))
    figures = {"matrix": colour.matrix.tolist(), "ciede2000_mean": colour.mean, "ciede2000_max": colour.largest}
    return Step("colour", "a matrix from the chart's 24 patches, which leaves white as it is", residual, figures, ("patch", "CIEDE2000"), rows, notes=colour.notes)
