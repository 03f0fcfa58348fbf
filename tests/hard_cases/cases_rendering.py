"""Hard cases of the renderer: every shape that it makes, with every registered model on it where that matters."""

from __future__ import annotations

import math
from collections.abc import Iterator

import pytest
import torch
from tests.brdf.directions import graze
from tests.hard_cases.cases_shading import FULL, bumps
from tests.hard_cases.components import Component, Room, models
from tests.models.examples import make, make_maps, specs_of
from tests.rendering.mesh_files import assert_frames_hold
from torch import Tensor

from torchmat import Material, RangeError, ShapeError, render
from torchmat.models import MATERIALS
from torchmat.rendering.scene import PATCH
from torchmat.rendering.shapes import make_mesh

OBLIQUE = (0.5, 0.3, 0.8)


def is_object(component: Component) -> bool:
    """Return whether a shape has a mesh."""
    return component.given != PATCH


def one_of_each() -> Iterator[tuple[str, dict]]:
    """Yield every registered model in the last, richest variant of its examples."""
    richest = {component.given[0]: component.given for component in models()}
    yield from richest.values()


def pictured(material: Material, shape: str, lights, size=12, **settings) -> Tensor:
    """Render; assert that the picture is finite and not negative; return it."""
    picture = render(material, shape, lights, size=size, **{"rays": 1, **settings})
    assert bool(torch.isfinite(picture).all()), "the picture is not finite"
    assert float(picture.min()) >= 0, "the picture is negative"
    return picture


def every_model(shape: str, lights, **settings) -> None:
    """Render every model, all maps at random."""
    for name, options in one_of_each():
        pictured(make(name, options, 6, 5, torch.float32), shape, lights, **settings)


def along_and_against(shape: str, room: Room) -> None:
    """Case 1: light along the view, against it, at the horizon and below; what faces away is black."""
    every_model(shape, [(0.0, 0.0, 1.0), graze(0.4, 1e-4), graze(2.0, -0.5), (0.0, 0.0, -1.0)])
    if shape in (PATCH, "quad"):
        assert not bool(pictured(make("texture", {}, 6, 5, torch.float32), shape, [(0.0, 0.0, -1.0)]).any())


def grazing(shape: str, room: Room) -> None:
    """Case 2: light and view in the plane of the sample, and lights at right angles to the view of an object."""
    every_model(shape, [(1.0, 0.0, 0.0), (0.0, 1.0, 1e-7), graze(2.0, 1e-12)])
    every_model(shape, [graze(0.3, 1e-4)], view=graze(0.5, 1e-4))


def frames_hold(shape: str, room: Room) -> None:
    """Case 3: normals, tangents and texture coordinates of the mesh."""
    assert_frames_hold(make_mesh(shape))


def wrapping_light(shape: str, room: Room) -> float:
    """Case 5: lights on either side of azimuth pi give one picture; returns the largest difference."""
    worst = 0.0
    for name, options in one_of_each():
        material = make(name, options, 6, 5, torch.float32)
        one, other = (pictured(material, shape, [graze(a, 0.6)]) for a in (math.pi - 1e-9, -math.pi + 1e-9))
        worst = max(worst, float((one - other).abs().max()))
    assert worst < 1e-5
    return worst


def maps_at_bounds(shape: str, room: Room) -> None:
    """Case 7: every map at either end of its range, or at 0 and 1e4 where it has none."""
    for name, options in one_of_each():
        for end, free in (("low", 0.0), ("high", 1e4)):
            maps = make_maps(name, options, 3, 4, torch.float32)
            for spec in specs_of(name, options):
                bound = getattr(spec, end)
                if bound is not None or (spec.per_texel and not spec.constant and spec.high is None):
                    maps[spec.name] = torch.full_like(maps[spec.name], free if bound is None else bound)
            pictured(MATERIALS[name](maps, **options), shape, [OBLIQUE])


def dark_beside_bright(shape: str, room: Room) -> None:
    """Case 8: a texel of 1e4 among others of 1e-8, filtered together."""
    albedo = torch.full((3, 8, 8), 1e-8)
    albedo[:, 3, 4] = 1e4
    picture = pictured(make("texture", {}, 8, 8, torch.float32).with_maps(albedo=albedo), shape, [(0.0, 0.0, 1.0)], size=64)
    lit = picture[picture > 0]
    assert float(lit.max()) > 1e2 and float(lit.min()) < 1e-7, "one of the two is lost"


def black(shape: str, room: Room) -> None:
    """Case 9: a black material is exactly black."""
    material = make("texture", {}, 4, 4, torch.float32).with_maps(albedo=torch.zeros(3, 4, 4))
    assert not bool(pictured(material, shape, [OBLIQUE]).any())


def sizes(shape: str, room: Room) -> None:
    """Case 10: pictures and materials of all shapes."""
    plain = make("texture", {}, 6, 5, torch.float32)
    for size in (1, 7, 33) if shape == PATCH else ((1, 1), (1, 7), (7, 1), (33, 20)):
        found = pictured(plain, shape, [OBLIQUE], size=size).shape
        assert found[-1] == size if isinstance(size, int) else found == (3, *size)
    for texels in ((1, 1), (1, 7), (7, 1), (5, 3), (1, 4096)):
        pictured(make("texture", {}, *texels, torch.float32), shape, [OBLIQUE], size=16 if texels[1] < 4096 else 64)


def refused(shape: str, room: Room) -> None:
    """Case 11: lights that are no directions, sizes that are none, and what is no material."""
    plain = make("texture", {}, 6, 5, torch.float32)
    for light, error in (((math.nan, 0, 1), RangeError), ((0, 0, 0), RangeError), ((0, 1), ShapeError)):
        with pytest.raises(error, match="light"):
            render(plain, shape, [light], size=8)
    with pytest.raises(RangeError, match="size"):
        render(plain, shape, [OBLIQUE], size=0)
    with pytest.raises(RangeError, match="material must be"):
        render("plain", shape, [OBLIQUE], size=8)
    with pytest.raises(RangeError, match="view"):
        render(plain, shape, [OBLIQUE], view=(math.inf, 0, 0), size=8)


def deep_relief(shape: str, room: Room) -> None:
    """Case 12: a deep relief and one with a step of the full range, seen and lit at 75 degrees."""
    step = torch.zeros(1, 12, 16)
    step[..., 6:9] = 0.4
    for height in (bumps(12, 16, 0.4, torch.float32), step):
        for name in ("texture", "distribution"):
            options = dict(one_of_each())[name]
            material = make(name, options, 12, 16, torch.float32).on_relief(height, torch.full((3, 12, 16), 0.05))
            pictured(material, shape, [graze(0.4, 0.2588)], view=graze(2.0, 0.2588))


def precision(shape: str, room: Room) -> float:
    """Case 13: returns the digits of the picture that float32 keeps of float64, over all pixels together."""
    least = FULL
    for name, options in one_of_each():
        single = make(name, options, 6, 5, torch.float32)
        double = single.with_maps(**{key: value.detach().double() for key, value in single.maps.items()})
        found, wanted = (pictured(one, shape, [OBLIQUE]).double() for one in (single, double))
        error = float(((found - wanted).square().sum() / wanted.square().sum()).sqrt())
        least = min(least, -math.log10(max(error, 1e-8)))
    assert least > 3
    return least


def same_bits(shape: str, room: Room) -> None:
    """Case 15: the same picture again, with one thread and with two."""
    before = torch.get_num_threads()
    for name, options in one_of_each():
        if not room.thorough and name not in ("texture", "distribution"):
            continue
        found = []
        try:
            for threads in (1, 2):
                torch.set_num_threads(threads)
                found.append(pictured(make(name, options, 6, 5, torch.float32), shape, [OBLIQUE], size=24))
        finally:
            torch.set_num_threads(before)
        assert torch.equal(*found), f"{name}: another number of threads, other bits"


def after_export(shape: str, room: Room) -> float:
    """Case 17: returns the relative error of pictures that storing every model in 8 bits makes, the largest of all."""
    worst = 0.0
    for name, options in one_of_each():
        material = make(name, options, 6, 5, torch.float32, storage="png8")
        wanted, found = (pictured(one, shape, [OBLIQUE]) for one in (material, material.as_exported()))
        worst = max(worst, float((found - wanted).square().sum() / wanted.square().sum()))
    assert worst < 1e-3
    return worst
