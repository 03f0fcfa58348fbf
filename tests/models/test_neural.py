"""Neural: values by hand, tables that do not fit, what is stored, and parts that go through the network by turns."""

from __future__ import annotations

import pytest
import torch
from tests.models.examples import assert_same, directions, make, make_maps, per_image, per_texel

import torchmat.models.neural as neural
from torchmat import RangeError, ShapeError
from torchmat.models import Neural

OPTIONS = {"latent": 2, "hidden": 4, "layers": 1}


def test_a_network_by_hand(dtype):
    # One unit adds the first latent number and the light's z, one takes the second from 0: max(0, a + l_z), max(0, -b).
    first = torch.zeros(1, 2, 2 + 8 + 1, dtype=dtype)
    first[0, 0, 0] = first[0, 0, 2 + 2] = 1
    first[0, 1, 1] = -1
    last = torch.tensor([[[1.0, 0, 0], [0, 2, 0], [-1, 0, 0.5]]], dtype=dtype)
    latent = torch.tensor([[[0.25, -2.0]], [[-0.5, 1.0]]], dtype=dtype)
    material = Neural({"latent": latent, "layer_0": first, "layer_1": last}, latent=2, hidden=2, layers=1)
    light = torch.tensor([0.6, 0.0, 0.8], dtype=dtype)[:, None, None]
    # Texel 0: units 1.05, 0.5; roots 1.05, 1, -0.55. Texel 1: units 0, 0; roots 0, 0, 0.5.
    expected = torch.tensor([[[1.05**2, 0]], [[1, 0]], [[0, 0.25]]], dtype=dtype)
    assert_same(material.shade(light, light), expected)


def test_the_order_of_what_the_network_is_told():
    light, view = directions(1)[0], directions(1, seed=2)[0]
    half = (light + view) / (light + view).norm()
    told = neural.angles(light[:, None, None], view[:, None, None])[:, 0, 0]
    assert_same(told, torch.cat((light, view, half[:2])))


def test_images_that_go_through_by_turns_give_the_same(monkeypatch):
    material = make("neural", {"latent": 3, "hidden": 5, "layers": 2}, 4, 5)
    light, view = per_image(directions(7)), per_image(directions(7, seed=2))
    texel = per_texel(4, 5)
    whole = material.shade(light, view), material.shade(light, texel)
    monkeypatch.setattr(neural, "COLUMNS", 40)  # two images at a time
    assert_same(material.shade(light, view), whole[0], 1e-14)
    assert_same(material.shade(light, texel), whole[1], 1e-14)


@pytest.mark.parametrize("table", ["layer_0", "layer_1"])
def test_tables_must_fit_the_network(table):
    maps = make_maps("neural", OPTIONS)
    with pytest.raises(ShapeError, match=rf"{table} must be \[1, ., .*\]; it is"):
        Neural({**maps, table: maps[table][:, :-1]}, **OPTIONS)
    with pytest.raises(ShapeError, match=rf"{table} must be"):
        Neural({**maps, table: maps[table][:, :, :-1]}, **OPTIONS)


@pytest.mark.parametrize("name", ["latent", "hidden", "layers"])
@pytest.mark.parametrize("bad", [0, -1, 2.5, True, "8", 5000])
def test_counts_are_whole_and_positive(name, bad):
    with pytest.raises(RangeError, match=f"{name} must be a whole number of 1 to 1024; it is"):
        Neural({}, **{name: bad})


def test_the_network_stays_precise_when_texels_take_one_byte():
    material = make("neural", OPTIONS, storage="png8")
    assert {name: kind for _, name, _, kind, _ in material.textures()} == {
        "latent_00": "png8", "latent_01": "png8", "layer_0": "half", "layer_1": "half",
    }
    assert material.bytes_per_texel == 2 and material.shared_bytes == 2 * (4 * 11 + 3 * 5)
