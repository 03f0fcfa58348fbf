"""A material in a page: maps that change, contexts that are lost, and cards that can do less."""

from __future__ import annotations

import base64

import numpy as np
import pytest
import torch
from tests.models.examples import EXAMPLE_OPTIONS, directions, make, per_image
from tests.web.drawing import Drawing, relative_error
from tests.web.test_shaders_relief import on_bumps

from torchmat.models import Material
from torchmat.web.payload import describe, map_of

_MICROFACET = EXAMPLE_OPTIONS["microfacet"][3]


def pairs(count: int = 3):
    return [per_image(directions(count, torch.float32, seed, lowest=0.3)) for seed in (5, 6)]


def error_of(drawing, material: Material) -> float:
    """Return the relative squared error of what the page draws now."""
    light, view = pairs()
    with torch.no_grad():
        return relative_error(drawing.evaluate(light, view, material.size), material.as_exported().shade(light, view))


def update(drawing, material: Material, name: str) -> None:
    """Give the page one map of a material."""
    entry, codes = map_of(material, name)
    drawing.page.evaluate(
        "([name, entry, codes]) => drawing.material.update(name, entry, drawing.bytes(codes))", [name, entry, base64.b64encode(codes).decode()],
    )


@pytest.mark.parametrize("relief", ["fast", "fine"])
def test_a_map_that_changes_is_the_only_one_sent(drawing, relief):
    material = on_bumps("microfacet", _MICROFACET, (12, 10), relief=relief)
    drawing.load(material)
    for name in ("diffuse", "normal", "height", "rotation", "ambient"):
        value = torch.rand_like(material.maps[name])
        value = torch.nn.functional.normalize(value, dim=0) if name in ("normal", "rotation") else 0.05 * value
        material = material.with_maps(**{name: value})
        assert error_of(drawing, material) > 1e-5
        update(drawing, material, name)
        assert error_of(drawing, material) < 1e-6, name


def test_a_map_may_come_in_another_size_and_depth(drawing):
    from torchmat.models.storage import StoredAs

    material = make("distribution", {"lobes": 1, "parts": ["rotation"]}, 12, 10, torch.float32, storage="float")
    drawing.load(material)
    for name, stored in (
        ("diffuse", StoredAs(size=(5, 6), storage="png8")), ("rotation", StoredAs(storage="paint8")), ("specular", StoredAs(size=(9, 9))),
        ("diffuse", StoredAs(size=(1, 1))), ("rotation", StoredAs(storage="half")),
    ):
        material = material.stored_at({name: stored})
        update(drawing, material, name)
        assert error_of(drawing, material) < 1e-9, name


def test_numbers_change_too(drawing):
    material = make("phong_srf", EXAMPLE_OPTIONS["phong_srf"][0], 6, 6, torch.float32, storage="float")
    drawing.load(material)
    numbers = [2 * one for one in material.maps["lobe"].tolist()]
    drawing.page.evaluate("(numbers) => drawing.material.setNumbers('lobe', numbers)", numbers)
    assert error_of(drawing, material.with_maps(lobe=torch.tensor(numbers))) < 1e-9


def test_what_does_not_fit_is_refused_and_changes_nothing(drawing):
    material = make("texture", {}, 6, 6, torch.float32, storage="float")
    drawing.load(material)
    for script, words in (
        ("drawing.material.update('none', {}, new ArrayBuffer(0))", "no map none; it has albedo"),
        ("drawing.material.update('albedo', drawing.material.entries.get('albedo'), new ArrayBuffer(8))", "432 bytes of codes; 8 came"),
        ("drawing.material.setNumbers('lobe', [1])", "no 1 numbers lobe"),
        ("new drawing.Material(drawing.context, {format: 'else', version: 1}, {})", "must be torchmat-web 1; it is else 1"),
    ):
        with pytest.raises(Exception, match=words):
            drawing.page.evaluate(f"() => {{ {script}; }}")
    assert drawing.page.evaluate("drawing.material.buffers.albedo.byteLength") == 432  # what a lost context comes back with
    assert error_of(drawing, material) < 1e-9


def test_a_context_that_was_lost_comes_back_with_what_changed_meanwhile(chromium):
    drawing = Drawing(chromium)
    material = on_bumps("microfacet", _MICROFACET, (12, 10))
    drawing.load(material)
    drawing.page.evaluate("() => { window.lost = drawing.context.gl.getExtension('WEBGL_lose_context'); lost.loseContext(); }")
    drawing.page.wait_for_function("drawing.context.lost")
    material = material.with_maps(diffuse=torch.rand(3, 12, 10))
    update(drawing, material, "diffuse")
    drawing.page.evaluate("() => lost.restoreContext()")
    drawing.page.wait_for_function("!drawing.context.lost")
    assert error_of(drawing, material) < 1e-6
    assert [text for text in drawing.close() if "lost" not in text.lower()] == []


def test_targets_of_16_bits_serve_phones(chromium):
    drawing = Drawing(chromium, half=True)
    assert drawing.page.evaluate("drawing.context.caps.float") is False
    for material in (on_bumps("microfacet", _MICROFACET, (12, 10)), make("hsh", {"terms": 9}, 7, 5, torch.float32)):
        drawing.load(material)
        assert error_of(drawing, material) < 1e-5  # of halves: measured 3e-7
    assert drawing.close() == []


def test_no_material_takes_more_textures_than_every_browser_has(drawing):
    material = on_bumps("microfacet", _MICROFACET, (12, 10), "falloff", relief="fine").with_maps(opacity=torch.ones(1, 12, 10))
    drawing.load(material)
    assert drawing.page.evaluate("drawing.material.textures.size") <= 14  # of 16: two are left for what is around the object


def test_maps_are_as_small_as_they_are_stored():
    material = make("distribution", {"lobes": 1, "parts": ["specular_mask"]}, 16, 16, torch.float32, storage="png8")
    payload = describe(material)
    assert {name: len(codes) for name, codes in payload.buffers.items()} == {"diffuse": 768, "specular_mask": 256, "specular": 216}
    entry = payload.description["maps"][0]
    assert (entry["type"], entry["transfer"], entry["colour"], entry["layers"], entry["channels"]) == ("u8", "srgb", True, 1, 3)
    decoded = material.as_exported().maps["diffuse"].detach()
    assert np.allclose(entry["range"], [float(decoded.min()), float(decoded.max())])


def thumbnails(drawing, payload) -> dict[str, np.ndarray]:
    """Return the small picture [rows, columns, rgb] of each map."""
    script = """async ([entry, codes]) => {
      const {thumbnail} = await import("/web/js/thumbnails.js"), canvas = thumbnail(entry, drawing.bytes(codes));
      return [canvas.height, canvas.width, [...canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data]];
    }"""
    found = {}
    for entry in payload.description["maps"]:
        codes = base64.b64encode(payload.buffers[entry["name"]]).decode()
        rows, columns, pixels = drawing.page.evaluate(script, [entry, codes])
        found[entry["name"]] = np.array(pixels).reshape(rows, columns, 4)[..., :3]
    return found


@pytest.mark.parametrize("storage", ["half", "png8", "paint8"])
def test_small_pictures_show_maps_as_paint_programs_do(drawing, storage):
    options = {"lobes": 2, "parts": ["normal", "specular_mask", "rotation"]}
    material = make("distribution", options, 8, 8, torch.float32, storage=storage)
    share = torch.linspace(0, 1, 8).expand(1, 8, 8)
    turned = torch.stack((torch.zeros(8, 8), torch.ones(8, 8)))
    flat = torch.tensor([0.0, 0.0, 1.0])[:, None, None].expand(3, 8, 8)
    colour = torch.tensor([1.0, 0.214, 0.0])[:, None, None].expand(3, 8, 8)
    found = thumbnails(drawing, describe(material.with_maps(specular_mask=share, rotation=turned, normal=flat, diffuse=colour)))
    assert np.abs(found["diffuse"] - [255, 127.5, 0]).max() <= 1  # 0.214 is half way in sRGB
    assert np.abs(found["normal"] - [127.5, 127.5, 255]).max() <= 2
    assert np.abs(found["rotation"] - [127.5, 255, 0]).max() <= 2  # a quarter of a turn from red
    ramp = found["specular_mask"][0, :, 0]
    assert (np.diff(ramp) > 0).all() and ramp[0] <= 1 and ramp[-1] >= 254
    assert found["index"].shape == (8, 16, 3) and found["specular"].shape == (6, 12, 3)  # a lobe beside the other


def test_small_pictures_are_small(drawing):
    payload = describe(make("ptm", {}, 300, 150, torch.float32))
    assert thumbnails(drawing, payload)["polynomial"].shape == (42, 33, 3)
    curve = describe(make("distribution", {"lobes": 1, "parts": ["tilt"]}, 4, 4, torch.float32))
    assert thumbnails(drawing, curve)["tilt"].shape == (16, 64, 3)
