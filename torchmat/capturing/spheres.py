"""Lamps from mirror spheres: the highlight, the ray that it reflects, and where the rays of two spheres meet."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.ndimage import center_of_mass, find_objects, label

from torchmat.capturing.light import Light
from torchmat.capturing.view import Camera, Pose
from torchmat.errors import DataError, message

_RIM = 0.97  # of the outline; reflections beyond are pressed together
_BRIGHT = 0.6  # of the brightest that belongs to a highlight
_LARGEST = 0.06  # of the disc that a highlight may cover; a matte ball is bright on more
_LONGEST = 3.0  # times a round spot of the same area
_SECOND = 0.5  # of the brightest spot's light that makes another one as good as it
_STANDS_OUT = 1.5  # times what is around it
_LEAST_SIGMA = 0.15  # pixels
_NEAR = 3.0  # standard errors of parallax that show a lamp to be near
_KNOWN = 0.3  # of its distance to which a lamp's distance must be known
_CLEAN = "Show one bare lamp, darken the room, and polish the sphere."


class Highlight(NamedTuple):
    """A highlight's `pixel` [2] (column, row), its standard error `sigma` and its `radius` in pixels."""

    pixel: np.ndarray
    sigma: float
    radius: float


class Ray(NamedTuple):
    """What a sphere reflects: from a `point` [3] on it, in mm, along `direction` [3] (unit) to the lamp, known to `sigma` radians."""

    point: np.ndarray
    direction: np.ndarray
    sigma: float


def find_highlight(where: str, linear: np.ndarray, clipped: np.ndarray, around: np.ndarray) -> Highlight:
    """Return the highlight in a photograph `linear` [3, H, W], of which `clipped` [H, W] is no more than that bright, within the outline `around` [n, 2] of a mirror sphere.

    The brightest compact spot, its centre weighted by the light above its surroundings. Raises DataError, which starts with
    `where`, when the sphere is no mirror (what is bright is broad, or does not stand out) or shows two lamps alike.
    """
    low = np.maximum(np.floor(around.min(0)).astype(int), 0)
    high = np.minimum(np.ceil(around.max(0)).astype(int) + 1, np.array(linear.shape[:0:-1]))
    if (high - low < 3).any():
        raise DataError(message(where, "the sphere", "lie in the photograph", "it is outside", "Photograph all of the board."))
    window = (slice(low[1], high[1]), slice(low[0], high[0]))
    grey = linear[:, *window].mean(axis=0, dtype=np.float64)
    inside = _share_of_outline(around - low, grey.shape) < _RIM
    grey = np.where(inside, grey, 0)
    bright = inside & ((grey >= _BRIGHT * grey.max()) if not (clipped[window] & inside).any() else clipped[window])
    spots, count = label(bright, np.ones((3, 3)))
    flux, compact = np.zeros(count), np.zeros(count, bool)
    for number, box in enumerate(find_objects(spots)):
        spot = spots[box] == number + 1
        area, extent = spot.sum(), max(spot.shape)
        flux[number] = (grey[box] * spot).sum()
        compact[number] = area < _LARGEST * inside.sum() and extent < _LONGEST * 2 * np.sqrt(area / np.pi) + 1
    if not compact.any() or flux[~compact].sum() > flux[compact].max() * 20:
        share = bright.sum() / inside.sum()
        fact = f"{100 * share:.0f} % of it is about as bright as its brightest part, in no compact spot"
        raise DataError(message(where, "the sphere", "be a mirror with one compact highlight", fact, _CLEAN))
    flux[~compact] = 0
    order = np.argsort(-flux)
    if count > 1 and flux[order[1]] > _SECOND * flux[order[0]]:
        fact = f"there are two, the weaker with {flux[order[1]] / flux[order[0]]:.2f} of the light"
        raise DataError(message(where, "the sphere", "show one highlight", fact, _CLEAN))
    found = _centred(where, grey, inside, spots == order[0] + 1)
    return found._replace(pixel=found.pixel + low)


def _share_of_outline(around: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Return how far pixels [H, W] are from the middle of an outline, 1 on the outline itself."""
    middle = around.mean(0)
    turn = np.arctan2(around[:, 1] - middle[1], around[:, 0] - middle[0])
    order = np.argsort(turn)
    reach = np.linalg.norm(around - middle, axis=1)[order]
    rows, columns = np.indices(shape)
    edge = np.interp(np.arctan2(rows - middle[1], columns - middle[0]), turn[order], reach, period=2 * np.pi)
    return np.hypot(rows - middle[1], columns - middle[0]) / edge


def _centred(where: str, grey: np.ndarray, inside: np.ndarray, spot: np.ndarray) -> Highlight:
    radius = float(np.sqrt(spot.sum() / np.pi))
    row, column = center_of_mass(spot)
    rows, columns = np.indices(grey.shape)
    away = np.hypot(rows - row, columns - column)
    ring = inside & (away > 2 * radius + 2) & (away < 3 * radius + 4)
    level = float(np.median(grey[ring])) if ring.any() else 0.0
    if grey[spot].mean() < _STANDS_OUT * level:
        fact = f"its brightest spot has {grey[spot].mean():.3g} and its surroundings {level:.3g}"
        raise DataError(message(where, "the sphere", "be a mirror with a highlight that stands out", fact, _CLEAN))
    weight = np.where(inside & (away < 1.5 * radius + 2), np.maximum(grey - level, 0), 0)
    centre = center_of_mass(weight)
    # The core and the whole spot with its flanks agree where the spot is what it is taken for.
    apart = float(np.hypot(centre[0] - row, centre[1] - column))
    return Highlight(np.array([centre[1], centre[0]]), max(_LEAST_SIGMA, apart), radius)


def lamp_ray(camera: Camera, pose: Pose, centre: np.ndarray, radius: float, highlight: Highlight, sigma_mm: float = 0.0) -> Ray:
    """Return the ray to the lamp that a highlight on a mirror sphere shows.

    The camera's ray meets the sphere at a point with the normal n; seen along v, it reflects l = 2 (n . v) n - v. Its
    standard error is that of the highlight and of the sphere's place (`sigma_mm`, along x and y each), carried over by
    differences.
    """
    def reflected(pixel: np.ndarray, middle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        ray = pose.rays(camera, pixel)
        away = pose.position - middle
        along = float(ray @ away)
        # Highlights beside the outline (a sphere that stands elsewhere) reflect as its edge does.
        inner = max(along**2 - (float(away @ away) - radius**2), 0.0)
        point = pose.position + (-along - np.sqrt(inner)) * ray
        normal = (point - middle) / np.linalg.norm(point - middle)
        return point, ray - 2 * float(ray @ normal) * normal

    point, direction = reflected(highlight.pixel, centre)
    square = 0.0
    for axis in (0, 1):
        step = np.eye(2)[axis] * 0.1
        square += float((((reflected(highlight.pixel + step, centre)[1] - direction) / 0.1 * highlight.sigma) ** 2).sum())
        step = np.eye(3)[axis] * 0.01
        square += float((((reflected(highlight.pixel, centre + step)[1] - direction) / 0.01 * sigma_mm) ** 2).sum())
    return Ray(point, direction, float(np.sqrt(square / 2)))


def lamp_of_rays(where: str, rays: list[Ray]) -> Light:
    """Return the lamp that the rays of one or two mirror spheres (or more) show.

    One tells a direction, and the lamp is taken for far. Two tell a position, where they come nearest to each other, each ray
    weighted by its error at that distance; where their parallax is within its error, or leaves the distance open, the lamp
    is far. Raises DataError, which starts with `where`, when the lamp is below the sample's plane.
    """
    weights = np.array([1 / ray.sigma**2 for ray in rays])
    mean = sum(weight * ray.direction for weight, ray in zip(weights, rays, strict=True))
    mean /= np.linalg.norm(mean)
    far = Light(mean, float(np.degrees(1 / np.sqrt(weights.sum()))), how="mirror spheres, far" if len(rays) > 1 else "a mirror sphere")
    lamp = far if len(rays) < 2 else _nearest(rays, far)
    height = float(lamp.direction[2])
    if height <= 0:
        fact = f"its direction is ({', '.join(f'{one:.2f}' for one in lamp.direction)})"
        step = "Check which sphere the highlight is on, and that the board lies as it was printed."
        raise DataError(message(where, "the lamp", "be above the sample's plane", fact, step))
    return lamp


def _nearest(rays: list[Ray], far: Light) -> Light:
    pairs = [(a, b) for number, a in enumerate(rays) for b in rays[:number]]
    angles = [np.arctan2(np.linalg.norm(np.cross(a.direction, b.direction)), a.direction @ b.direction) / np.hypot(a.sigma, b.sigma) for a, b in pairs]
    if max(angles) < _NEAR:
        return far
    reach = np.full(len(rays), 500.0)
    for _ in range(10):
        normal, right = np.zeros((3, 3)), np.zeros(3)
        for ray, distance in zip(rays, reach, strict=True):
            across = (np.eye(3) - np.outer(ray.direction, ray.direction)) / (distance * ray.sigma) ** 2
            normal, right = normal + across, right + across @ ray.point
        position = np.linalg.solve(normal, right)
        reach = np.array([max(float((position - ray.point) @ ray.direction), 1.0) for ray in rays])
    covariance = np.linalg.inv(normal)
    distance = float(np.linalg.norm(position))
    missed = [float(np.linalg.norm(np.cross(position - ray.point, ray.direction))) for ray in rays]
    expected = float(np.sqrt(np.mean([(one * ray.sigma) ** 2 for one, ray in zip(reach, rays, strict=True)])))
    along = position / distance
    if np.sqrt(along @ covariance @ along) > _KNOWN * distance or min((position - ray.point) @ ray.direction for ray in rays) <= 0:
        return Light(far.direction, far.sigma_deg, residual=max(missed), how=far.how, notes=("the spheres do not tell how far the lamp is: taken for far",))
    across = np.eye(3) - np.outer(along, along)
    sigma = float(np.degrees(np.sqrt(np.trace(across @ covariance @ across) / 2) / distance))
    notes: tuple[str, ...] = ()
    if max(missed) > 4 * expected:
        notes = (f"the rays miss each other by {max(missed):.1f} mm, {max(missed) / expected:.0f} times what their errors explain: a sphere stands elsewhere, or they show two lamps",)
    return Light(along, sigma, position, covariance, max(missed), "two mirror spheres" if len(rays) == 2 else "mirror spheres", notes)
