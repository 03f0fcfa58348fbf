"""A material of which nothing is known but what it shows, sampled over the hemisphere, as a microfacet one."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchmat import safe
from torchmat.frames import tangent_frame
from torchmat.material_io.as_microfacet.directions import measured_pairs
from torchmat.material_io.as_microfacet.error import shade_pairs, thinned
from torchmat.material_io.as_microfacet.lobes import solve_sums
from torchmat.models.base import Material, combine
from torchmat.models.ggx import ggx_share, schlick_rise, squared_alpha, usual_f90
from torchmat.models.microfacet import MICROFACET_PARTS, Microfacet
from torchmat.repeatable import one_thread

_ROUGHNESS = (0.08, 0.12, 0.17, 0.24, 0.32, 0.4, 0.5, 0.62, 0.78, 1.0)
_RATIOS = (1.0, 1.6)
_R0 = (0.03, 0.15, 0.6, 1.0)  # of F90: how much Fresnel lifts a lobe
_TEXELS = 256  # that say which lobe serves all, and what a lobe for each would gain
_PAYS = 0.85  # of the error that is left: a map of roughness, or of normals, must do better
_VALUES = 400_000
_GRAZING = 1e-4


class _Shape(NamedTuple):
    """One lobe: roots of alpha along and across, whether `along` is y, and F0 over F90."""

    along: float
    across: float
    turned: bool
    r0: float


_SHAPES = tuple(
    _Shape(min(1.0, root * ratio**0.5), root / ratio**0.5, turned, r0)
    for root in _ROUGHNESS for ratio in _RATIOS for turned in ((False, True) if ratio > 1 else (False,)) for r0 in _R0
)


def from_samples(material: Material) -> Microfacet:
    """Return the microfacet material nearest to what a flat material shows.

    Diffuse and the lobe's strength are found for each texel in closed form for every lobe of a grid; of those one serves
    all texels, unless one a texel leaves 15 % less error. Normals are those that the light alone says, if they too leave less.
    """
    flat = material.surface()
    light, view = measured_pairs()
    few = thinned(flat, _TEXELS)
    with one_thread():
        tried = []
        for frame in (None, _normals(few, light, view)):
            errors = _errors(few, light, view, frame)
            tried.append((float(errors.sum(dim=1).min()), float(errors.min(dim=0).values.sum()), errors, frame is not None))
        plain, bumpy = tried
        usual, best, errors, bumped = bumpy if bumpy[0] < _PAYS * plain[0] else plain
        shapes = _SHAPES if best < _PAYS * usual else (_SHAPES[int(errors.sum(dim=1).argmin())],)
        normal = _normals(flat, light, view) if bumped else None
        return _made(flat, light, view, shapes, normal)


def _made(flat: Material, light: Tensor, view: Tensor, shapes: tuple[_Shape, ...], normal: Tensor | None) -> Microfacet:
    size, count = flat.size, len(shapes)
    sums = _Sums.of(flat, light, view, shapes, normal)
    strength, diffuse, left = sums.solved()
    which = left.argmin(dim=0, keepdim=True) if count > 1 else torch.zeros(1, *size, dtype=torch.long)
    pick = which[:, None].expand(1, 3, *size)
    diffuse, strength = (value.gather(0, pick)[0].float() for value in (diffuse, strength))
    table = torch.tensor([[s.along, s.across, float(s.turned), s.r0] for s in shapes])[which[0]].movedim(-1, 0)
    f0 = (strength * table[3:4]).contiguous()
    f90 = (strength.mean(dim=0, keepdim=True) / usual_f90(f0).clamp(min=1e-6)).clamp(0, 1)
    maps = {"diffuse": diffuse.contiguous(), "specular_f0": f0, "f90": f90}
    parts = {"f90"} | (set() if normal is None else {"normal"})
    if bool((table[0] != table[1]).any()):
        maps |= {"roughness": table[:2].contiguous(), "rotation": torch.stack((1 - table[2], table[2]))}
        parts |= {"anisotropy"}
    else:
        maps["roughness"] = table[:1].contiguous()
    if normal is not None:
        maps["normal"] = normal.float()
    return Microfacet(maps, parts=[part for part in MICROFACET_PARTS if part in parts])


def _errors(flat: Material, light: Tensor, view: Tensor, normal: Tensor | None) -> Tensor:
    """Return what each shape leaves of the squares of each texel [shape, texel]."""
    return _Sums.of(flat, light, view, _SHAPES, normal).solved()[2].flatten(1)


class _Sums:
    """Normal equations in lobe strength and diffuse of every shape and texel: a, b, c [shape, 1, H, W], p, q [shape, 3, H, W]."""

    def __init__(self, count: int, size: tuple[int, int]) -> None:
        self.a, self.b, self.c = (torch.zeros(count, 1, *size) for _ in range(3))
        self.p, self.q = (torch.zeros(count, 3, *size) for _ in range(2))
        self.energy = torch.zeros(1, 1, *size)

    @classmethod
    def of(cls, flat: Material, light: Tensor, view: Tensor, shapes: tuple[_Shape, ...], normal: Tensor | None) -> _Sums:
        sums = cls(len(shapes), flat.size)
        frame = None if normal is None else torch.stack((*tangent_frame(normal), normal), dim=1)
        for some in torch.arange(len(light)).split(max(1, _VALUES // (3 * flat.texels))):
            target = shade_pairs(flat, light[some], view[some])
            sums._add(target, light[some].float(), view[some].float(), shapes, frame)
        return sums

    def _add(self, target: Tensor, light: Tensor, view: Tensor, shapes: tuple[_Shape, ...], frame: Tensor | None) -> None:
        total = light + view
        rise = schlick_rise((1 - total.norm(dim=1) / 2).clamp(min=0))[:, None, None, None]
        half = total / total.norm(dim=1, keepdim=True)
        local = [direction[:, :, None, None] for direction in (light, view, half)]
        if frame is not None:
            local = [combine(direction, frame) for direction in local]
        cosine = local[0][:, 2:3].clamp(min=0)
        self.energy += target.square().sum(dim=(0, 1))
        second, q = (cosine * cosine).sum(dim=0), (cosine * target).sum(dim=0)
        share, known = cosine, None
        for number, shape in enumerate(shapes):
            key = shape[:3]
            if key != known:
                pair = (shape.across, shape.along) if shape.turned else (shape.along, shape.across)
                squares = squared_alpha(torch.tensor(pair))[:, None, None]
                share, known = ggx_share(local[0], local[1], local[2], squares, _GRAZING), key
            first = share * (shape.r0 + (1 - shape.r0) * rise)
            self.a[number] += (first * first).sum(dim=0)
            self.b[number] += (first * cosine).sum(dim=0)
            self.c[number] += second
            self.p[number] += (first * target).sum(dim=0)
            self.q[number] += q

    def solved(self) -> tuple[Tensor, Tensor, Tensor]:
        """Return strength and diffuse [shape, 3, H, W], neither negative, and the squares left [shape, H, W]."""
        x, y, left = solve_sums(*(value.double() for value in (self.a, self.b, self.c, self.p, self.q)))
        return x, y, (self.energy[:, 0] + left.sum(dim=1)).clamp(min=0)


def _normals(flat: Material, light: Tensor, view: Tensor) -> Tensor:
    """Return normals [3, H, W] of Lambert's law in least squares over the pairs, with z at least half a unit."""
    moment, gram = torch.zeros(3, *flat.size), torch.zeros(3, 3)
    for some in torch.arange(len(light)).split(max(1, _VALUES // (3 * flat.texels))):
        bright = shade_pairs(flat, light[some], view[some]).mean(dim=1)
        rows = light[some].float()
        moment += torch.einsum("nc,nhw->chw", rows, bright)
        gram += rows.T @ rows
    found = torch.einsum("ij,jhw->ihw", torch.linalg.inv(gram.double()).float(), moment)
    found = safe.normalise(found)
    up = torch.tensor([0.0, 0.0, 1.0])[:, None, None]
    return torch.where(found[2:] > 0.5, found, up.expand_as(found)).contiguous()
