"""Light and colour of a scene: lamps, vignetting, exposure, white and colour, each found from the photographs and divided out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from torchmat.capturing.board import WHITE
from torchmat.capturing.chart import Colour, colour_of_chart
from torchmat.capturing.evenness import Course, Vignetting, fit_courses, flat_field
from torchmat.capturing.light import Light, blocked
from torchmat.capturing.lights import flash, lights_of_table
from torchmat.capturing.observe import Observed, Places, observe, places_of
from torchmat.capturing.photographs import photograph
from torchmat.capturing.scene import Scene, Step
from torchmat.capturing.shading_lights import lights_of_shading
from torchmat.capturing.sheen import Sheen, mirrored
from torchmat.capturing.sphere_lights import SphereLights, lights_of_spheres
from torchmat.capturing.told import colour_step, lights_step, vignetting_step, white_step
from torchmat.capturing.white import White, calibrate_white
from torchmat.errors import FitError, check_option, message

LIGHTS = ("auto", "spheres", "flash", "shading")
_LEAST_PAPER = 30  # points of white paper in a photograph
_UNEXPLAINED = 0.2  # relative, in a corner of the window: light that is so much stronger there comes from elsewhere
_DEVIATES = 0.025  # relative rms of paper about what lamps, lens and a slope explain
_STRAY = 2.5  # times the usual deviation, of a photograph that is left out
_LEAST_PATCH = 0.5  # of a patch's points that must be good


@dataclass(frozen=True)
class PhotometryOptions:
    """Where light and colour come from.

    Args:
        lights: "spheres", "flash" (beside the lens), "shading" (of the paper, an estimate), or the path of a table or dome;
            "auto" takes the board's spheres, and the shading where it has none.
        flash_offset: of the flash from the lens in mm, in the frame of the sensor: right, down, forward.
        positions: whether a table's x, y, z are positions in mm from the window's middle.
        distance: of all lights of a table from the window's middle in mm; None takes them for far.
        white: reflectance of the white patch.
        grey: of the grey patch where it is known; None measures it.
        flat: photograph of evenly lit white; None finds vignetting on the board's paper.
        even: whether a lamp may not be stronger to one side than its distance explains.
        chart: photograph of a ColorChecker Classic under the same lamp; None leaves the camera's colours.
        chart_corners: the middles of its dark skin, bluish green, black and white as (column, row); None searches them.
        encoding: of flat field and chart, as `load_btf` has it.
    """

    lights: str | Path = "auto"
    flash_offset: Sequence[float] = (0.0, 0.0, 0.0)
    positions: bool = False
    distance: float | None = None
    white: float = WHITE
    grey: float | None = None
    flat: str | Path | None = None
    even: bool = False
    chart: str | Path | None = None
    chart_corners: Sequence[Sequence[float]] | None = None
    encoding: str = "auto"


@dataclass(frozen=True, eq=False)
class Calibrated:
    """Light and colour of a scene's photographs: what `capture` asks for (`scene.Photometry`), and what it was made from."""

    lights: list[Light | None]
    faults: list[str]
    courses: list[Course]
    vignetting: Vignetting | None
    whites: White
    colour: Colour | None
    spheres: np.ndarray
    radius: float
    steps: Sequence[Step] = field(default=())

    @property
    def keep(self) -> list[bool]:
        """Which photographs have a light."""
        return [not fault for fault in self.faults]

    @property
    def light(self) -> np.ndarray:
        """Unit directions [n, 3] from the window's middle; NaN where there is none."""
        return np.stack([np.full(3, np.nan) if one is None else one.direction for one in self.lights])

    @property
    def position(self) -> np.ndarray | None:
        """Positions [n, 3] in mm, NaN of far lamps; None where all are far."""
        near = [one is not None and one.position is not None for one in self.lights]
        if not any(near):
            return None
        return np.stack([one.position if one is not None and one.position is not None else np.full(3, np.nan) for one in self.lights])

    def correct(self, index: int, pixels: Tensor) -> Tensor:
        """Return a photograph's pixels [3, H, W] without vignetting, in common exposure, white and colour."""
        even = pixels if self.vignetting is None else self.vignetting.taken_out(pixels)
        gains = torch.from_numpy(1 / self.whites.scale[index]).to(pixels.dtype)
        turn = torch.diag(gains) if self.colour is None else torch.from_numpy(self.colour.matrix).to(pixels.dtype) @ torch.diag(gains)
        return torch.einsum("dc,chw->dhw", turn, even)

    def irradiance(self, index: int, points: np.ndarray) -> np.ndarray:
        """Return by what values at points [..., 3] in mm are divided: the lamp's irradiance [..., 1] there, 1 in the window's middle,
        0 in a sphere's shadow."""
        light = self.lights[index]
        assert light is not None  # such photographs are not kept
        shaded = blocked(points, light.directions(points), self.spheres, self.radius)
        return np.where(shaded, 0, light.strength(points) * self.courses[index].at(points))[..., None]


def photometry(scene: Scene, options: PhotometryOptions | None = None, show: bool | None = None) -> Calibrated:
    """Find light and colour of a scene's photographs.

    Each is read once. Lamps come first; then the white paper of all photographs tells vignetting and the course of the
    light, the patches exposure and white balance; then a chart colour. A photograph without a light is named and not kept.

    Args:
        scene: photographs with their cameras and poses.
        options: where light and colour come from.
        show: whether a bar is shown; None shows it on a terminal.

    Raises DataError, RangeError or FitError, which name what is at fault, where it concerns all photographs.
    """
    options = options or PhotometryOptions()
    if not isinstance(options.lights, Path) and not Path(options.lights).suffix:
        check_option("capture", "lights", options.lights, LIGHTS)
    known = None if options.flat is None else _flat(options)
    colour = None if options.chart is None else colour_of_chart(options.chart, options.chart_corners, options.encoding)
    kind = options.lights if options.lights != "auto" else ("spheres" if scene.board.spheres else "shading")
    places = places_of(scene, sample=kind == "shading")
    observed = observe(scene, places, show)
    found = lights_of_spheres(scene, observed) if kind == "spheres" else None
    lights, faults = (found.lights, found.faults) if found else _other_lights(scene, options, kind, places, observed, known)
    spheres = np.array([one.centre for one in found.standing]) if found else scene.board.sphere_centres
    faults = [fault or _unlit(scene, index, observed[index]) for index, fault in enumerate(faults)]
    if all(faults):
        fact, step = f"the first of {len(faults)}: {faults[0]}", "Give the lights, or see what each photograph lacks."
        raise FitError(message("capture", "photographs", "have a light that can be found", fact, step))
    courses, vignetting, sheen = _courses(scene, options, places, observed, lights, faults, spheres, known)
    _check_explained(scene, courses, faults)
    strays = _strays(scene, courses, faults)
    if any(strays):
        faults = [fault or stray for fault, stray in zip(faults, strays, strict=True)]
        courses, vignetting, sheen = _courses(scene, options, places, observed, lights, faults, spheres, known)
    whites = _whites(scene, options, places, observed, lights, courses, vignetting, sheen, faults, spheres)
    calibrated = Calibrated(lights, faults, courses, vignetting, whites, colour, spheres, scene.board.diameter / 2)
    return _with_steps(calibrated, scene, observed, found, sheen)


def _with_steps(one: Calibrated, scene: Scene, observed: Sequence[Observed], found: SphereLights | None, sheen: Sheen | None) -> Calibrated:
    notes = sorted({note for some in observed for note in some.notes})
    steps = [lights_step(scene, one.lights, one.faults, found, observed), vignetting_step(scene, one.vignetting, one.courses, one.faults, sheen)]
    steps += [white_step(scene, one.whites, one.courses, one.faults, notes)] + ([] if one.colour is None else [colour_step(one.colour)])
    return Calibrated(one.lights, one.faults, one.courses, one.vignetting, one.whites, one.colour, one.spheres, one.radius, tuple(steps))


def _flat(options: PhotometryOptions) -> Vignetting:
    assert options.flat is not None
    developed = photograph(options.flat, options.encoding).developed()
    return flat_field(developed.linear, developed.clipped)


def _other_lights(
    scene: Scene, options: PhotometryOptions, kind: str | Path, places: Places, observed: Sequence[Observed], known: Vignetting | None
) -> tuple[list[Light | None], list[str]]:
    """Return lights that come from elsewhere than spheres, and why photographs have none."""
    names = [one.name for one in scene.photographs]
    if kind == "flash":
        return [flash(pose, options.flash_offset) for pose in scene.poses], [""] * len(names)
    if kind != "shading":
        given: list[Light | None] = list(lights_of_table(kind, names, positions=options.positions, distance=options.distance))
        return given, [""] * len(names)
    return lights_of_shading(scene, places, observed, known)


def _unlit(scene: Scene, index: int, observed: Observed) -> str:
    """Return why white paper does not tell a photograph's exposure, "" where it does."""
    count = int(observed.paper.good.sum())
    if count >= _LEAST_PAPER:
        return ""
    fact = f"{count} of {len(observed.paper.good)} points can be used; others are clipped, outside or hidden"
    step = "Expose less, and photograph all of the board."
    return message(scene.photographs[index].name, "the board's white paper", f"be seen at {_LEAST_PAPER} points", fact, step)


def _lit(points: np.ndarray, light: Light, spheres: np.ndarray, radius: float) -> np.ndarray:
    return ~blocked(points, light.directions(points), spheres, radius)


def _courses(
    scene: Scene, options: PhotometryOptions, places: Places, observed: Sequence[Observed], lights: Sequence[Light | None],
    faults: Sequence[str], spheres: np.ndarray, known: Vignetting | None,
) -> tuple[list[Course], Vignetting | None, Sheen | None]:
    nothing = (np.zeros((0, 3)), np.zeros((0, 2)), np.zeros((0, 3)), np.zeros(0), np.zeros((0, 2)))
    rows = []
    for one, light, pose, fault in zip(observed, lights, scene.poses, faults, strict=True):
        if fault or light is None:
            rows.append(nothing)
            continue
        good = one.paper.good & _lit(places.paper, light, spheres, scene.board.diameter / 2)
        points = places.paper[good]
        rows.append((points, one.paper.pixels[good], one.paper.values[good], light.irradiance(points), mirrored(pose, light, points)))
    points, pixels, values, expected, mirror = (list(column) for column in zip(*rows, strict=True))
    return fit_courses(scene.cameras[0].size, points, pixels, values, expected, known, not options.even, mirror)


def _strays(scene: Scene, courses: Sequence[Course], faults: Sequence[str]) -> list[str]:
    """Return why the paper of a photograph does not tell its exposure, far unlike that of others; "" where it does."""
    usual = float(np.median([course.residual for course, fault in zip(courses, faults, strict=True) if not fault]))
    said = []
    for one, course, fault in zip(scene.photographs, courses, faults, strict=True):
        stray = not fault and course.residual > max(_DEVIATES, _STRAY * usual)
        fact = f"it deviates by {100 * course.residual:.1f} % rms, that of others by {100 * usual:.1f} %"
        step = "Leave this photograph out, or take it again without a shadow, a highlight or a second lamp on the board."
        said.append(message(one.name, "the board's white paper", "be lit as its lamp explains", fact, step) if stray else "")
    return said


def _check_explained(scene: Scene, courses: Sequence[Course], faults: Sequence[str]) -> None:
    """Raise FitError when the paper of most photographs is lit otherwise than their lamps explain."""
    corner = scene.board.window[2:]
    uneven = {one.name: float(np.abs(course.slope) @ corner) for one, course, fault in zip(scene.photographs, courses, faults, strict=True) if not fault}
    residual = float(np.median([course.residual for course, fault in zip(courses, faults, strict=True) if not fault]))
    if np.median(list(uneven.values())) > _UNEXPLAINED or residual > _DEVIATES:
        name = max(uneven, key=lambda one: uneven[one])
        fact = f"it is {100 * np.median(list(uneven.values())):.0f} % stronger to one side (median; most in {name}) and deviates by {100 * residual:.1f} % rms"
        step = "Check where the lights are said to be, their axes, and which photograph each belongs to."
        raise FitError(message("capture", "the lights", "explain how the board's paper is lit", fact, step))


def _whites(
    scene: Scene, options: PhotometryOptions, places: Places, observed: Sequence[Observed], lights: Sequence[Light | None],
    courses: Sequence[Course], vignetting: Vignetting | None, sheen: Sheen | None, faults: Sequence[str], spheres: np.ndarray,
) -> White:
    shares = np.full((2, len(observed), 3), np.nan)
    for index, (one, light) in enumerate(zip(observed, lights, strict=True)):
        if faults[index] or light is None:
            continue
        for kind, (reading, points) in enumerate(((one.white, places.white), (one.grey, places.grey))):
            good = reading.good & _lit(points, light, spheres, scene.board.diameter / 2)
            if good.mean() >= _LEAST_PATCH / len(scene.board.patches["white"]):
                even = 1.0 if vignetting is None else vignetting.at(reading.pixels[good])
                paper = light.irradiance(points[good]) * courses[index].at(points[good]) * even
                gloss = 0.0 if sheen is None else sheen.at(mirrored(scene.poses[index], light, points[good]))[:, None] - 1  # of ink as of paper
                shares[kind, index] = np.median(reading.values[good] / (paper[:, None] * courses[index].level) - gloss, axis=0)
    white, grey = shares
    return calibrate_white(np.stack([one.level for one in courses]), white, grey, options.white, options.grey)
