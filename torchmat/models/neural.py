"""A small latent texture and one network for all texels, in the manner of NeuMIP and NeuBTF.

A multilayer perceptron maps what a texel holds and the directions to a colour (Kuznetsov et al. 2021; Rodriguez-Pardo
et al. 2023). What those papers add - a module that moves the look-up with the view, a pyramid of latent textures, a
network that writes the texture - is left out: this is the plain core of both, for comparison with the other models.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from torchmat.errors import RangeError, ShapeError, message
from torchmat.frames import half_vector
from torchmat.models.base import Material
from torchmat.models.storage import MapSpec
from torchmat.repeatable import wide_product

ANGLES = 8  # numbers that the network is told of light and view
COLUMNS = 32768  # texels x images that go through the network at a time: more leave the processor's cache

Product = Callable[[Tensor, Tensor], Tensor]


def angles(light: Tensor, view: Tensor) -> Tensor:
    """Return what the network is told of directions [..., 3, h, w]: light, view and half x, y, as [..., 8, h, w]."""
    light, view = torch.broadcast_tensors(light, view)
    return torch.cat((light, view, half_vector(light, view)[..., :2, :, :]), dim=-3)


def widths(latent: int, hidden: int, layers: int) -> list[tuple[int, int]]:
    """Return (outputs, inputs) of every layer of the network, without the column of its bias."""
    return [(hidden, latent + ANGLES), *[(hidden, hidden)] * (layers - 1), (3, hidden)]


def root_of_value(latent: Tensor, known: Tensor, layers: Sequence[Tensor], product: Product = wide_product) -> Tensor:
    """Return the network's output [3, images, texels].

    `latent` is [C, texels], `known` [8, images, 1 or texels], each of `layers` [outputs, inputs + 1] with its bias
    last. The first layer is a sum of what it makes of the texel and of the directions: neither is worked out for each pair.
    """
    first = layers[0]
    of_texel = product(first[:, : len(latent)], latent) + first[:, -1:]
    of_angles = product(first[:, len(latent) : -1], known.flatten(1)).unflatten(1, known.shape[1:])
    found = (of_texel[:, None] + of_angles).relu()
    images, texels = found.shape[1:]
    found = found.flatten(1)
    for layer in layers[1:-1]:
        found = (product(layer[:, :-1], found) + layer[:, -1:]).relu()
    return (product(layers[-1][:, :-1], found) + layers[-1][:, -1:]).unflatten(1, (images, texels))


class Neural(Material):
    """A latent texture of `latent` channels; a network of `layers` hidden layers of `hidden` units for all texels.

    Maps: `latent` [latent, H, W], and per layer a table `layer_0` ... [1, outputs, inputs + 1] whose last column is the
    bias. The network sees the texel's latent numbers, light, view and the half vector's x and y; between layers stands
    max(0, x). Its output is the root of the value, so that dark and bright weigh alike in the fit and nothing is
    negative.
    """

    name = "neural"
    unsure = "its numbers mean nothing but to its network"
    bright_at_horizon = True

    def __init__(
        self, maps: Mapping[str, Tensor], *, latent: int = 8, hidden: int = 32, layers: int = 2, **settings: Any
    ) -> None:
        for option, count in (("latent", latent), ("hidden", hidden), ("layers", layers)):
            check_count(self.name, option, count)
        self._widths = widths(latent, hidden, layers)
        super().__init__(maps, latent=latent, hidden=hidden, layers=layers, **settings)
        for number, (outputs, inputs) in enumerate(self._widths):
            shape = tuple(self.maps[f"layer_{number}"].shape)
            if shape != (1, outputs, inputs + 1):
                requirement = f"be [1, {outputs}, {inputs + 1}]"
                raise ShapeError(message(self.name, f"layer_{number}", requirement, f"it is {shape}"), map=f"layer_{number}")

    def own_specs(self) -> tuple[MapSpec, ...]:
        channels = tuple(f"{index:02d}" for index in range(self._widths[0][1] - ANGLES))
        meanings = [f"hidden layer {number + 1}" for number in range(len(self._widths) - 1)] + ["the root of the value"]
        return (
            MapSpec("latent", "what a texel tells the network", layers=channels, layer_channels=1),
            *(
                MapSpec(f"layer_{number}", f"{what}: a row an output, the bias last", layer_channels=1, per_texel=False)
                for number, what in enumerate(meanings)
            ),
        )

    def value(self, light: Tensor, view: Tensor) -> Tensor:
        known = angles(light, view)
        lead = known.shape[:-3]
        known = known.movedim(-3, 0).reshape(ANGLES, -1, known.shape[-2] * known.shape[-1])
        latent = self.maps["latent"].flatten(1)
        layers = [self.maps[f"layer_{number}"][0] for number in range(len(self._widths))]
        parts = known.split(max(1, COLUMNS // latent.shape[1]), dim=1)
        root = torch.cat([root_of_value(latent, part, layers) for part in parts], dim=1)
        return root.clamp(min=0).square().movedim(0, 1).reshape(*lead, 3, *self.size)


def check_count(where: str, name: str, count: object, most: int = 1024) -> None:
    """Raise RangeError unless `count` is a whole number of 1 to `most`."""
    if not isinstance(count, int) or isinstance(count, bool) or not 1 <= count <= most:
        raise RangeError(message(where, name, f"be a whole number of 1 to {most}", f"it is {count!r}"))
