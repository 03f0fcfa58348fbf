"""Light between texels: a map that falls with the light, and the radiosity of the relief."""

from __future__ import annotations

import math

import pytest
import torch
from tests.support import assert_close

import torchmat as tm
from torchmat import RangeError
from torchmat.geometry.form_factors import form_factors
from torchmat.geometry.normals import normals_from_slopes, slopes_from_height
from torchmat.geometry.rays import soft_shadow
from torchmat.models import Lambert, Texture, indirect
from torchmat.models.blend import blend

SIZE = 24
LIGHT = torch.tensor([[0.3, -0.2, 0.93], [-0.6, 0.3, 0.74], [0.1, 0.9, 0.42]], dtype=torch.float64)
LIGHT = (LIGHT / LIGHT.norm(dim=1, keepdim=True))[:, :, None, None]
VIEW = torch.tensor([0.2, 0.1, 0.97], dtype=torch.float64)[:, None, None] / math.sqrt(0.9909)


def relief(deep: float = 0.15) -> torch.Tensor:
    generator = torch.Generator().manual_seed(2)
    coarse = torch.rand(1, 1, 6, 6, generator=generator, dtype=torch.float64)
    return deep * torch.nn.functional.interpolate(coarse, size=(SIZE, SIZE), mode="bicubic")[0]


def normals() -> torch.Tensor:
    return normals_from_slopes(slopes_from_height(relief()))


def colours() -> torch.Tensor:
    generator = torch.Generator().manual_seed(3)
    return 0.2 + 0.7 * torch.rand(3, SIZE, SIZE, generator=generator, dtype=torch.float64)


def lambert(**parts: torch.Tensor) -> Lambert:
    return Lambert({"albedo": colours(), "normal": normals(), "height": relief(), **parts})


def two_bounces(light: torch.Tensor) -> torch.Tensor:
    """Return what arrives at each texel [3, H, W], by dense sums over the bounces."""
    height, white = relief(), colours().flatten(1)
    factors = form_factors(height).to_dense()
    cosine = (normals() * light).sum(dim=0).clamp(min=0)
    sent = white * (soft_shadow(height, light[None])[0, 0] * cosine).flatten()
    first = sent @ factors.T
    return (first + (white * first) @ factors.T).reshape(3, SIZE, SIZE)


def test_harmonics_hold_what_two_bounces_bring():
    transfer = indirect.transfer(relief(), colours(), True)
    for light in LIGHT:
        expected = two_bounces(light)
        found = indirect.arriving(transfer, light[None])[0]
        # Nine harmonics of 48 lights: measured 0.02 of the square at worst.
        assert float((found - expected).square().sum() / expected.square().sum()) < 0.05


def test_radiosity_adds_the_colour_times_what_arrives():
    plain, lit = lambert().with_relief("fast"), lambert(indirect=torch.tensor([1.5], dtype=torch.float64))
    transfer = indirect.transfer(relief(), colours(), True)
    straight = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)[:, None, None]
    gap = lit.shade(LIGHT, straight) - plain.shade(LIGHT, straight)
    expected = 1.5 * colours() * indirect.arriving(transfer, LIGHT)
    assert_close(gap.mean(dim=(-1, -2)), expected.mean(dim=(-1, -2)), 2e-2)  # bicubic look-ups within a texel
    assert float(expected.mean()) > 1e-3


@pytest.mark.parametrize("way", ["fast", "fine"])
@pytest.mark.parametrize("parts", [
    {"indirect": torch.tensor([1.2], dtype=torch.float64)},
    {"ambient": 0.1 * colours(), "ambient_falloff": torch.tensor([0.4], dtype=torch.float64)},
])
def test_a_light_for_each_pixel_gives_what_one_for_all_gives(parts, way):
    material = lambert(**parts).with_relief(way)
    material, bare = material.requires_grad_(False), lambert().with_relief(way).requires_grad_(False)
    one = material.shade(LIGHT[0], VIEW)
    each = material.shade(LIGHT[0].expand(3, SIZE, SIZE).contiguous(), VIEW.expand(3, SIZE, SIZE).contiguous())
    # One ray a pixel beside four: as without light between texels.
    usual = bare.shade(LIGHT[0], VIEW) - bare.shade(LIGHT[0].expand(3, SIZE, SIZE).contiguous(), VIEW.expand(3, SIZE, SIZE).contiguous())
    assert float((one - each - usual).abs().mean()) < 0.15 * float((one - bare.shade(LIGHT[0], VIEW)).abs().mean())


def test_an_ambient_map_falls_with_the_lights_cosine_as_far_as_it_says():
    share = torch.tensor([0.4], dtype=torch.float64)
    ambient, dark = 0.1 * colours(), {"albedo": torch.zeros_like(colours())}
    constant = lambert(ambient=ambient).with_maps(**dark)
    falling = lambert(ambient=ambient, ambient_falloff=share).with_maps(**dark)
    factor = (1 - 0.4 + 0.4 * LIGHT[:, 2:])
    assert_close(falling.shade(LIGHT, VIEW), constant.shade(LIGHT, VIEW) * factor, 1e-12)


def test_gradients_reach_factor_falloff_and_colour():
    material = lambert(indirect=torch.tensor([1.0], dtype=torch.float64))
    material.shade(LIGHT, VIEW).sum().backward()
    assert float(material.maps["indirect"].grad.abs().min()) > 0 and float(material.maps["albedo"].grad.abs().max()) > 0
    material = lambert(ambient=0.1 * colours(), ambient_falloff=torch.tensor([0.3], dtype=torch.float64))
    material.shade(LIGHT, VIEW).sum().backward()
    assert float(material.maps["ambient_falloff"].grad) < 0


def test_what_arrives_is_kept_until_height_or_colour_change(monkeypatch):
    calls = []
    honest = indirect.transfer
    monkeypatch.setattr(indirect, "_TRANSFERS", indirect._Kept(2))
    monkeypatch.setattr(indirect, "transfer", lambda *given: calls.append(1) or honest(*given))
    material = lambert(indirect=torch.tensor([1.0], dtype=torch.float64))
    with torch.no_grad():
        first = material.shade(LIGHT, VIEW)
        material.shade(LIGHT[:1], VIEW)
        assert len(calls) == 1
        material.maps["albedo"].mul_(0.5)
        second = material.shade(LIGHT, VIEW)
    assert len(calls) == 2
    assert_close(second, honest_half(), 1e-9)
    assert float(first.mean()) > 2 * float(second.mean()) * 0.99


def honest_half() -> torch.Tensor:
    parts = {"indirect": torch.tensor([1.0], dtype=torch.float64)}
    half = Lambert({"albedo": colours() * 0.5, "normal": normals(), "height": relief(), **parts})
    with torch.no_grad():
        return half.shade(LIGHT, VIEW)


def test_a_folder_keeps_both(tmp_path):
    for number, parts in enumerate([
        {"indirect": torch.tensor([1.25])}, {"ambient": 0.1 * colours().float(), "ambient_falloff": torch.tensor([0.5])},
    ]):
        maps = {"albedo": colours().float(), "normal": normals().float(), "height": relief().float()}
        material = Lambert({**maps, **parts}, storage="float")
        tm.save_material(material, tmp_path / str(number))
        back = tm.load_material(tmp_path / str(number))
        assert set(back.maps) == set(material.maps)
        with torch.no_grad():
            assert_close(back.shade(LIGHT.float(), VIEW.float()), material.shade(LIGHT.float(), VIEW.float()), 5e-3)  # the height's 16 bits


def test_a_large_relief_is_seen_smaller(monkeypatch):
    assert indirect._smaller(torch.zeros(1, 200, 160)).shape == (1, 107, 86)  # 9202 of at most 9216 texels
    monkeypatch.setattr(indirect, "_MOST_TEXELS", 24 * 24)
    height = torch.nn.functional.interpolate(relief()[None], size=(50, 40), mode="bicubic")[0]
    white = torch.full((3, 50, 40), 0.5, dtype=torch.float64)
    transfer = indirect.transfer(height, white, True)
    assert transfer.shape == (9, 3, 50, 40) and indirect.small_transfer(height, white, True).shape == (9, 3, 27, 21)
    small = indirect.transfer(relief(), torch.full((3, SIZE, SIZE), 0.5, dtype=torch.float64), True)
    assert float(transfer[0].mean()) == pytest.approx(float(small[0].mean()), rel=0.25)


def test_parts_that_do_not_go_together_are_refused():
    one = torch.ones(1, dtype=torch.float64)
    with pytest.raises(RangeError, match="ambient_falloff must come with an ambient map"):
        lambert(ambient_falloff=0.5 * one)
    with pytest.raises(RangeError, match="indirect must stand in the place of an ambient map"):
        lambert(ambient=colours(), indirect=one)
    with pytest.raises(RangeError, match="no height"):
        Lambert({"albedo": colours(), "normal": normals(), "indirect": one})
    with pytest.raises(RangeError, match="texture has no diffuse colour"):
        Texture({"albedo": colours(), "height": relief(), "indirect": one})


def test_a_map_in_the_place_of_radiosity_is_nearest_to_it():
    material = lambert(indirect=torch.tensor([1.3], dtype=torch.float64)).requires_grad_(False)
    mapped = indirect.as_ambient(material).requires_grad_(False)
    assert "indirect" not in mapped.maps and {"ambient", "ambient_falloff"} <= set(mapped.maps)
    bare = lambert().requires_grad_(False)
    sent = (material.shade(LIGHT, VIEW) - bare.shade(LIGHT, VIEW)).abs().mean()
    off = (material.shade(LIGHT, VIEW) - mapped.shade(LIGHT, VIEW)).abs().mean()
    assert float(off) < 0.35 * float(sent)  # a texel's own dependence on the azimuth is lost


def test_blends_of_two_ways_mix_what_they_send():
    one = lambert(indirect=torch.tensor([1.3], dtype=torch.float64)).requires_grad_(False)
    for other in (
        lambert(indirect=torch.tensor([0.5], dtype=torch.float64)), lambert(ambient=0.1 * colours()), lambert(),
        lambert(ambient=0.1 * colours(), ambient_falloff=torch.tensor([0.8], dtype=torch.float64)),
    ):
        other = other.requires_grad_(False)
        mixed = blend(one, other, 0.5).requires_grad_(False)
        sides = [float(side.shade(LIGHT, VIEW).mean()) for side in (one, other)]
        assert float(mixed.shade(LIGHT, VIEW).mean()) == pytest.approx(sum(sides) / 2, rel=0.02)
        by_map = blend(one, other, torch.full((1, SIZE, SIZE), 0.5, dtype=torch.float64)).requires_grad_(False)
        assert_close(by_map.shade(LIGHT, VIEW), mixed.shade(LIGHT, VIEW), 1e-9)
