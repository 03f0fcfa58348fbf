"""PBR texture sets and pictures as microfacet materials, whose maps are what the textures are."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import torch
from torch import Tensor

from torchmat import colour
from torchmat.create.controls import brightness_contrast, check_picture, darkened
from torchmat.create.from_picture import black_to_white
from torchmat.create.from_textures import filled, repeats, shape_of, with_occlusion
from torchmat.create.textures import find_textures, read_textures
from torchmat.errors import RangeError, message
from torchmat.geometry import relief_from_picture
from torchmat.geometry.tiling import AUTO_TILES
from torchmat.models.microfacet import Microfacet
from torchmat.models.renderers import DIELECTRIC, from_metalness

_ROUGHNESS = 0.5  # of what says nothing of it


def microfacet_from_textures(
    folder: str | Path, *, height_scale: float | None = None, occlusion: bool = False, tiles: bool | str = AUTO_TILES,
    storage: str = "paint8", say: Callable[[str], None] | None = None,
) -> Microfacet:
    """Return the microfacet material of a folder of textures, named as vendors name them (see `find_textures`).

    Roughness is the texture's own; diffuse and F0 are base colour and metalness, `from_metalness`: what is no metal has F0
    0.04, or that of a specular texture. Without a roughness, a metal, or what has a specular texture, has 0.5; anything else
    has no specular part. Height, normal, opacity and occlusion are as in `material_from_textures`. `say` is called with a
    line for each thing that the files do not state. Raises DataError, ShapeError or RangeError naming the file.
    """
    say = say or (lambda line: None)
    textures = filled(read_textures(find_textures(folder)))
    tiles, told = repeats("microfacet_from_textures", textures["color"], tiles)
    base, metal, given = textures["color"], textures.get("metalness"), textures.get("f0")
    none = torch.zeros_like(base[:1])
    diffuse, f0 = from_metalness(base, none if metal is None else metal)
    if metal is None and given is not None:
        f0 = given.expand(3, -1, -1)
    rough, known = textures.get("roughness"), metal is not None or given is not None
    if rough is None:
        say(f"roughness: no file gives it; {_ROUGHNESS if known else 'nothing specular'} is taken")
        rough, f0 = none + (_ROUGHNESS if known else 1.0), f0 if known else torch.zeros_like(f0)
    maps = {
        "diffuse": with_occlusion(folder, diffuse, textures) if occlusion else diffuse, "specular_f0": f0.contiguous(),
        "roughness": rough,
    }
    shape, stored = shape_of(folder, textures, height_scale, tiles, say)
    for line in told:
        say(line)
    maps |= shape | ({"opacity": textures["opacity"]} if "opacity" in textures else {})
    return Microfacet(maps, parts=["normal"] if "normal" in maps else [], tiles=tiles, storage=storage, stored=stored)


def microfacet_from_picture(
    picture: Tensor, *, roughness: float = _ROUGHNESS, fresnel_brightness: float | None = None, fresnel_contrast: float = 0.1,
    darken: float = 0.2, height_scale: float = 0.05, tiles: bool = False, storage: str = "paint8",
) -> Microfacet:
    """Return the microfacet material of a picture [3, H, W] of an evenly lit surface, in linear light.

    Diffuse is the picture less the share `darken`, the height its brightness (`height_scale` texture widths from black to
    white; 0 for a flat surface). `roughness` is one for all, 0 to 1. F0 is 0.04, or with a `fresnel_brightness` the picture's
    luminance with that brightness and contrast. Raises RangeError or ShapeError, naming what does not fit.
    """
    where = "microfacet_from_picture"
    check_picture(where, picture)
    if not 0 <= roughness <= 1:
        raise RangeError(message(where, "roughness", "lie in [0, 1]", f"it is {roughness}"))
    picture = picture.detach().float()
    grey = colour.luminance(picture)[None]
    f0 = torch.full_like(grey, DIELECTRIC)
    if fresnel_brightness is not None:
        f0 = brightness_contrast(grey, fresnel_brightness, fresnel_contrast)
    maps = {
        "diffuse": darkened(picture, darken), "specular_f0": f0.repeat(3, 1, 1), "roughness": torch.full_like(grey, roughness),
    }
    stored = {}
    if height_scale != 0:
        seen = colour.display(picture)
        maps["height"] = relief_from_picture(seen, height_scale, tiles=tiles).height
        stored["height"] = black_to_white(colour.luminance(seen), height_scale)
    return Microfacet(maps, tiles=tiles, storage=storage, stored=stored)
