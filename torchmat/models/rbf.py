"""Principal images whose weights are smooth functions of light and view: a spline over the directions.

Relight's default (Ponchio, Corsini, Scopigno 2018, "A compact representation of relightable images for the web"): principal
components of all photographs, and weights that radial basis functions carry from the lights that were measured to those between. We depart
from it in what the functions are of. Directions are unit vectors in space rather than points of the light's disc, on which a degree near the
horizon is nearly nothing: 1.3 dB on a wallpaper. The view is a second vector, and the half vector a third, where highlights are narrow.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from torchmat import frames, safe
from torchmat.errors import RangeError, ShapeError, message
from torchmat.models.angular import pairs
from torchmat.models.base import combine
from torchmat.models.linear import InSpace
from torchmat.models.storage import MapSpec
from torchmat.repeatable import one_thread, wide_product

COORDINATES = 8
TERMS = 1 + COORDINATES  # of the plane: a constant and a slope for each coordinate
_NARROW = 10.0  # of the sine of the half angle: six degrees and less are told apart as they are, more the less the farther
_QUERIES = 4096  # at a time: the table of distances to all knots is the largest tensor


def coordinates(light: Tensor, view: Tensor, half_scale: Tensor) -> Tensor:
    """Return where the spline is asked [q, 8] for unit vectors [q, 3]: light, view, and the half vector's x and y, spread.

    They are ``half_scale * asinh(10 sin) (cos, sin of the azimuth)``: wide around the normal, where highlights of a surface that is
    nearly flat lie, narrow away from it, and smooth everywhere. A `half_scale` [1] of 0 leaves the half vector out.
    """
    half = frames.half_vector(light, view, dim=-1)[:, :2]
    sine = safe.sqrt(half.square().sum(dim=1, keepdim=True))
    far = sine > torch.finfo(sine.dtype).eps
    spread = torch.where(far, torch.asinh(_NARROW * sine) / torch.where(far, sine, 1.0), _NARROW)
    return torch.cat((half_scale * spread * half, light, view), dim=1)


def cubes(points: Tensor, knots: Tensor) -> Tensor:
    """Return the cubed distances [q, n] of points [q, 8] to knots [n, 8]: a spline of theirs has two continuous derivatives."""
    squared = torch.zeros(len(points), len(knots), dtype=points.dtype)
    for axis in range(points.shape[1]):
        # Differences squared, not the expanded form, which cancels.
        squared = squared + (points[:, axis : axis + 1] - knots[:, axis]).square()
    return squared * safe.sqrt(squared)


def plane_terms(points: Tensor) -> Tensor:
    """Return the terms [q, 9] of the plane that a spline bends around: 1, then the coordinates."""
    return torch.cat((torch.ones_like(points[:, :1]), points), dim=1)


class Rbf(InSpace):
    """`components` grey images; each weighs in red, green and blue as a spline over light and view says.

    Tables that all texels share: `knots`, directions with a bend of the spline; `weight`, for each component and colour the coefficients of
    all knots and then of the plane; `reach`, the least and the largest weight, beyond which none goes however far the light is from all that
    was measured; and `half_scale`, how much the half vector counts.
    """

    name = "rbf"

    def __init__(self, maps: Mapping[str, Tensor], *, components: int = 18, **settings: Any) -> None:
        if not isinstance(components, int) or components < 1:
            raise RangeError(message(self.name, "components", "be a whole number of at least 1", f"it is {components!r}"))
        self._components = components
        super().__init__(maps, components=components, **settings)
        for name, columns in (("knots", self.maps["knots"].shape[-1]), ("weight", self.maps["knots"].shape[-1] + TERMS), ("reach", 2)):
            if tuple(self.maps[name].shape[1:]) != (1, columns):
                fact = f"it is {tuple(self.maps[name].shape[1:])} with {self.maps['knots'].shape[-1]} knots"
                raise ShapeError(message(self.name, name, f"have 1 row and {columns} columns", fact), map=name)

    def own_specs(self) -> tuple[MapSpec, ...]:
        layers = tuple(f"{index:03d}" for index in range(self._components))
        channels = 3 * self._components
        return (
            MapSpec("component", "principal image", layers=layers, layer_channels=1, linear=self._is_linear),
            MapSpec(
                "weight", "coefficients of the spline, per component and colour", layer_channels=channels, per_texel=False, storage="float",
            ),
            MapSpec(
                "reach", "least and largest weight, per component and colour", layer_channels=channels, per_texel=False, storage="float",
                fixed=True,
            ),
            MapSpec(
                "knots", "light x, y, z and view x, y, z of each knot", layer_channels=6, low=-1.0, high=1.0, per_texel=False,
                storage="float", fixed=True,
            ),
            MapSpec("half_scale", "how much the half vector counts", layer_channels=1, low=0.0, constant=True, fixed=True),
        )

    def weights(self, light: Tensor, view: Tensor) -> Tensor:
        """Return the weights [q, 3, components] of the components under unit vectors [q, 3]."""
        scale, known = self.maps["half_scale"], self.maps["knots"][:, 0].T
        knots, table = coordinates(known[:, :3], known[:, 3:], scale), self.maps["weight"][:, 0]
        least, most = self.maps["reach"][:, 0].unbind(dim=1)
        found = []
        for light_part, view_part in zip(light.split(_QUERIES), view.split(_QUERIES), strict=True):
            points = coordinates(light_part, view_part, scale)
            terms = torch.cat((cubes(points, knots), plane_terms(points)), dim=1)
            with one_thread():  # a long sum is shared out among threads, and rounds by how many there are
                total = terms @ table.T
            found.append(torch.minimum(torch.maximum(total, least), most))
        return torch.cat(found).unflatten(1, (self._components, 3)).transpose(1, 2)

    def value(self, light: Tensor, view: Tensor) -> Tensor:
        light, view, shape = pairs(light, view)
        weights, component = self.weights(light, view), self.maps["component"]
        if shape[-2:] == (1, 1):
            flat = wide_product(weights.reshape(-1, self._components), component.flatten(1))
            return self._decoded(flat.reshape(*shape[:-2], 3, *component.shape[1:]))
        planes = weights.reshape(*shape, 3, -1).movedim((-2, -1), (-4, -3))  # [..., 3, components, H, W]
        return self._decoded(combine(planes, component[:, None])[..., 0, :, :])
