"""An isotropic BRDF as a few pictures of a lit sphere (Mihálik & Ďurikovič, "Image-based BRDF Representation").

The pictures show a unit sphere from afar, lit in the plane Y = 0 at polar angles from the view. Under a light between
two of them both are looked up at the normal turned toward their light, and blended (eq. 4).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Self

import torch
import torch.nn.functional as functional
from torch import Tensor

from torchmat.errors import RangeError, ShapeError, message
from torchmat.models.base import Material
from torchmat.models.sphere_geometry import (
    LookUps, atlas_grid, directions_on, find_look_ups, find_neighbours, find_turns, place_on_sphere, sine_to_half,
    sphere_normals,
)
from torchmat.models.storage import MapSpec

PAPER_ANGLES_DEG = (0.0, 45.0, 90.0, 135.0)
LARGEST_TURN = 2.0
_CLOSEST_DEG = 0.01
_PARTS, _FEWEST_POINTS = 16, 4096  # threads share out the batch of a look-up, so many points are cut into parts


class SphereImages(Material):
    """Sphere pictures at `angles_deg` between light and view, and how far to turn a normal toward each.

    `angles_deg`: ascending, the first 0, the last at most 180 (the paper's are 0, 45, 90, 135, or 0, 30, ..., 150 for
    metals). Maps: `images` [3 n, S, S], one texture per picture, row 0 at the top, the light to the right, values at a
    light of 1; `turn` [1, 1 or 2 (n - 1), K], the factor k at K places from -1 to 1 of the signed sine of the angle
    between the half vector and (n_x, 0, n_z), positive toward the light, linear between them: one row for all, or
    two for each interval, for its lower and its upper picture; `tint` [3, H, W], a colour factor per texel,
    1 in a homogeneous material (1 x 1). Beyond the last picture that one serves alone, with k = 3/4. Normals that turn
    away from the viewer are looked up at the rim. The paper has one k, the same to both sides, and no tint.
    """

    name = "sphere_images"
    glsl = "sphere_images.glsl"
    isotropic = True

    def __init__(
        self, maps: Mapping[str, Tensor], *, angles_deg: Sequence[float] = PAPER_ANGLES_DEG, **settings: Any
    ) -> None:
        self._angles = checked_angles(self.name, angles_deg)
        # Shared with the copies that `at` makes, so that the pictures are laid out once for many renders.
        self._kept: dict[str, Any] = {}
        super().__init__(maps, angles_deg=[math.degrees(angle) for angle in self._angles], **settings)
        self.options["angles_deg"] = [float(angle) for angle in angles_deg]
        rows, columns = self.maps["images"].shape[-2:]
        if rows != columns:
            raise ShapeError(message(self.name, "images", "be square", f"they are {rows} x {columns}"), map="images")
        allowed = {1, 2 * (len(self._angles) - 1)} - {0}
        if self.maps["turn"].shape[1] not in allowed:
            fact = f"it has {self.maps['turn'].shape[1]}"
            requirement = f"have {' or '.join(map(str, sorted(allowed)))} rows for {len(self._angles)} pictures"
            raise ShapeError(message(self.name, "turn", requirement, fact), map="turn")

    @classmethod
    def from_brdf(
        cls, brdf: Any, angles_deg: Sequence[float] = PAPER_ANGLES_DEG, size: int = 512, *, turn: Tensor | None = None,
        samples: int = 1, **settings: Any,
    ) -> Self:
        """Return the paper's material of a `Brdf`: its sphere pictures and, unless `turn` is given, the paper's k.

        `size` in texels, `samples` x `samples` points in each; `settings` as of any material. Raises RangeError when
        the BRDF is anisotropic.
        """
        images = render_spheres(brdf, angles_deg, size, samples=samples)
        turn = paper_turn(images.dtype) if turn is None else turn
        maps = {"images": images, "turn": turn, "tint": torch.ones(3, 1, 1, dtype=images.dtype)}
        return cls(maps, angles_deg=angles_deg, **settings)

    def own_specs(self) -> tuple[MapSpec, ...]:
        names = tuple(angle_name(math.degrees(angle)) for angle in self._angles)
        return (
            MapSpec("tint", "colour factor of the sphere pictures", low=0.0, colour=True, linear=True),
            MapSpec(
                "images", "sphere lit at an angle from the view", layers=names, low=0.0, colour=True, per_texel=False,
                linear=True, storage=self.storage,
            ),
            MapSpec(
                "turn", "k over the sine of the angle to the half vector", layer_channels=1, low=-LARGEST_TURN,
                high=LARGEST_TURN, per_texel=False,
            ),
        )

    def value(self, light: Tensor, view: Tensor) -> Tensor:
        place = place_on_sphere(light, view)
        near = find_neighbours(place.angle, self._angles)
        k = find_turns(self.maps["turn"], sine_to_half(place), near.lower)
        look_ups = find_look_ups(place, near, k)
        lower, upper = self._look_up_spheres(look_ups)
        return torch.lerp(lower, upper, look_ups.share) * self.maps["tint"]

    def _look_up(self, value: Tensor, uv: Tensor, nearest: bool) -> Tensor:
        if value.shape[-2:] == (1, 1):
            return value.expand(-1, *uv.shape[-2:])
        return super()._look_up(value, uv, nearest)

    def _look_up_spheres(self, look_ups: LookUps) -> tuple[Tensor, Tensor]:
        """Return the lower and the upper picture, [..., 3, h, w], where `look_ups` says."""
        atlas = self._atlas()
        grid = atlas_grid(look_ups, len(self._angles), atlas.shape[-1])
        shape, points = grid.shape[1:-1], grid[0].numel() // 2
        parts = _PARTS if points >= _FEWEST_POINTS else 1
        grid = grid.reshape(2, points, 2)
        if points % parts:
            grid = functional.pad(grid, (0, 0, 0, -points % parts))
        found = functional.grid_sample(
            atlas.expand(2 * parts, -1, -1, -1), grid.reshape(2 * parts, 1, -1, 2), mode="bilinear",
            padding_mode="border", align_corners=False,
        )
        found = found.reshape(2, parts, 3, -1).transpose(1, 2).reshape(2, 3, -1)[..., :points]
        # [2, 3, lead, 1, h, w] to [2, lead, 3, h, w]
        found = found.reshape(2, 3, *shape[:-3], *shape[-2:]).movedim(1, -3)
        return found[0], found[1]

    def _atlas(self) -> Tensor:
        """Return the pictures below each other, [1, 3, n S, S]; without gradients it is kept as long as they are."""
        images = self.maps["images"]
        if torch.is_grad_enabled() or images.is_inference():
            return below_each_other(images)
        state = (images._version, images.data_ptr(), images.dtype)
        if self._kept.get("images") is not images or self._kept.get("state") != state:
            self._kept.update(images=images, state=state, atlas=below_each_other(images))
        return self._kept["atlas"]


def below_each_other(images: Tensor) -> Tensor:
    """Return pictures [3 n, S, S] as one atlas [1, 3, n S, S]."""
    count = len(images) // 3
    return images.unflatten(0, (count, 3)).transpose(0, 1).flatten(1, 2)[None]


def paper_turn(dtype: torch.dtype = torch.float32) -> Tensor:
    """Return the paper's k = 1/2 + sin(alpha_h) / 2 (eq. 3) as a table [1, 1, 3]; linear in the sine, so exact."""
    return torch.tensor([[[1.0, 0.5, 1.0]]], dtype=dtype)


def constant_turn(k: float, dtype: torch.dtype = torch.float32) -> Tensor:
    """Return one k for all normals, [1, 1, 1]: 1 suits diffuse shading, 1/2 highlights (the paper's figure 4 a, b)."""
    return torch.full((1, 1, 1), float(k), dtype=dtype)


def angle_name(angle_deg: float) -> str:
    """Return an angle as textures are named after it: 045, 37.25 as 037.25."""
    return f"{angle_deg:06.2f}".rstrip("0").rstrip(".")


def checked_angles(where: str, angles_deg: Sequence[float]) -> list[float]:
    """Return angles in radians; raises RangeError unless they ascend from 0 to at most 180 degrees."""
    angles = [float(angle) for angle in angles_deg]
    ascending = all(b - a >= _CLOSEST_DEG - 1e-9 for a, b in zip(angles, angles[1:], strict=False))
    if not angles or angles[0] != 0 or not angles[-1] <= 180 or not ascending:
        requirement = f"ascend from 0 to at most 180 degrees, {_CLOSEST_DEG} apart or more"
        step = "The paper's are 0, 45, 90, 135."
        raise RangeError(message(where, "angles_deg", requirement, f"they are {angles}", step))
    return [math.radians(angle) for angle in angles]


def check_isotropic(where: str, brdf: Any) -> None:
    """Raise RangeError unless `brdf` is isotropic: no pictures of one sphere hold another."""
    if not brdf.isotropic:
        step = "Fit a model that holds anisotropy to the file: torchmat fit microfacet --data FILE."
        raise RangeError(message(where, "the BRDF", "be isotropic", f"{brdf.name} is not", step))


def render_spheres(
    brdf: Any, angles_deg: Sequence[float] = PAPER_ANGLES_DEG, size: int = 512, samples: int = 1
) -> Tensor:
    """Return the pictures [3 n, S, S] of a sphere of `brdf` (any Brdf), lit at `angles_deg` from the view.

    Values are ``pi * f_r * cos(light)``, at the texels' centres or, with `samples` > 1, the mean of samples x samples
    points in each. Texels outside the disc hold what its rim shows, so that filtering near it mixes no black in.
    Raises RangeError for an anisotropic BRDF.
    """
    angles = checked_angles("render_spheres", angles_deg)
    check_isotropic("render_spheres", brdf)
    if size < 1 or samples < 1:
        fact = f"they are {size} and {samples}"
        raise RangeError(message("render_spheres", "size and samples", "be at least 1", fact))
    pictures = []
    with torch.no_grad():
        for angle in angles:
            total = torch.zeros(3, size, size, dtype=brdf.dtype)
            for point in range(samples * samples):
                offset = ((point % samples + 0.5) / samples - 0.5, (point // samples + 0.5) / samples - 0.5)
                total += brdf.shade(*directions_on(sphere_normals(size, brdf.dtype, offset), angle))
            pictures.append(total / samples**2)
    return torch.cat(pictures)
