"""A scene: camera, object and lights, of which pictures are made and which says what it uses of a material."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from torchmat import colour
from torchmat.errors import RangeError, message
from torchmat.rendering.as_mesh import as_mesh
from torchmat.rendering.camera import Camera
from torchmat.rendering.lights import DEFAULT_LIGHT, Light, as_light, unit
from torchmat.rendering.mesh import Mesh
from torchmat.rendering.mipmap import Pyramid, Shader
from torchmat.rendering.objects import check_lights, reach, shade_visible
from torchmat.rendering.visibility import Visible, picture_size, see
from torchmat.scene_use import SceneUse

if TYPE_CHECKING:
    import trimesh

PATCH = "patch"
FRONT = (0.0, 0.0, 1.0)
MOST_PAIRS = 4_000_000  # of point and light; of more each light keeps every second, third ...


@dataclass(frozen=True, eq=False)
class Scene:
    """One picture's camera, object and lights; `render(material, scene)` is that picture.

    All is checked once; what the camera sees is found once, when it is first needed.

    Args:
        mesh: "quad", "cube", "sphere", "torus", "teapot", a file that trimesh reads, or a Mesh; a "patch" is no object.
        lights: Directional, Point, or x, y, z of a distant one; they add up.
        camera: None for a far one that frames the object from `view`.
        view: direction from the object to that camera, x, y, z.
        size: (rows, columns) of the picture, or one number for both.
        repeat: factor on the texture coordinates, above 0.
        shadows: whether parts of the object hide others from the light.
        rays: 1, 4, 9 or 16 through a pixel.
        edges_only: whether pixels whose neighbours show the same get only one ray.

    Raises RangeError, ShapeError or DataError as `render` does.
    """

    mesh: str | Path | Mesh | trimesh.Trimesh
    lights: Sequence[Light | Sequence[float]] = (DEFAULT_LIGHT,)
    camera: Camera | None = None
    view: Sequence[float] = FRONT
    size: int | tuple[int, int] = 512
    repeat: float = 1.0
    shadows: bool = False
    rays: int = 4
    edges_only: bool = False
    _seen: dict[torch.dtype, Visible] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        picture_size(self.size, self.repeat, self.rays)
        unit("render", "view", self.view)
        if isinstance(self.mesh, str) and self.mesh == PATCH:
            step = 'Use "quad", the same flat sample as an object.'
            raise RangeError(message("Scene", "mesh", "be an object", "a patch has no camera", step))
        mesh = as_mesh(self.mesh)
        for name, value in (
            ("mesh", mesh), ("lights", tuple(map(as_light, self.lights))),
            ("camera", self.camera or Camera.framing(mesh.centre, mesh.radius, self.view)),
        ):
            object.__setattr__(self, name, value)
        check_lights(mesh, self._lights)

    @property
    def _lights(self) -> list[Light]:
        return [as_light(light) for light in self.lights]

    def visible(self, dtype: torch.dtype = torch.float32) -> Visible:
        """Return what the camera sees, in the precision of the material that is to be shaded."""
        if dtype not in self._seen:
            assert self.camera is not None
            self._seen[dtype] = see(as_mesh(self.mesh), self.camera, self.size, self.rays, self.edges_only, self.repeat, dtype)
        return self._seen[dtype]

    def picture(self, material: Shader | Pyramid, gradient: bool = False) -> Tensor:
        """Return the linear picture [3, rows, columns] of a material in this scene; with `gradient`, one in its maps."""
        return shade_visible(material, self.visible(material.dtype), self._lights, self.shadows, gradient, soften=True)

    def use(self) -> SceneUse:
        """Return what the scene uses of a material: the points that are seen and lit, and how much they count.

        Raises RangeError for a scene that sees no texel, saying what is missing.
        """
        return self._use

    @cached_property
    def _use(self) -> SceneUse:
        visible = self.visible()
        if not bool((visible.view[2] > 0).any()):
            fact = "it sees none" if not len(visible.pixel) else "it sees the back of its surface alone"
            step = "Move the camera, or leave it out: then it frames the object."
            raise RangeError(message("Scene", "the camera", "see the object", fact, step))
        spacing = max(1, -(-len(visible.pixel) * len(self.lights) // MOST_PAIRS))
        lit = torch.zeros(len(visible.pixel), dtype=torch.bool)
        parts = []
        for number, lamp in enumerate(self._lights):
            local, intensity, reached = reach(visible, lamp, self.shadows)
            strength = colour.luminance(intensity, dim=0)[0].expand(len(visible.pixel))
            lit |= reached & (strength > 0)
            chosen = (reached & (strength > 0)).nonzero()[number % spacing :: spacing, 0]
            weight = visible.weight[chosen] * strength[chosen] * spacing
            parts.append((chosen, local[:, 0, chosen], visible.view[:, 0, chosen], weight))
        kept = lit.nonzero()[:, 0]
        if not len(kept):
            fact = f"none of {len(self.lights)} lights does" if self.lights else "there is no light"
            advice = "Turn a light toward the side that the camera sees, or leave shadows out."
            raise RangeError(message("Scene", "a light", "reach what the camera sees", fact, advice))
        point, light, view, weight = (torch.cat(planes, dim=-1) for planes in zip(*parts, strict=True))
        place = lit.long().cumsum(0) - 1
        return SceneUse(visible.uv[:, 0, kept], visible.footprint[kept], place[point], light, view, weight)
