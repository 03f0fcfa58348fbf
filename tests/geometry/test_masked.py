"""Relief within an object mask: the mask's border is free, its outside says nothing, and pieces stand by themselves."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tests.support import assert_close, hemisphere

from torchmat.errors import RangeError, ShapeError
from torchmat.geometry import photometric_stereo, poisson, relief_from_photographs
from torchmat.geometry.mask import border, check_mask, flat_outside, pieces


def disk(size: int, radius: float = 0.4, column: float = 0.0) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Coordinates toward +x and +y in texture widths, and which texels lie in the disk."""
    axis = (torch.arange(size, dtype=torch.float64) + 0.5) / size - 0.5
    up, across = torch.meshgrid(-axis, axis, indexing="ij")
    return across, up, (across - column) ** 2 + up**2 < radius**2


def dense(slopes: torch.Tensor, weight: torch.Tensor, inside: torch.Tensor) -> torch.Tensor:
    """Heights of least squares, edge by edge, of mean 0: the equations written out one by one."""
    rows, columns = inside.shape
    number = {place: n for n, place in enumerate(zip(*np.nonzero(inside.numpy()), strict=True))}
    trust = weight / weight[inside].max() + 1e-3
    matrix, right = [], []
    for (i, j), n in number.items():
        for other, axis in (((i, j + 1), 0), ((i - 1, j), 1)):
            if other in number:
                root = min(trust[i, j], trust[other]) ** 0.5
                line = torch.zeros(len(number), dtype=torch.float64)
                line[n], line[number[other]] = -root, root
                matrix.append(line)
                right.append(root * (slopes[axis, i, j] + slopes[(axis, *other)]) / 2 / columns)
    matrix.append(torch.ones(len(number), dtype=torch.float64))
    right.append(torch.zeros((), dtype=torch.float64))
    return torch.linalg.lstsq(torch.stack(matrix), torch.stack(right)[:, None]).solution[:, 0]


def test_two_pieces_by_hand():
    inside = torch.tensor([[1, 1, 0, 1], [0, 1, 0, 1], [0, 0, 1, 0]]).bool()
    assert pieces(inside, tiles=False).tolist() == [0, 0, 1, 0, 1, 2]
    assert pieces(inside, tiles=True).tolist() == [0, 0, 0, 0, 0, 1]  # column 3 goes on in column 0
    assert border(inside, tiles=False).tolist() == inside.tolist()
    assert border(torch.ones(3, 3, dtype=torch.bool), tiles=False).sum() == 0
    hole = torch.ones(5, 5, dtype=torch.bool)
    hole[2, 2] = False
    assert border(hole, tiles=False).nonzero().tolist() == [[1, 2], [2, 1], [2, 3], [3, 2]]
    height = torch.arange(25.0).reshape(5, 5)
    assert flat_outside(height, hole, tiles=False)[2, 2] == 7  # the border's lowest, not the surface's 0


def test_masks_that_are_none_are_refused():
    assert check_mask("here", torch.ones(1, 2, 3, dtype=torch.bool), (2, 3)) is None
    with pytest.raises(ShapeError, match=r"here: mask must be \[2, 3\] as the images are; it is \[3, 2\]"):
        check_mask("here", torch.ones(3, 2, dtype=torch.bool), (2, 3))
    with pytest.raises(RangeError, match="be bool"):
        check_mask("here", torch.ones(2, 3), (2, 3))
    with pytest.raises(RangeError, match="true somewhere"):
        check_mask("here", torch.zeros(2, 3, dtype=torch.bool), (2, 3))


@pytest.mark.parametrize("weighted", [False, True])
def test_heights_inside_are_those_of_the_equations_of_the_inside_alone(weighted):
    random = torch.Generator().manual_seed(1)
    _, _, inside = disk(13)
    slopes = torch.randn(2, 13, 13, generator=random, dtype=torch.float64)
    weight = torch.rand(13, 13, generator=random, dtype=torch.float64) if weighted else torch.ones(13, 13, dtype=torch.float64)
    found = poisson(slopes, weight[None], tiles=False, mask=inside)[0]
    assert_close(found[inside], dense(slopes, weight, inside), 3e-5)
    assert bool((found[~inside] == found[border(inside, False)].min()).all())
    slopes[:, ~inside] = 1e6
    weight[~inside] = 7
    assert torch.equal(poisson(slopes, weight[None], tiles=False, mask=inside)[0], found)


@pytest.mark.parametrize("tiles", [False, True])
def test_pieces_have_a_mean_of_their_own(tiles):
    across, up, left = disk(64, 0.15, -0.25)
    right = disk(64, 0.15, 0.25)[2]
    height = across**2 + up**2
    found = poisson(2 * torch.stack((across, up)), tiles=tiles, mask=left | right)[0]
    for piece in (left, right):
        assert_close(found[piece], height[piece] - height[piece].mean(), 1e-5)


def test_an_anchor_says_how_pieces_stand_to_each_other():
    across, up, left = disk(48, 0.15, -0.25)
    inside = left | disk(48, 0.15, 0.25)[2]
    height = (across**2 + up**2 + 0.3 * (across > 0))[None]
    slopes, weight = 2 * torch.stack((across, up)), torch.full_like(height, 20.0)
    found = poisson(slopes, tiles=False, anchor=torch.where(inside, height, 99.0), anchor_weight=weight, mask=inside)
    assert_close(found[0, inside], height[0, inside], 1e-5)


def sphere_cap(size: int = 64) -> tuple[torch.Tensor, ...]:
    """Images of a matte cap over a dark, noisy table, their lights, the cap's mask and its true height and normal."""
    across, up, inside = disk(size, 0.35)
    rise = torch.sqrt((0.45**2 - across**2 - up**2).clamp(min=1e-4))
    normal = torch.stack((across, up, rise)) / 0.45
    light = torch.from_numpy(hemisphere(((20, 4), (45, 8))))
    shading = torch.einsum("nk,khw->nhw", light, normal).clamp(min=0)
    random = torch.Generator().manual_seed(0)
    table = 0.01 * torch.rand(len(light), size, size, generator=random, dtype=torch.float64)
    images = torch.where(inside, 0.6 * shading, table)[:, None].expand(-1, 3, -1, -1)
    return images, light, inside, rise - rise[inside].mean(), normal


def test_a_cap_with_its_mask_is_at_least_as_true_as_without():
    images, light, inside, height, normal = sphere_cap()
    errors = {}
    for name, mask in (("without", None), ("with", inside)):
        found = relief_from_photographs(images, light, mask=mask)
        inner = found.height[0, inside]
        errors[name] = float((inner - inner.mean() - height[inside]).abs().max()) / float(height[inside].max() - height[inside].min())
        assert_close(found.normal[:, inside], normal[:, inside], 1e-4)
    assert errors["with"] <= errors["without"]
    assert errors["with"] < 1e-3  # measured 0.0005 of the span, without the mask 0.0009
    span = found.height.max() - found.height.min()
    assert float(span) <= 1.005 * float(height[inside].max() - height[inside].min())
    outside = ~inside
    assert bool((found.normal[:, outside] == torch.tensor([0.0, 0.0, 1.0])[:, None]).all())
    assert found.albedo is not None and float(found.albedo[:, outside].abs().max()) == 0
    assert found.confidence is not None and float(found.confidence[:, outside].max()) == 0


def test_what_lies_outside_may_be_anything():
    images, light, inside, _, _ = sphere_cap(24)
    spoilt = torch.where(inside, images, torch.nan)
    weight = torch.ones(len(light), 1, 24, 24, dtype=torch.float64)
    for one, other in zip(photometric_stereo(images, light, weight, inside), photometric_stereo(spoilt, light, weight, inside), strict=True):
        assert torch.equal(one, other)


def test_the_fourier_transform_has_no_masks():
    images, light, inside, _, _ = sphere_cap(16)
    with pytest.raises(RangeError, match="integration must be 'poisson' with an object mask"):
        relief_from_photographs(images, light, integration="fourier", mask=inside)
    whole = torch.ones_like(inside)
    assert torch.equal(
        relief_from_photographs(images, light, integration="fourier", mask=whole).height,
        relief_from_photographs(images, light, integration="fourier").height,
    )
