"""render: a material, a shape, lights and a camera in, a linear picture out."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from torchmat.errors import RangeError, message
from torchmat.rendering.camera import Camera
from torchmat.rendering.lights import DEFAULT_LIGHT, Directional, Light, as_light, unit
from torchmat.rendering.mesh import Mesh
from torchmat.rendering.mipmap import Pyramid, Shader
from torchmat.rendering.scene import FRONT, PATCH, Scene
from torchmat.rendering.visibility import picture_size

if TYPE_CHECKING:
    import trimesh

_ONE_LIGHT = (DEFAULT_LIGHT,)


def render(
    material: Shader | Pyramid, mesh: str | Path | Mesh | trimesh.Trimesh | Scene = "sphere",
    lights: Sequence[Light | Sequence[float]] = _ONE_LIGHT, view: Sequence[float] = FRONT,
    size: int | tuple[int, int] = 512, repeat: float = 1.0, *, camera: Camera | None = None, shadows: bool = False,
    rays: int = 4, edges_only: bool = False, gradient: bool = False,
) -> Tensor:
    """Return a linear picture [3, rows, columns] of a material on an object.

    Directions and places are in the scene's frame: x right, y up, z toward the default camera; of a patch in its tangent
    frame. To light one view again and again, use `see` and `shade_visible`. On objects, models that know nothing of light
    flatter than they were fitted to (polynomials, harmonics, PCA) fade over the last 10 degrees before it sets.

    Args:
        material: a Material, a Brdf, a RawBtf, or a `Pyramid` of one, which keeps its smaller copies from picture to picture.
        mesh: "patch" (the flat sample filling the picture, texels as high as wide), "quad", "cube", "sphere", "torus",
            "teapot", a file (OBJ, glTF, PLY, STL, OFF), a Mesh, or a Scene, which holds all that follows and keeps what its
            camera sees.
        lights: Directional, Point, or x, y, z of a distant one; they add up.
        view: direction from the object to a far camera that frames it, x, y, z, unless `camera` is given.
        size: (rows, columns) of the picture, or one number for both; of a patch the columns.
        repeat: factor on the texture coordinates, above 0.
        camera: a Camera; None for the far one.
        shadows: whether parts of the object hide others from the light.
        rays: 1, 4, 9 or 16 through a pixel.
        edges_only: whether pixels whose neighbours show the same get only one ray.
        gradient: whether the picture has a gradient in the material's maps, for a loss over pictures; what is seen of the
            object has none.

    Raises RangeError for what lies outside, ShapeError for directions that are not x, y, z, DataError for a bad mesh.
    """
    if isinstance(mesh, Scene):
        alone = lights is _ONE_LIGHT and view is FRONT and camera is None
        if not alone or (size, repeat, shadows, rays, edges_only) != (512, 1.0, False, 4, False):
            fact = "lights, camera or sizes are given beside it"
            raise RangeError(message("render", "a Scene", "come alone", fact, "Give them to the Scene."))
        return mesh.picture(_checked(material), gradient)
    picture_size(size, repeat, rays)
    _checked(material)
    if isinstance(mesh, str) and mesh == PATCH:
        lamps = [as_light(light) for light in lights]
        return _patch(material, lamps, unit("render", "view", view, material.dtype), size, repeat, gradient)
    return Scene(mesh, lights, camera, view, size, repeat, shadows, rays, edges_only).picture(material, gradient)


def _checked(material: Shader | Pyramid) -> Shader | Pyramid:
    """Return the material if it can be rendered; raises RangeError."""
    if not isinstance(material, Pyramid) and not hasattr(material, "shade_at"):
        step = "Use load_material, load_brdf, or RawBtf(btf)."
        fact = f"it is a {type(material).__name__}"
        raise RangeError(message("render", "material", "be a Material, a Brdf or a RawBtf", fact, step))
    return material


def _patch(
    material: Shader | Pyramid, lights: list[Light], view: Tensor, size: int | tuple[int, int], repeat: float, gradient: bool
) -> Tensor:
    if not isinstance(size, int):
        raise RangeError(message("render", "size of a patch", "be its columns", f"it is {size}", "Its rows follow."))
    pyramid = material if isinstance(material, Pyramid) else Pyramid(material, gradient)
    height, width = pyramid.size
    rows = max(1, round(size * height / width))
    u = (torch.arange(size, dtype=view.dtype) + 0.5) / size * repeat
    v = (1 - (torch.arange(rows, dtype=view.dtype) + 0.5) / rows) * repeat
    uv = torch.stack(torch.meshgrid(v, u, indexing="ij")[::-1])
    picture = torch.zeros(3, rows, size, dtype=view.dtype)
    with torch.set_grad_enabled(gradient):
        # Texels are as high as wide here, so across and down a pixel covers the same number of them.
        covered = repeat / size * width / max(height, width)
        parts = pyramid.parts(torch.full((1,), covered, dtype=view.dtype))
        for light in lights:
            if not isinstance(light, Directional):
                step = "Render mesh='quad' to light the sample from near by."
                raise RangeError(message("render", "the lights of a patch", "be directional", f"one is {light}", step))
            direction, intensity, _ = light.reach(uv[:, None])
            for shader, _, weight in parts:
                shaded = intensity * shader.shade_at(uv, direction, view[:, None, None])
                picture = picture + (shaded if weight is None else shaded * weight)
    return picture
