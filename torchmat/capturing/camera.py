"""The camera of photographs, from all of them together: focal length, principal point and distortion, and which photographs do not fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from torchmat.capturing.board import Board
from torchmat.capturing.detect import Detection
from torchmat.capturing.extra import opencv
from torchmat.capturing.photographs import Photograph
from torchmat.capturing.pose import Seen, seen, solve_pose
from torchmat.capturing.view import Camera, Pose
from torchmat.errors import DataError, FitError, message

# What is let free, one after the other: focal length alone, then a bent image, the principal point, a tilted lens, a strongly bent image.
# Each with the fewest photographs from which it is asked for, and how many numbers it has.
_MODELS = (
    ("focal length", 1, 1), ("k1", 2, 2), ("k1, k2", 4, 3), ("k1, k2, principal point", 6, 5), ("k1, k2, p1, p2, principal point", 8, 7),
    ("k1, k2, k3, p1, p2, principal point", 12, 8),
)
_GAIN = 1.02  # by which a larger model must lower the residual beside paying for its numbers
_SURE = 0.02  # standard error of the focal length, as a share of it, above which views are too alike to tell it
_OUTLIER, _OUTLIER_PIXELS, _OUTLIER_SHARE = 4.0, 1.0, 3e-4  # times the median residual, pixels, and of the diagonal: what all three exceed
_CORNER_OUTLIER, _CORNER_PIXELS = 5.0, 0.5  # times the median residual of a photograph, and pixels
_FOCAL_SHARE = 1.2  # of the longer side: where the search starts without EXIF
_FILM = 36.0  # mm, the width that 35 mm equivalents refer to
_FEWEST = 3


@dataclass(frozen=True, eq=False)
class Calibration:
    """A camera, and the photographs that it explains.

    Args:
        camera: of all photographs.
        poses: by the photographs' numbers.
        residuals: rms in pixels, by their numbers, of all that were seen, outliers too.
        outliers: why photographs are left out, by their numbers.
        model: which numbers were found.
        focal_error: standard error of the focal length, as a share of it; 0 where it is taken from EXIF.
        notes: what was guessed or left out.
    """

    camera: Camera
    poses: dict[int, Pose]
    residuals: dict[int, float]
    outliers: dict[int, str]
    model: str
    focal_error: float
    notes: list[str] = field(default_factory=list)

    @property
    def rms(self) -> float:
        """The residual of all corners that are used, rms in pixels."""
        used = [value for index, value in self.residuals.items() if index not in self.outliers]
        return float(np.sqrt(np.mean(np.square(used))))


def check_one_camera(photographs: Sequence[Photograph]) -> None:
    """Raise DataError, which names photographs of each, unless all are of one camera at one focal length and size."""
    groups: dict[tuple, list[str]] = {}
    for one in photographs:
        groups.setdefault((one.size, one.exif.camera, one.exif.focal), []).append(one.name)
    if len(groups) > 1:
        said = "; ".join(f"{_described(*key)}: {_listed(names)}" for key, names in groups.items())
        step = "Put the photographs of each camera, focal length and size into a folder of their own."
        raise DataError(message("capture", "all photographs", "be of one camera, zoomed alike and in one size", said, step))


def _described(size: tuple[int, int], camera: str, focal: float | None) -> str:
    words = [f"{size[0]} x {size[1]}", camera, f"{focal:g} mm" if focal else ""]
    return " ".join(word for word in words if word)


def _listed(names: Sequence[str], most: int = 4) -> str:
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


def calibrate(board: Board, photographs: Sequence[Photograph], detections: Sequence[Detection]) -> Calibration:
    """Return the camera of photographs, of which those whose detection has a reason do not count.

    As many numbers are found as the photographs can tell: a larger model must pay by Bayes' criterion (Schwarz 1978), and the focal length
    must be known within 2 %, else EXIF's is taken. Photographs that no camera explains, as of a board that was bent or shifted while it
    was photographed, are named and left out. Raises FitError where too few are left, or nothing tells the focal length.
    """
    used = [index for index, one in enumerate(detections) if not one.reason]
    check_one_camera([photographs[index] for index in used])
    if not used:
        step = "Let the whole board be seen, sharp and evenly lit."
        said = f"; the first, {photographs[0].name}: {detections[0].reason}" if detections else ""
        step += " Check --size, --series and --spheres of the board too."
        raise FitError(message("capture", "photographs", "show the board", f"none of {len(detections)} does{said}", step))
    size = photographs[used[0]].size
    start = _exif_focal(photographs[used[0]])
    all_seen = {index: seen(board, detections[index]) for index in used}
    points, outliers = dict(all_seen), {}
    points = _trimmed(points, _selected(points, size, start))
    while True:
        solved = _selected(points, size, start)
        worst = _outlier(points, solved, size)
        if worst is None:
            break
        outliers[worst[0]] = worst[1]
        del points[worst[0]]
    residuals = {index: _rms(solved.errors[index]) for index in points}
    residuals |= {index: _rms(all_seen[index].errors(solved.camera, solve_pose(all_seen[index], solved.camera))) for index in outliers}
    return Calibration(solved.camera, solved.poses, residuals, outliers, solved.model, solved.focal_error, solved.notes)


@dataclass(frozen=True, eq=False)
class _Solved:
    camera: Camera
    poses: dict[int, Pose]
    errors: dict[int, np.ndarray]  # [k], pixels, of each corner
    model: str
    focal_error: float
    notes: list[str]


def _exif_focal(photograph: Photograph) -> float | None:
    """Return the focal length in pixels that EXIF's 35 mm equivalent makes; None without one."""
    film = photograph.exif.focal_35
    return film / _FILM * max(photograph.size) if film else None


def _flags(free: str) -> int:
    cv2 = opencv()
    flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_ASPECT_RATIO
    fixed = {
        "k1": cv2.CALIB_FIX_K1, "k2": cv2.CALIB_FIX_K2, "k3": cv2.CALIB_FIX_K3, "p1": cv2.CALIB_ZERO_TANGENT_DIST,
        "principal": cv2.CALIB_FIX_PRINCIPAL_POINT,
    }
    for word, flag in fixed.items():
        flags |= 0 if word in free else flag
    return flags


def _solve(points: dict[int, Seen], size: tuple[int, int], focal: float, free: str, start: _Solved | None = None, fixed: bool = False) -> _Solved:
    cv2 = opencv()
    matrix = np.array([[focal, 0, (size[0] - 1) / 2], [0, focal, (size[1] - 1) / 2], [0, 0, 1.0]]) if start is None else start.camera.matrix.copy()
    distortion = np.zeros(5) if start is None else start.camera.distortion.copy()
    places = [one.points.astype(np.float32) for one in points.values()]
    pixels = [one.pixels.astype(np.float32) for one in points.values()]
    flags = _flags(free) | (cv2.CALIB_FIX_FOCAL_LENGTH if fixed else 0)
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-10)
    _, matrix, distortion, turns, shifts, deviations, _, _ = cv2.calibrateCameraExtended(
        places, pixels, size, matrix, distortion, flags=flags, criteria=stop,
    )
    camera = Camera(matrix, distortion.reshape(-1)[:5], size)
    poses = {index: Pose(cv2.Rodrigues(turn)[0], shift.reshape(3)) for index, turn, shift in zip(points, turns, shifts, strict=True)}
    errors = {index: one.errors(camera, poses[index]) for index, one in points.items()}
    return _Solved(camera, poses, errors, free, float(deviations[:2].max() / matrix[0, 0]), [])


def _rms(errors: np.ndarray) -> float:
    return float(np.sqrt(np.mean(errors**2)))


def _trimmed(points: dict[int, Seen], solved: _Solved) -> dict[int, Seen]:
    """Return the corners without those that are far beside the others of their photograph, as behind the rim of a sphere."""
    kept = {}
    for index, one in points.items():
        errors = solved.errors[index]
        good = errors <= max(_CORNER_OUTLIER * float(np.median(errors)), _CORNER_PIXELS)
        kept[index] = Seen(one.places[good], one.pixels[good])
    return kept


def _selected(points: dict[int, Seen], size: tuple[int, int], exif: float | None) -> _Solved:
    """Return the camera with as many numbers as pay."""
    if len(points) < _FEWEST and exif is None:
        fact = f"{len(points)} can be used and their files name no focal length"
        step = f"Take at least {_FEWEST}, some of them from 30 to 50 degrees beside the normal."
        raise FitError(message("capture", "photographs", "tell the focal length", fact, step))
    focal = exif or _FOCAL_SHARE * max(size)
    best = _solve(points, size, focal, _MODELS[0][0])
    count = 2 * sum(len(one.places) for one in points.values())
    for free, fewest, numbers in _MODELS[1:]:
        if len(points) < fewest:
            break
        larger = _solve(points, size, focal, free, best)
        if _pays(best, larger, count, numbers) and _sane(larger, size):
            best = larger
    if best.focal_error <= _SURE:
        return best
    if exif is None:
        fact = f"its standard error is {best.focal_error:.0%}: the views are too alike"
        step = "Take some photographs from 30 to 50 degrees beside the normal, or keep the EXIF entry of the focal length."
        raise FitError(message("capture", "the focal length", "be told by the photographs", fact, step))
    free = "k1" if len(points) > 1 else "nothing"
    fixed = _solve(points, size, exif, free, fixed=True)
    note = f"The views are too alike to tell the focal length (within {best.focal_error:.0%}): that of EXIF is taken, {exif:.0f} pixels"
    return _Solved(fixed.camera, fixed.poses, fixed.errors, f"{free}, focal length of EXIF", 0.0, [note])


def _squares(solved: _Solved) -> float:
    """Return the sum of squares of errors, each photograph's largest bounded, so that one bad one does not choose the model."""
    return sum(float((np.minimum(errors, 3 * np.median(errors)) ** 2).sum()) for errors in solved.errors.values())


def _pays(smaller: _Solved, larger: _Solved, count: int, numbers: int) -> bool:
    before, after = _squares(smaller), _squares(larger)
    more = numbers - next(many for name, _, many in _MODELS if name == smaller.model)
    return count * np.log(max(before, 1e-12) / max(after, 1e-12)) > more * np.log(count) and before > _GAIN * after


def _sane(solved: _Solved, size: tuple[int, int]) -> bool:
    """Return whether the lens bends what is inside the picture one way only, and its axis is near the middle."""
    camera = solved.camera
    corner = np.hypot(*size) / 2 / camera.matrix[0, 0]
    radius = np.linspace(0, corner, 50)
    k1, k2, _, _, k3 = camera.distortion
    slope = 1 + 3 * k1 * radius**2 + 5 * k2 * radius**4 + 7 * k3 * radius**6
    middle = np.abs(camera.matrix[:2, 2] - (np.array(size) - 1) / 2)
    return bool((slope > 0.2).all() and (slope < 3).all() and (middle < 0.15 * np.array(size)).all())


def _outlier(points: dict[int, Seen], solved: _Solved, size: tuple[int, int]) -> tuple[int, str] | None:
    """Return the photograph that fits worst, where that is far beside the others, and in words how far; None when all fit."""
    if len(points) <= _FEWEST:
        return None
    rms = {index: _rms(errors) for index, errors in solved.errors.items()}
    worst = max(rms, key=rms.__getitem__)
    usual = float(np.median(list(rms.values())))
    if rms[worst] <= max(_OUTLIER * usual, _OUTLIER_PIXELS, _OUTLIER_SHARE * float(np.hypot(*size))):
        return None
    return worst, f"the board does not lie in it as in the others: corners are {rms[worst]:.1f} pixels off, {usual:.2f} are usual"
