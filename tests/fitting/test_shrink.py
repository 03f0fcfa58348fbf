"""Maps made smaller against a cost that is known: what is chosen, what is measured, and what is left alone."""

from __future__ import annotations

import math

import pytest
import torch

from torchmat.fitting.choice import shrink as shrink_module
from torchmat.fitting.choice.shrink import shrink, shrink_steps, total_bytes
from torchmat.models import Distribution, Lptm, Texture
from torchmat.models.storage import StoredAs


def noise(channels, size=16, seed=0):
    return torch.rand(channels, size, size, generator=torch.Generator().manual_seed(seed))


def wave(channels, size=16):
    u = (torch.arange(size) + 0.5) / size * 2 * torch.pi
    return (0.5 + 0.3 * torch.cos(u)).expand(channels, size, size).contiguous()


def squared(truth, floor=1e-4, factor=1.0):
    """Return a cost: a floor and the mean square by which exported maps differ from the true ones, all maps alike."""
    calls = []

    def cost(material):
        calls.append(material)
        exported = material.as_exported()
        gaps = [(exported.maps[name].detach() - value).square().mean() for name, value in truth.items()]
        return floor + factor * float(sum(gaps))

    cost.calls = calls
    return cost


def lptm(chroma, luminance):
    maps = {"chroma": chroma, "luminance": luminance}
    return Lptm(maps, storage="png8"), maps


def test_constant_maps_become_numbers_and_detail_stays():
    material, truth = lptm(torch.full((3, 16, 16), 0.4), noise(6))
    found = shrink(material, squared(truth), 2e-4)
    assert found.material.stored == {"chroma": StoredAs((1, 1))}
    assert found.cost <= 2e-4 and total_bytes(found.material) == 6 + 12 / 256


def test_a_smooth_map_gets_the_smallest_size_that_fits():
    material, truth = lptm(wave(3), noise(6))
    cost = squared(truth)
    alone = {side: cost(material.stored_at({"chroma": StoredAs((side, side))})) for side in (8, 4, 2)}
    assert alone[8] < alone[4] < alone[2]
    for side, limit in ((8, (alone[8] + alone[4]) / 2), (4, (alone[4] + alone[2]) / 2)):
        assert shrink(material, squared(truth), limit).material.stored["chroma"] == StoredAs((side, side))


def test_the_cheapest_combination_within_the_limit_is_the_one_that_a_full_search_finds():
    material, truth = lptm(wave(3) + 0.02 * noise(3), wave(6) + 0.05 * noise(6, seed=1))
    cost = squared(truth)
    sizes = [None, (8, 8), (4, 4), (2, 2), (1, 1)]
    for limit in (3e-4, 1e-3, 5e-3, 3e-2):
        every = [material.stored_at({"chroma": StoredAs(a), "luminance": StoredAs(b)}) for a in sizes for b in sizes]
        least = min(total_bytes(one) for one in every if cost(one) <= limit)
        found = shrink(material, squared(truth), limit)
        assert found.cost <= limit and total_bytes(found.material) == pytest.approx(least)


def test_no_limit_saves_only_what_buys_nothing():
    material, truth = lptm(torch.full((3, 16, 16), 0.4), noise(6))
    found = shrink(material, squared(truth))
    assert found.material.stored == {"chroma": StoredAs((1, 1))}
    assert found.cost <= squared(truth)(material) * 1.005
    hopeless = shrink(material, squared(truth), 1e-9)  # more cost than is wanted as it stands
    assert hopeless.material.stored == found.material.stored


def test_few_bytes_take_the_best_that_fits():
    material, truth = lptm(wave(3), noise(6))
    for most in (6.5, 3.0, 1.0, 0.15):
        found = shrink(material, squared(truth), most_bytes=most)
        assert total_bytes(found.material) <= most
        assert found.material.stored["chroma"].size is not None
    assert shrink(material, squared(truth), most_bytes=6.9).material.stored.get("luminance") is None
    impossible = shrink(material, squared(truth), most_bytes=1e-3).material
    assert impossible.stored == {name: StoredAs((1, 1)) for name in ("chroma", "luminance")}


def test_bytes_count_more_than_the_cost():
    material, truth = lptm(noise(3), noise(6, seed=1))
    found = shrink(material, squared(truth), 1.1e-4, most_bytes=3.0)
    assert total_bytes(found.material) <= 3.0 and found.cost > 1.1e-4


def test_sixteen_bits_where_eight_lose():
    material = Texture({"albedo": noise(3)}, storage="png8")
    truth = {"albedo": material.maps["albedo"].detach()}
    coarse, fine = (squared(truth, 1e-8)(one) for one in (material, material.stored_as("png16")))
    found = shrink(material, squared(truth, 1e-8), (coarse + fine) / 2)
    assert found.material.stored == {"albedo": StoredAs(storage="png16")} and found.cost <= (coarse + fine) / 2
    assert shrink(material, squared(truth, 1e-8), coarse * 1.01).material.stored == {}


def test_costs_that_do_not_add_up_are_measured_before_they_are_believed():
    material, truth = lptm(wave(3) + 0.02 * noise(3), wave(6) + 0.05 * noise(6, seed=1))
    plain = squared(truth)

    def worse_together(one):
        return plain(one) + (0.1 if len(one.stored) > 1 else 0.0)

    found = shrink(material, worse_together, 2e-3)
    assert len(found.material.stored) == 1 and found.cost <= 2e-3


def test_it_ends_early_when_another_takes_fewer_bytes():
    material, truth = lptm(wave(3), noise(6))
    cost, beaten = squared(truth), squared(truth)
    shrink(material, cost, 2e-4)
    found = shrink(material, beaten, 2e-4, rival=2.0)
    assert found.material.stored == {} and len(beaten.calls) < len(cost.calls)


def test_heights_lose_depth_before_size_and_never_become_a_number():
    material = Texture({"albedo": torch.full((3, 16, 16), 0.4)}, storage="png8").on_relief(0.1 * wave(1))
    truth = {"height": material.maps["height"].detach()}
    found = shrink(material, squared(truth, 1e-6), 1.01e-6)
    assert found.material.stored["height"] == StoredAs(storage="png8")
    assert found.material.stored["albedo"] == StoredAs((1, 1))
    careless = shrink(material, squared(truth), math.inf).material
    assert careless.stored["height"].size == (4, 4) or careless.stored["height"].size == (2, 2)


def test_specular_maps_take_the_side_that_they_need():
    axis = (torch.arange(48) + 0.5) / 24 - 1
    table = torch.exp(-4 * (axis**2 + axis[:, None] ** 2)).expand(3, 48, 48).contiguous()
    material = Distribution({"diffuse": noise(3), "specular": table}, lobes=1, parts=[], storage="png8")

    def cost(one):
        side = one.maps["specular"].shape[-1]
        return 1.0 if side < 16 else 0.1

    assert shrink(material, cost, 0.5).material.maps["specular"].shape == (3, 16, 16)


def test_the_steps_say_what_was_measured():
    material, truth = lptm(wave(3), noise(6))
    cost = squared(truth)
    for step in shrink(material, squared(truth), 3e-4).steps:
        assert set(step) == {"map", "stored", "bytes", "cost", "alone"}
        known = {"number": StoredAs((1, 1)), "16 bit": StoredAs(storage="png16")}
        size = known.get(step["stored"]) or StoredAs(tuple(map(int, step["stored"].split(" x "))))
        one = material.stored_at({step["map"]: size})
        assert step["bytes"] == pytest.approx(total_bytes(one)) and step["cost"] == pytest.approx(cost(one))
        assert cost(step["alone"]) == pytest.approx(step["cost"])


def test_nothing_is_measured_twice_and_no_depth_that_cannot_help():
    material, truth = lptm(wave(3), noise(6))
    cost, known = squared(truth, 1e-3), squared(truth, 1e-3)

    def in_full(one):
        return 1e-3 + float(sum((one.maps[name].detach() - value).square().mean() for name, value in truth.items()))

    plain = shrink(material, cost, 2e-3)
    found = shrink(material, known, 2e-3, as_it_is=in_full)
    assert found.material.stored == plain.material.stored and found.cost == plain.cost
    assert len(known.calls) == len(cost.calls) - 1  # that of all maps in 16 bits
    assert len({tuple(sorted(one.stored.items())) for one in known.calls}) == len(known.calls)


def test_a_full_search_is_given_every_step():
    material, truth = lptm(wave(3), noise(6))
    fronts = shrink_steps(material, squared(truth, 1e-3))
    assert {tuple(step.name for step in front) for front in fronts} == {("whole", "8 x 8", "4 x 4", "number")}
    assert all(front[0].stored is None for front in fronts)
    few = shrink_steps(material, squared(truth, 1e-3), 2e-3)
    assert {front[0].map: len(front) for front in few} == {"chroma": 3, "luminance": 1}
    assert shrink_steps(material, squared(truth, 1e-3), 2e-3, rival=5.0) == []


def test_one_map_after_the_other_is_made_smaller_while_there_is_something_to_spare(monkeypatch):
    monkeypatch.setattr(shrink_module, "TRIES", 0)  # nothing but the one map that saves most to begin with
    material, truth = lptm(wave(3) + 0.02 * noise(3), wave(6) + 0.05 * noise(6, seed=1))
    cost = squared(truth)
    sizes = [None, (8, 8), (4, 4), (2, 2), (1, 1)]
    every = [material.stored_at({"chroma": StoredAs(a), "luminance": StoredAs(b)}) for a in sizes for b in sizes]
    for limit in (3e-4, 1e-3, 5e-3, 3e-2):
        least = min(total_bytes(one) for one in every if cost(one) <= limit)
        found = shrink(material, squared(truth), limit)
        assert found.cost <= limit and total_bytes(found.material) == pytest.approx(least)
