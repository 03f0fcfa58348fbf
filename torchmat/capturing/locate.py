"""From files to a scene: photographs are read, the board is found in each, and all together tell the camera and where it stood."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from torchmat.btf.listing import is_image, natural
from torchmat.capturing.board import Board
from torchmat.capturing.camera import Calibration, calibrate
from torchmat.capturing.detect import Detection, detect
from torchmat.capturing.develop import is_raw
from torchmat.capturing.photographs import Photograph, photograph
from torchmat.capturing.scene import Scene, Step
from torchmat.errors import DataError, message
from torchmat.progress import progress


@dataclass(frozen=True, eq=False)
class Located:
    """A scene of the photographs that can be used, what was found on the way, and in words why others are left out, by their names."""

    scene: Scene
    steps: list[Step]
    left_out: dict[str, str]
    detections: tuple[Detection, ...]
    calibration: Calibration


def photograph_files(paths: str | Path | Sequence[str | Path]) -> list[Path]:
    """Return the photographs, raw files too, of a folder as people count (img2 before img10), or those that are listed.

    Raises DataError where there is none, or two have one name beside their suffix: one of them would stand for both.
    """
    if isinstance(paths, str | Path):
        folder = Path(paths)
        if not folder.is_dir():
            raise DataError(message(str(folder), "the path", "be a folder of photographs", "it is none", "Check the spelling."))
        found = sorted((path for path in folder.iterdir() if is_image(path.name) or is_raw(path)), key=lambda path: natural(path.name))
    else:
        found = [Path(path) for path in paths]
    if not found:
        raise DataError(message(str(paths), "the folder", "hold photographs", "it holds none", "Check the spelling."))
    named: dict[str, Path] = {}
    for path in found:
        other = named.setdefault(path.stem.lower(), path)
        if other is not path:
            step = "Rename or remove one of them; of a raw file and its JPEG keep the raw file."
            raise DataError(message(str(path), "photographs", "have names of their own beside the suffix", f"{other.name} is there too", step))
    return found


def read_photographs(files: Sequence[Path], encoding: str = "auto") -> tuple[list[Photograph], dict[str, str]]:
    """Return photographs, and in words why others cannot be read, by their names."""
    found, left_out = [], {}
    for path in files:
        try:
            found.append(photograph(path, encoding))
        except DataError as error:
            left_out[path.name] = f"unreadable: {error}"
    return found, left_out


def find_board(board: Board, photographs: Sequence[Photograph], show: bool | None = None) -> list[Detection]:
    """Return what each photograph shows of the board; one that cannot be read has that as its reason."""
    found = []
    for one in progress(photographs, "looking for the board", show=show):
        try:
            developed = one.developed()
            found.append(detect(board, developed.linear, developed.clipped))
        except DataError as error:
            found.append(Detection(np.zeros(0, int), np.zeros((0, 2)), np.nan, f"unreadable: {error}"))
    return found


def locate(board: Board, photographs: Sequence[Photograph], unread: dict[str, str], show: bool | None = None) -> Located:
    """Return the scene of photographs; `unread` are those that are left out already.

    Raises FitError or DataError where too few can be used, or they are of several cameras.
    """
    detections = find_board(board, photographs, show)
    calibration = calibrate(board, photographs, detections)
    reasons = [detection.reason or calibration.outliers.get(index, "") for index, detection in enumerate(detections)]
    left_out = {**unread, **{one.name: reason for one, reason in zip(photographs, reasons, strict=True) if reason}}
    kept = [index for index, reason in enumerate(reasons) if not reason]
    poses = tuple(calibration.poses[index] for index in kept)
    scene = Scene(board, tuple(photographs[index] for index in kept), (calibration.camera,) * len(kept), poses)
    steps = [_photographs(photographs, detections, unread, left_out), _camera(calibration), _poses(scene, calibration, kept)]
    return Located(scene, steps, left_out, tuple(detections[index] for index in kept), calibration)


def _photographs(photographs: Sequence[Photograph], detections: Sequence[Detection], unread: dict[str, str], left_out: dict[str, str]) -> Step:
    total = len(photographs) + len(unread)
    blur = [one.blur for one in detections if not one.reason]
    pairs = zip(photographs, detections, strict=True)
    rows = [(one.name, len(detection.corners), detection.blur, left_out.get(one.name, "")) for one, detection in pairs]
    rows += [(name, 0, float("nan"), reason) for name, reason in unread.items()]
    used = total - len(left_out)
    figures = {"photographs": total, "used": used, "left_out": left_out}
    header = ("photograph", "corners", "blur in pixels", "left out because")
    notes = [f"{name}: {reason}" for name, reason in left_out.items()]
    residual = f"edges {np.median(blur) if blur else np.nan:.2f} px (standard deviation)"
    return Step("board", f"{used} of {total} photographs are used", residual, figures, header, rows, notes=notes)


def _camera(calibration: Calibration) -> Step:
    camera = calibration.camera
    focal, middle = camera.matrix[0, 0], camera.matrix[:2, 2]
    figures = {
        "size": list(camera.size), "matrix": camera.matrix.tolist(), "distortion": camera.distortion.tolist(), "model": calibration.model,
        "rms_pixels": calibration.rms, "focal_error": calibration.focal_error,
    }
    rows = [("focal length", focal, "pixels"), ("its standard error", 100 * calibration.focal_error, "%")]
    rows += [("principal point, column", middle[0], "pixels"), ("principal point, row", middle[1], "pixels")]
    rows += [(name, value, "") for name, value in zip(("k1", "k2", "p1", "p2", "k3"), camera.distortion, strict=True)]
    found = f"focal length {focal:.0f} px; found: {calibration.model}"
    return Step("camera", found, f"{calibration.rms:.2f} px rms", figures, ("", "value", "unit"), rows, notes=calibration.notes)


def _poses(scene: Scene, calibration: Calibration, kept: Sequence[int]) -> Step:
    positions = np.array([pose.position for pose in scene.poses])
    distance = np.linalg.norm(positions, axis=1)
    polar, azimuth = np.degrees(np.arccos(positions[:, 2] / distance)), np.degrees(np.arctan2(positions[:, 1], positions[:, 0])) % 360
    residuals = [calibration.residuals[index] for index in kept]
    rows = [(one.name, *cells) for one, *cells in zip(scene.photographs, polar, azimuth, distance, residuals, strict=True)]
    found = f"{distance.min():.0f} to {distance.max():.0f} mm away, {polar.min():.0f} to {polar.max():.0f} degrees beside the normal"
    each = zip(scene.photographs, positions, residuals, strict=True)
    figures = {one.name: {"position_mm": place.tolist(), "rms_pixels": rms} for one, place, rms in each}
    # An error e of a corner turns the view by about e pixels over the focal length: a bound, for there are many corners.
    worst = float(np.degrees(max(residuals) / calibration.camera.matrix[0, 0]))
    header = ("photograph", "polar", "azimuth", "mm away", "rms in pixels")
    return Step("poses", found, f"at most {worst:.2f} degrees by one corner's error", figures, header, rows)
