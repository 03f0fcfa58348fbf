"""A simulated studio: photographs of a known material in a board's window, with everything that is true of them.

Light is counted so that a white matte surface under the irradiance 1 has the value cos(theta), as measured BTFs have it. The lens, the spheres
and the shading of the board are this module's own, so that what the package finds is not compared with itself.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from scipy.ndimage import gaussian_filter

from tests.capturing.shots import Lamp, Lens, Shot, beside_lens, shots_around

from torchmat.capturing.board import BLACK, WHITE, Board
from torchmat.models import Material

Shade = Callable[[torch.Tensor, torch.Tensor], torch.Tensor]
_BAND = 32  # rows of pixels at once
_FINE = 6  # rays along a pixel's side on mirror spheres, whose highlights are small
TABLE, SURROUNDINGS, MIRROR = 0.12, 0.01, 0.8  # what lies around the paper, what spheres see above it, and what they keep of it


@dataclass(frozen=True)
class Taken:
    """A photograph, `pixels` [H, W, 3], and what is true of it: per texel the `value` [3, h, w] under the irradiance 1, directions to `light` and
    `view` [3, h, w] and the `irradiance` [3, h, w] of the lamp where it shines straight; `linear` [H, W, 3] before noise and codes."""

    shot: Shot
    pixels: np.ndarray
    linear: np.ndarray
    value: np.ndarray
    light: np.ndarray
    view: np.ndarray
    irradiance: np.ndarray


@dataclass(frozen=True)
class Studio:
    """A board with its sample and spheres before a camera.

    Args:
        sample: a material, or a function of unit planes light and view [3, h, w], row 0 at the top, that returns values [3, h, w].
        texels: (h, w) of the sample; None is the material's size. They fill `extent` (left, bottom, right, top) in mm; None is the window.
        vignetting: what is lost in the corners; `gains` are the camera's, red, green and blue.
        full_well, read_noise: electrons at white, and of the read-out; 0 electrons at white is no noise.
        supersampling: rays along a pixel's side.  blur: standard deviation in pixels.  bits: 8 (sRGB) or 16 (linear).
        matte_spheres: whether the spheres are no mirrors.
    """

    sample: Material | Shade
    board: Board = field(default_factory=Board)
    lens: Lens = field(default_factory=Lens)
    texels: tuple[int, int] | None = None
    extent: tuple[float, float, float, float] | None = None
    vignetting: float = 0.0
    gains: tuple[float, float, float] = (1.0, 1.0, 1.0)
    full_well: float = 0.0
    read_noise: float = 5.0
    supersampling: int = 2
    blur: float = 0.0
    bits: int = 8
    seed: int = 0
    matte_spheres: bool = False

    @property
    def sample_box(self) -> np.ndarray:
        return np.asarray(self.board.window if self.extent is None else self.extent, float)

    def texel_points(self) -> np.ndarray:
        """Return the middles of the texels [h, w, 3] in mm."""
        height, width = self.texels or self.sample.size
        left, bottom, right, top = self.sample_box
        x = left + (np.arange(width) + 0.5) / width * (right - left)
        y = top - (np.arange(height) + 0.5) / height * (top - bottom)
        return np.stack((*np.meshgrid(x, y), np.zeros((height, width))), axis=-1)

    def pixels_of(self, shot: Shot, points: np.ndarray) -> np.ndarray:
        """Return the pixels [..., 2] at which points [..., 3] in mm are seen."""
        seen = points @ shot.rotation.T + shot.translation
        x, y = self.lens.bent(seen[..., 0] / seen[..., 2], seen[..., 1] / seen[..., 2])
        return np.stack((x * self.lens.focal + self.lens.matrix[0, 2], y * self.lens.focal + self.lens.matrix[1, 2]), axis=-1)

    def take(self, shots: list[Shot]) -> list[Taken]:
        """Return the photographs, each with what is true of it."""
        return [self.one(shot, number) for number, shot in enumerate(shots)]

    def one(self, shot: Shot, number: int = 0) -> Taken:
        """Return one photograph; its noise depends on the seed and its number."""
        points = self.texel_points()
        light, _, strength = shot.lamp.at(points)
        view = np.asarray(shot.position) - points
        view /= np.linalg.norm(view, axis=-1, keepdims=True)
        planes = [torch.from_numpy(np.moveaxis(one, -1, 0).astype(np.float32)) for one in (light, view)]
        shade = self.sample.shade if isinstance(self.sample, Material) else self.sample
        with torch.no_grad():
            value = shade(*planes).numpy()
        irradiance = (np.asarray(shot.lamp.colour)[:, None, None] * strength).astype(np.float32)
        linear = self._seen(shot, value * irradiance)
        return Taken(shot, self._coded(linear, number), linear, value, planes[0].numpy(), planes[1].numpy(), irradiance)

    def _seen(self, shot: Shot, texture: np.ndarray) -> np.ndarray:
        width, height = self.lens.size
        picture = self._rays(shot, texture, np.arange(width), np.arange(height), self.supersampling, False)
        for left, top, right, bottom in self._sphere_boxes(shot):
            picture[top:bottom, left:right] = self._rays(shot, texture, np.arange(left, right), np.arange(top, bottom), _FINE, True)
        if self.blur:
            picture = gaussian_filter(picture, (self.blur, self.blur, 0))
        x, y = np.arange(width) - (width - 1) / 2, np.arange(height) - (height - 1) / 2
        fall = 1 - self.vignetting * (x[None] ** 2 + y[:, None] ** 2) / (x[0] ** 2 + y[0] ** 2)
        return (picture * fall[..., None] * (shot.exposure * np.asarray(self.gains))).astype(np.float32)

    def _sphere_boxes(self, shot: Shot) -> list[tuple[int, int, int, int]]:
        boxes = []
        for centre in self.board.sphere_centres:
            column, row = self.pixels_of(shot, centre)
            reach = 1.5 * self.lens.focal * self.board.diameter / 2 / (shot.rotation @ centre + shot.translation)[2] + 2
            limits = [(column - reach, self.lens.size[0]), (row - reach, self.lens.size[1]), (column + reach, self.lens.size[0]), (row + reach, self.lens.size[1])]
            left, top, right, bottom = (int(np.clip(at, 0, most)) for at, most in limits)
            if left < right and top < bottom:
                boxes.append((left, top, right, bottom))
        return boxes

    def _rays(self, shot: Shot, texture: np.ndarray, columns: np.ndarray, rows: np.ndarray, rays: int, mirrors: bool) -> np.ndarray:
        """Return the mean radiance [rows, columns, 3] of rays x rays rays in each pixel of a grid."""
        total = np.zeros((len(rows), len(columns), 3), np.float32)
        origin, turn = np.asarray(shot.position, np.float32), shot.rotation.astype(np.float32)
        for start in range(0, len(rows), _BAND):  # what is done at once stays in the processor's cache
            band = slice(start, start + _BAND)
            for dx, dy in _within_pixel(rays**2):
                x, y = self.lens.straight(columns + dx, rows[band] + dy)
                ray = x[..., None] * turn[0] + y[..., None] * turn[1] + turn[2]
                total[band] += self._mirrored(shot, texture, origin, ray) if mirrors else self._plane(shot, texture, origin, ray)[0]
        return total / rays**2

    def _plane(self, shot: Shot, texture: np.ndarray, origin: np.ndarray, ray: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the radiance [..., 3] of what rays meet in the plane z = 0, and how far it is; infinitely far where they go up."""
        down = ray[..., 2] < -1e-6
        far = np.where(down, -origin[..., 2] / np.where(down, ray[..., 2], -1), np.float32(np.inf))
        width, height = (side * self.board.scale / 2 for side in self.board.page)
        hit = origin[..., :2] + np.where(down, far, 0)[..., None] * ray[..., :2]
        on_paper = down & (np.abs(hit[..., 0]) < width) & (np.abs(hit[..., 1]) < height)
        colour = np.full(ray.shape, TABLE, np.float32) * np.asarray(shot.lamp.colour, np.float32)
        colour[on_paper] = self._paper(shot, texture, hit[on_paper])
        return colour, far

    def _paper(self, shot: Shot, texture: np.ndarray, hit: np.ndarray) -> np.ndarray:
        """Return the radiance [n, 3] of the board and its sample at points [n, 2] in mm."""
        x, y = hit[:, 0], hit[:, 1]
        points = np.concatenate((hit, np.zeros_like(hit[:, :1])), axis=1)
        light, distance, strength = shot.lamp.at(points)
        lit = self._lit(points, light, distance)
        matte = self.board.reflectance(x, y) * np.maximum(light[:, 2], 0) * strength
        colour = matte[:, None] * np.asarray(shot.lamp.colour, np.float32)
        x, y = self._on_sample(shot, x, y)
        left, bottom, right, top = self.sample_box
        inside = (x > left) & (x < right) & (y > bottom) & (y < top)
        colour[inside] = _bilinear(texture, (x[inside] - left) / (right - left), (top - y[inside]) / (top - bottom))
        return colour * lit[:, None]

    def _on_sample(self, shot: Shot, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        dx, dy, degrees = shot.sample_moved
        c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
        return c * (x - dx) + s * (y - dy), c * (y - dy) - s * (x - dx)

    def _lit(self, points: np.ndarray, light: np.ndarray, distance: np.ndarray) -> np.ndarray:
        """Return 0 where a sphere stands between points and the lamp, else 1."""
        lit = np.ones(points.shape[:-1], np.float32)
        for centre in self.board.sphere_centres.astype(np.float32):
            away = centre - points
            along = (away * light).sum(-1)
            beside = (away**2).sum(-1) - along**2
            lit[(along > 0) & (along < distance) & (beside < (self.board.diameter / 2) ** 2)] = 0
        return lit

    def _mirrored(self, shot: Shot, texture: np.ndarray, origin: np.ndarray, ray: np.ndarray) -> np.ndarray:
        colour, far = self._plane(shot, texture, origin, ray)
        length = np.linalg.norm(ray, axis=-1)
        unit = ray / length[..., None]
        for centre in self.board.sphere_centres.astype(np.float32):
            along = unit @ (centre - origin)
            inner = (self.board.diameter / 2) ** 2 - (((centre - origin) ** 2).sum() - along**2)
            hits = (inner > 0) & (along - np.sqrt(np.maximum(inner, 0)) < far * length)
            if not hits.any():
                continue
            point = origin + (along[hits] - np.sqrt(inner[hits]))[:, None] * unit[hits]
            normal = (point - centre) / (self.board.diameter / 2)
            bounced = unit[hits] - 2 * (unit[hits] * normal).sum(-1, keepdims=True) * normal
            if self.matte_spheres:
                light, _, strength = shot.lamp.at(point)
                shade = MIRROR * strength * np.maximum((normal * light).sum(-1), 0)
                colour[hits] = shade[:, None] * np.asarray(shot.lamp.colour, np.float32)
            else:
                colour[hits] = MIRROR * self._reflected(shot, texture, point, bounced)
        return colour

    def _reflected(self, shot: Shot, texture: np.ndarray, point: np.ndarray, bounced: np.ndarray) -> np.ndarray:
        below, far = self._plane(shot, texture, point, bounced)
        seen = np.where(np.isfinite(far)[:, None], below, np.float32(SURROUNDINGS))
        light, distance, strength = shot.lamp.at(point)
        reach = np.linalg.norm(shot.lamp.position) if shot.lamp.far else distance
        # A disc of this radius and distance that gives the irradiance has pi times the radiance of strength (distance / radius)^2.
        bright = (strength * (reach / shot.lamp.radius) ** 2)[:, None] * np.asarray(shot.lamp.colour, np.float32)
        apart = np.linalg.norm(np.cross(bounced, light), axis=-1)
        on_lamp = ((bounced * light).sum(-1) > 0) & (apart < shot.lamp.radius / reach)
        return np.where(on_lamp[:, None], bright, seen)

    def _coded(self, linear: np.ndarray, number: int) -> np.ndarray:
        if self.full_well:
            random = np.random.default_rng((self.seed, number))
            deviation = np.sqrt(np.maximum(linear, 0) * self.full_well + self.read_noise**2) / self.full_well
            linear = linear + deviation.astype(np.float32) * random.standard_normal(linear.shape, np.float32)
        linear = np.clip(linear, 0, 1)
        if self.bits == 16:
            return np.round(linear * 65535).astype(np.uint16)
        encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)
        return np.round(encoded * 255).astype(np.uint8)


def _within_pixel(count: int) -> np.ndarray:
    """Return places [count, 2] in a pixel, no two in one row or column: an edge along the pixels is as smooth as any other."""
    if count == 4:
        order = np.array([1, 3, 0, 2])
    else:
        step = next(step for step in range(round(count * 0.618), count + 1) if math.gcd(step, count) == 1)
        order = np.arange(count) * step % count
    return (np.stack((np.arange(count), order), axis=1) + 0.5) / count - 0.5


def _bilinear(texture: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return [n, 3] of a texture [3, h, w] at shares of its width and, from the top, its height."""
    _, height, width = texture.shape
    column, row = np.clip(u * width - 0.5, 0, width - 1), np.clip(v * height - 0.5, 0, height - 1)
    left, top = np.minimum(column.astype(int), max(width - 2, 0)), np.minimum(row.astype(int), max(height - 2, 0))
    a, b = (column - left)[:, None], (row - top)[:, None]
    right, below, flat = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1), np.moveaxis(texture, 0, -1)
    upper = flat[top, left] * (1 - a) + flat[top, right] * a
    return (upper * (1 - b) + (flat[below, left] * (1 - a) + flat[below, right] * a) * b).astype(np.float32)


def write(folder: Path, taken: list[Taken], suffix: str = ".png", exif: dict[str, object] | None = None) -> list[Path]:
    """Write the photographs as photo_01, photo_02 ... with EXIF entries in OpenImageIO's names, such as "Exif:FocalLength"; return their paths."""
    import OpenImageIO as oiio

    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for number, one in enumerate(taken, 1):
        height, width, channels = one.pixels.shape
        spec = oiio.ImageSpec(width, height, channels, one.pixels.dtype.name)
        spec.attribute("compression", "jpeg:95" if suffix in (".jpg", ".jpeg") else "zip")
        for name, value in (exif or {}).items():
            spec.attribute(name, value)
        path = folder / f"photo_{number:02d}{suffix}"
        target = oiio.ImageOutput.create(str(path))
        assert target.open(str(path), spec) and target.write_image(np.ascontiguousarray(one.pixels)) and target.close(), path
        paths.append(path)
    return paths


def matte_grey(value: float = 0.5) -> Shade:
    """Return a matte sample of one grey, for `Studio(sample=..., texels=...)`."""
    return lambda light, view: value * light[2:].clamp(min=0).expand(3, -1, -1)


__all__ = [
    "BLACK", "WHITE", "Lamp", "Lens", "Shot", "Studio", "Taken", "beside_lens", "matte_grey", "shots_around", "write",
]
