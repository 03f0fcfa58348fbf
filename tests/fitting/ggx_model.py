"""A model from outside the package: isotropic GGX with a Lambert part, as the page "add a model" shows it."""

from __future__ import annotations

import torch
from torch import Tensor

from torchmat import Material, Recipe
from torchmat.fitting.models.streamed import stream_moments
from torchmat.fitting.training import Training
from torchmat.frames import half_vector
from torchmat.models.storage import MapSpec
from torchmat.solvers.least_squares import make_design


class Ggx(Material):
    """``(diffuse + pi D(h) G2 F0 / (4 n.l n.v)) n.l`` with one roughness and one F0 a texel (Walter et al. 2007)."""

    name = "outside_ggx"
    isotropic = reciprocal = True

    def own_specs(self) -> tuple[MapSpec, ...]:
        return (
            MapSpec("diffuse", "diffuse albedo", low=0.0, colour=True),
            MapSpec("reflectance", "F0", layer_channels=1, low=0.0, high=1.0, fixed_range=True),
            MapSpec("roughness", "GGX alpha", layer_channels=1, low=0.02, high=1.0, fixed_range=True),
        )

    def value(self, light: Tensor, view: Tensor) -> Tensor:
        half, squared = half_vector(light, view), self.maps["roughness"] ** 2
        up = half[..., 2:3, :, :] ** 2
        peak = squared / (up * (squared - 1) + 1).square()  # pi D
        l, v = light[..., 2:3, :, :], view[..., 2:3, :, :]
        masking = l * (v * v * (1 - squared) + squared).sqrt() + v * (l * l * (1 - squared) + squared).sqrt()
        return (self.maps["diffuse"] + self.maps["reflectance"] * peak / (2 * masking)) * l


def start_ggx(training: Training, *, roughness: float = 0.3, storage: str = "half") -> Ggx:
    """Begin as Lambert's albedo with a faint highlight.

    Args:
        roughness: GGX alpha to begin with, 0.02 to 1.
    """
    design = make_design(training.light[:, 2, 0].double(), training.used)
    mean = stream_moments(training.btf, design, training.used, training.dtype).product[0] * design.to_coefficients[0, 0].to(training.dtype)
    one = torch.ones_like(mean[:1])
    maps = {"diffuse": 0.8 * mean.clamp(min=1e-4), "reflectance": 0.04 * one, "roughness": roughness * one}
    return Ggx(maps, storage=storage)


RECIPE = Recipe(Ggx, start=start_ggx)
