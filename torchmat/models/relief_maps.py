"""Any flat material on a height map: parallax, self-shadow, and the light that reaches a shadowed texel."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import torch
import torch.nn.functional as functional
from torch import Tensor, nn

from torchmat import safe
from torchmat.geometry.rays import look_up, soft_shadow, texel_centres, trace_view
from torchmat.models.fine_relief import FACTOR, FineRays, fine_rays, refined, seen_along
from torchmat.models.indirect import AMBIENT, BETWEEN_MAPS, INDIRECT, Between, arriving, between, share_of, transfer_of
from torchmat.models.storage import MapSpec
from torchmat.planes import common_lead

# A 16-bit integer spans just the heights that occur; half precision would show as steps in the normals.
HEIGHT = MapSpec("height", "height over the plane of the images, texture widths", layer_channels=1, storage="png16")
RELIEF_MAPS = (HEIGHT, *BETWEEN_MAPS)
# Black where the surface is cut out: a value is the light that a texel sends, and a hole sends none.
OPACITY = MapSpec(
    "opacity", "share of a texel that the surface covers", layer_channels=1, low=0.0, high=1.0, fixed_range=True, fixed=True,
)
COMMON_MAPS = (*RELIEF_MAPS, OPACITY)
FAST, FINE = RELIEFS = ("fast", "fine")  # how a relief is followed
_RAYS = ((-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25), (0.25, 0.25))  # where in a texel its rays start
_FEW = 1024  # places whose rays are walked together: so few take less than the calls


class Rays(NamedTuple):
    """What light and view meet on a height: `shadow` [n, 1, H, W] of each sample, and where its rays end.

    `ends` holds, for each ray that starts in a texel, what is seen in its place, uv [v, 2, H, W] for the distinct views;
    sample i has number `view[i]` among them.
    """

    shadow: Tensor
    ends: list[Tensor]
    view: Tensor


def shade_texels(material, light: Tensor, view: Tensor) -> Tensor:
    """Shade the whole map of a material with a height, as the images of a BTF show it.

    With one light and view per image the surface is shaded texel by texel and then seen along the view's rays: one
    look-up of three channels, whatever the number of maps. Per-texel directions go through `shade_points`.
    """
    height, tiles = material.maps["height"], material.tiles
    if light.shape[-2:] != (1, 1) or view.shape[-2:] != (1, 1):
        return shade_points(material, texel_centres(material.size[0], material.size[1], height.dtype), light, view)
    light, view, lead = _listed(light, view)
    if not len(light):
        return height.new_zeros(*lead, 3, *material.size)
    above = (light[:, 2:] > 0) & (view[:, 2:] > 0)
    light, view = _raised(light, above), _raised(view, above)
    seen = shade_along(material, light, view, rays(height, light, view, tiles, material.relief))
    seen = torch.where(above, seen, torch.zeros((), dtype=seen.dtype))
    return seen.reshape(*lead, *seen.shape[1:])


def shade_under(material, light: Tensor, view: Tensor) -> Tensor:
    """Return what is seen [n, 3, H, W] of a relief whose texels have lights or views [n, 3, H, W] of their own.

    `light` is that of the surface's texels, wherever a view sees them; `view` that through each place of the plane.
    """
    return shade_along(material, light, view, rays(material.maps["height"], light, view, material.tiles, material.relief))


def rays(height: Tensor, light: Tensor, view: Tensor, tiles: bool, relief: str = FAST) -> Rays | FineRays:
    """Return what directions [n, 3, 1, 1] above the horizon meet on `height` [1, H, W]; `relief` is one of RELIEFS.

    Lights and views may be those of each texel, [n, 3, H, W].
    """
    (few_lights, which_light), (few_views, which_view) = _distinct(light), _distinct(view)
    if relief == FINE:
        few_lights, few_views = _between_texels(few_lights), _between_texels(few_views)
        return fine_rays(height, few_lights, which_light, few_views, which_view, tiles)
    shadow = soft_shadow(height, few_lights, tiles=tiles)[which_light]
    return Rays(shadow, _ends(height, few_views, tiles), which_view)


def _ends(height: Tensor, views: Tensor, tiles: bool) -> list[Tensor]:
    """Return where each of the rays of a texel ends, uv [v, 2, H, W], brought back to the texel's centre."""
    rows, columns = height.shape[-2:]
    centres = texel_centres(rows, columns, height.dtype)
    offsets = torch.tensor(_RAYS, dtype=height.dtype)[:, :, None, None] / torch.tensor([columns, rows])[:, None, None]
    if len(views) * rows * columns > _FEW:  # what is walked together is held together
        return [trace_view(height, views, centres + offset, tiles).uv - offset for offset in offsets]
    offsets = offsets[:, None]
    return list(trace_view(height, views, centres + offsets, tiles).uv - offsets)


def _between_texels(direction: Tensor) -> Tensor:
    """Return directions [n, 3, H, W] at FACTOR times their resolution; one for all texels, [n, 3, 1, 1], stays."""
    if direction.shape[-2:] == (1, 1):
        return direction
    return safe.normalise(functional.interpolate(direction, scale_factor=FACTOR, mode="bilinear", align_corners=False))


def shade_along(material, light: Tensor, view: Tensor, met: Rays | FineRays) -> Tensor:
    """Return what is seen [n, 3, H, W] along rays that have been followed: the mean of those of a texel, four in the fast way.

    A pixel is a square, and where a silhouette crosses it, it shows both sides: on deep relief that is 0.5 dB. Each ray
    looks up what it has moved by from the texel's centre, so that without parallax nothing is blurred.
    """
    shaded = material.surface().shade(light, view)
    sent = between(material, light)
    if isinstance(met, FineRays):
        if sent is not None:
            sent = Between(covered(material.maps, sent.value), sent.share)
        return seen_along(covered(material.maps, shaded), sent, met, material.tiles).clamp(min=0)
    shaded = shaded * met.shadow
    if sent is not None:
        shaded = shaded + sent.whole()
    shaded = covered(material.maps, shaded)
    total = torch.zeros((), dtype=shaded.dtype)
    for end in met.ends:
        total = total + look_up(shaded, end[met.view], material.tiles, "bicubic")
    return (total / len(met.ends)).clamp(min=0)


def covered(maps: Mapping[str, Tensor] | nn.ParameterDict, value: Tensor) -> Tensor:
    """Return a value [..., 3, H, W] of a surface as far as it covers its texels: times `opacity`, where there is one."""
    return value * maps["opacity"] if "opacity" in maps else value


def shade_points(material, uv: Tensor, light: Tensor, view: Tensor) -> Tensor:
    """Shade a material with a height where view rays through plane positions `uv` [2, h, w] meet it."""
    light, view, lead = _listed(light, view)
    if not len(light) or not uv.numel():
        return uv.new_zeros(*lead, 3, *uv.shape[-2:])
    pictures = [_shade_picture(material, uv, *pair) for pair in zip(light, view, strict=True)]
    return torch.stack(pictures).reshape(*lead, *pictures[0].shape)


def _shade_picture(material, uv: Tensor, light: Tensor, view: Tensor) -> Tensor:
    height, tiles = material.maps["height"], material.tiles
    above = (light[2:] > 0) & (view[2:] > 0)
    light, view = _raised(light, above), _raised(view, above)
    height = refined(height, tiles) if material.relief == FINE else height
    hit = trace_view(height, view, uv, tiles).uv
    picture = material.surface().at(hit).shade(light, view) * soft_shadow(height, light, uv=hit, tiles=tiles)
    sent = _sent_at(material, light, hit)
    if sent is not None:
        picture = picture + sent
    if "opacity" in material.maps:
        picture = picture * look_up(material.maps["opacity"][None], hit[None], tiles)[0]
    return torch.where(above, picture, torch.zeros((), dtype=picture.dtype))


def _sent_at(material, light: Tensor, hit: Tensor) -> Tensor | None:
    """Return what is sent by way of other texels at places `hit` [2, h, w] under light [3, h, w] or [3, 1, 1]."""

    def at(value: Tensor) -> Tensor:
        return look_up(value[None], hit[None], material.tiles)[0]

    if AMBIENT.name in material.maps:
        share, found = share_of(material.maps, light), at(material.maps[AMBIENT.name])
        return found if share is None else found * share
    if INDIRECT.name not in material.maps:
        return None
    colour = material.maps[INDIRECT.name][:, None, None] * at(material.maps[material.diffuse_map])
    transfer = transfer_of(material)
    return colour * arriving(at(transfer.flatten(0, 1)).unflatten(0, transfer.shape[:2]), light)


def _listed(light: Tensor, view: Tensor) -> tuple[Tensor, Tensor, torch.Size]:
    """Return directions with one leading dimension in common, and the leading shape that they had."""
    lead = common_lead(light, view)
    listed = [d.expand(*lead, *d.shape[-3:]).reshape(-1, *d.shape[-3:]) for d in (light, view)]
    return listed[0], listed[1], lead


def _raised(direction: Tensor, above: Tensor) -> Tensor:
    """Put the pole in place of directions that count for nothing, where everything is finite."""
    pole = torch.zeros(3, 1, 1, dtype=direction.dtype)
    pole[2] = 1
    return torch.where(above, direction, pole)


def _distinct(direction: Tensor) -> tuple[Tensor, Tensor]:
    """Return the distinct ones of directions [n, 3, 1, 1], and which of them each is: rays are walked once for each."""
    count = len(direction)
    if count == 1 or direction.requires_grad or direction.shape[-2:] != (1, 1):
        return direction, torch.arange(count)
    _, which = torch.unique(direction[:, :, 0, 0], dim=0, return_inverse=True)
    first = torch.full((int(which.max()) + 1,), count, dtype=torch.long)
    first.scatter_reduce_(0, which, torch.arange(count), reduce="amin")
    return direction[first], which
