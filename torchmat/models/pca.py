"""Factorisations of the whole BTF: full-matrix PCA, and PCA per cluster of texels (Müller et al. 2003).

Both reproduce the measured directions better than any parametric model of their size and know nothing in between, so
their angular factors are interpolated (see `angular`). The error on seen and unseen directions is reported apart.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor, nn

from torchmat.errors import RangeError, ShapeError, message
from torchmat.fast import neighbours as fast_neighbours
from torchmat.models.angular import nearby, neighbour_weights, pairs
from torchmat.models.base import Material, combine
from torchmat.models.storage import MapSpec
from torchmat.repeatable import wide_product


def _positive(where: str, name: str, value: int) -> None:
    if not isinstance(value, int) or value < 1:
        raise RangeError(message(where, name, "be a whole number of at least 1", f"it is {value!r}"))


def _check_table(where: str, maps: nn.ParameterDict, name: str, rows: int) -> None:
    """Raise ShapeError unless table `name` has `rows` rows and a column for each measured direction."""
    shape, columns = tuple(maps[name].shape[1:]), maps["directions"].shape[-1]
    if shape != (rows, columns) or maps["directions"].shape[1] != 1:
        fact = f"it is {shape} and directions are {tuple(maps['directions'].shape[1:])}"
        raise ShapeError(message(where, name, f"have {rows} rows and a column per row of directions", fact))


def _directions_spec() -> MapSpec:
    return MapSpec(
        "directions", "projected light x, y and view x, y of each measured sample", layer_channels=4,
        low=-1.0, high=1.0, per_texel=False, storage="float", fixed=True,
    )


class Pca(Material):
    """Principal components of the matrix of images: `components` RGB textures and a weight for each direction."""

    name = "pca"
    bright_at_horizon = True

    def __init__(self, maps: Mapping[str, Tensor], *, components: int = 16, **settings: Any) -> None:
        _positive(self.name, "components", components)
        self._components = components
        super().__init__(maps, components=components, **settings)
        _check_table(self.name, self.maps, "weight", 1)

    def own_specs(self) -> tuple[MapSpec, ...]:
        layers = tuple(f"{index:03d}" for index in range(self._components))
        return (
            MapSpec("component", "principal image, RGB", layers=layers, linear=True),
            MapSpec("weight", "weight of each component at each sample", layer_channels=self._components, per_texel=False),
            _directions_spec(),
        )

    def value(self, light: Tensor, view: Tensor) -> Tensor:
        light, view, shape = pairs(light, view)
        index, share = neighbour_weights(self.maps["directions"][:, 0].T, light, view)
        factors = (self.maps["weight"][:, 0].T[index] * share[..., None]).sum(dim=1)
        weights = factors.reshape(*shape, -1).movedim(-1, -3)
        return combine(weights, self.maps["component"].unflatten(0, (-1, 3)))

    def in_one_pass(self, light: Tensor, view: Tensor) -> Tensor | None:
        maps = self.maps
        found = nearby(maps["directions"][:, 0].T, *pairs(light, view)[:2])
        return None if found is None else fast_neighbours.components(light, view, *found, maps["weight"][:, 0].T, maps["component"])


class LocalPca(Material):
    """PCA of the texels' reflectance within each of `clusters`: an index and `components` weights a texel.

    The tables that all texels share hold, for each cluster, a mean and the components at each measured sample, RGB.
    """

    name = "local_pca"
    bright_at_horizon = True

    def __init__(
        self, maps: Mapping[str, Tensor], *, clusters: int = 8, components: int = 8, **settings: Any
    ) -> None:
        _positive(self.name, "clusters", clusters)
        _positive(self.name, "components", components)
        if clusters > 256:
            raise RangeError(message(self.name, "clusters", "be at most 256", f"it is {clusters}"))
        self._clusters, self._components = clusters, components
        super().__init__(maps, clusters=clusters, components=components, **settings)
        _check_table(self.name, self.maps, "reflectance", clusters)

    def own_specs(self) -> tuple[MapSpec, ...]:
        layers = tuple(f"{index:02d}" for index in range(self._components))
        tables = ("mean", *layers)
        return (
            MapSpec("cluster", "number of the cluster", layer_channels=1, low=0.0, high=self._clusters - 1.0, index=True),
            MapSpec("weight", "weight of each component", layers=layers, layer_channels=1, linear=True),
            # [3 (1 + components), clusters, samples]
            MapSpec("reflectance", "per cluster (row) and sample (column), RGB", layers=tables, per_texel=False),
            _directions_spec(),
        )

    def value(self, light: Tensor, view: Tensor) -> Tensor:
        height, width = self.size
        per_image = light.shape[-2:] == (1, 1) and view.shape[-2:] == (1, 1)
        light, view, shape = pairs(light, view)
        index, share = neighbour_weights(self.maps["directions"][:, 0].T, light, view)
        images = len(light) if per_image else len(light) // (height * width)
        cluster = self.maps["cluster"][0].round().long().reshape(-1)
        weight = self.maps["weight"].reshape(self._components, -1)
        weight = torch.cat((torch.ones_like(weight[:1]), weight))
        table = self.maps["reflectance"].unflatten(0, (-1, 3))  # [1 + components, 3, clusters, samples]
        out = torch.zeros(images, 3, height * width, dtype=weight.dtype)
        for number in range(self._clusters):
            texels = (cluster == number).nonzero()[:, 0]
            known = table[:, :, number].flatten(0, 1).T  # [samples, 3 (1 + components)]
            if per_image:
                curves = (known[index] * share[..., None]).sum(dim=1).unflatten(1, (-1, 3))
                flat = wide_product(curves.transpose(1, 2).flatten(0, 1), weight[:, texels])
                out[:, :, texels] = flat.unflatten(0, (images, 3))
                continue
            rows = (torch.arange(images)[:, None] * height * width + texels).reshape(-1)
            curves = (known[index[rows]] * share[rows, :, None]).sum(dim=1).unflatten(1, (-1, 3))
            curves = curves.unflatten(0, (images, len(texels)))
            out[:, :, texels] = torch.einsum("itjc,jt->ict", curves, weight[:, texels])
        lead = shape[:-2]
        return out.reshape(*lead, 3, height, width)
