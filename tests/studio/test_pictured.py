"""A material that no page can draw, in the studio: its pictures are those of `render`."""

from __future__ import annotations

import base64
import io
import json
import math

import numpy as np
import pytest
import torch
from PIL import Image
from tests.models.examples import EXAMPLE_OPTIONS, make
from tests.studio.serving import served

import torchmat as tm
from torchmat import colour
from torchmat.images import read_image, write_image
from torchmat.rendering import Camera, Directional, Point
from torchmat.rendering.shapes import make_mesh

LOOK = {
    "mesh": "quad", "view": [0, 0, 1], "zoom": 1, "perspective": False, "lights": [[[-0.4, 0.5, 0.768, 0], [1, 1, 1]]],
    "repeat": 1, "exposure": 0, "size": [24, 24],
}
REPORT = {"held_out_after_export": {"relative_error": 0.03125, "psnr_db": 31.5}}


def pictured(path, name="pca", side=12):
    """Write a material without a shader, and the report of its fit, and return its folder."""
    tm.save_material(make(name, EXAMPLE_OPTIONS[name][0], side, side, torch.float32), path)
    (path / "report.json").write_text(json.dumps(REPORT))
    return path


def codes(answer):
    """Return the pixels [H, W, 4] of a picture as the page gets it."""
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(answer)))).astype(int)


def rendered(material, exposure=0, **given):
    picture = tm.render(material, rays=1, **given)
    return (colour.display((picture * 2.0**exposure).float()) * 255).round().permute(1, 2, 0).numpy().astype(int)


@pytest.mark.parametrize("name", ["pca", "local_pca", "neural"])
def test_it_is_opened_with_its_maps_its_report_and_its_picture(tmp_path, name):
    folder = pictured(tmp_path / "wool", name)
    material = tm.load_material(folder)
    with served(folder) as studio, studio.page() as page:
        description = studio.json("/material.json")
        assert description["glsl"] is None and description["model"] == name
        assert [row[1] for row in description["errors"]["rows"]] == ["0.0312", "31.5"]
        assert [entry["name"] for entry in description["maps"]] == [spec.name for spec in material.specs() if not spec.constant]
        for entry in description["maps"]:
            held = studio.get(f"/map/{entry['name']}")[1]
            each = {"u8": 1, "u16": 2, "f16": 2, "f32": 4}[entry["type"]]
            assert entry["channels"] <= 4
            assert len(held) == each * entry["layers"] * entry["channels"] * entry["height"] * entry["width"]
        found = codes(page.wish("picture", **LOOK))
        expected = rendered(material, mesh="quad", lights=[(-0.4, 0.5, 0.768)], size=24)
        assert np.array_equal(found[..., :3], expected) and expected.std() > 5
        assert set(np.unique(found[..., 3])) <= {0, 255} and (found[..., 3] == 255).mean() > 0.4


def test_cameras_lights_and_sizes_are_those_of_the_page(tmp_path):
    folder = pictured(tmp_path / "wool")
    material, mesh = tm.load_material(folder), make_mesh("teapot")
    way = np.array([-0.4, 0.3, 0.9]) / math.sqrt(1.06)
    place = (mesh.centre.numpy() + 3.5 * mesh.radius * way).tolist()
    lights = [[[*place, 1], [20, 10, 5]], [[1, 0.2, 0.3, 0], [0.5, 0.5, 1]]]
    lamps = [Point(place, [20, 10, 5]), Directional((1, 0.2, 0.3), (0.5, 0.5, 1))]
    framed = {"centre": mesh.centre, "radius": mesh.radius, "direction": [0.7, 0.5, 1]}
    with served(folder) as studio, studio.page() as page:
        look = {**LOOK, "mesh": "teapot", "view": [0.7, 0.5, 1], "lights": lights, "repeat": 2.5, "exposure": 0.5, "size": [20, 20]}
        for perspective, angle in ((False, None), (True, math.radians(30))):
            camera = Camera.framing(field_of_view=angle, **framed)
            expected = rendered(material, 0.5, mesh="teapot", lights=lamps, camera=camera, repeat=2.5, size=20)
            found = codes(page.wish("picture", **{**look, "perspective": perspective}))
            assert np.array_equal(found[..., :3], expected) and expected.std() > 10
            # Twice as near it is what the middle half shows; a wider picture shows the same and more beside it.
            near = codes(page.wish("picture", **{**look, "perspective": perspective, "zoom": 2, "size": [40, 40]}))
            wide = codes(page.wish("picture", **{**look, "perspective": perspective, "size": [20, 40]}))
            assert np.array_equal(wide[:, 10:30], found), perspective
            if not perspective:
                far = codes(page.wish("picture", **{**look, "size": [80, 80]}))
                assert np.array_equal(near, far[20:60, 20:60])
            else:
                assert (near[..., 3] > 0).mean() > 1.5 * (found[..., 3] > 0).mean()
        dark = codes(page.wish("picture", **{**look, "lights": []}))
        assert dark[..., :3].max() == 0 and dark[..., 3].max() == 255


def test_a_save_is_in_the_next_picture_and_what_cannot_be_is_refused(tmp_path):
    folder = pictured(tmp_path / "wool", "neural")
    texture = next(one for one in json.loads((folder / "manifest.json").read_text())["textures"] if one["map"] == "latent")
    with served(folder) as studio, studio.page() as page:
        before = page.wish("picture", **LOOK)
        assert page.wish("picture", **LOOK) == before
        path = folder / texture["file"]
        write_image(path, np.flipud(read_image(path)).copy())
        page.wait("map", name="latent")
        assert np.array_equal(codes(page.wish("picture", **LOOK))[..., :3], rendered(tm.load_material(folder), mesh="quad", lights=[(-0.4, 0.5, 0.768)], size=24))
        assert page.wish("picture", **LOOK) != before
        for wrong, said in (
            ({"mesh": "bunny"}, "must be one of 'quad'"), ({"size": [24, 5000]}, "rows and columns, 1 to 1024"), ({"size": [24.5, 24]}, "rows and columns"),
            ({"zoom": 0}, "zoom must lie in"), ({"exposure": float("nan")}, "exposure must lie in"), ({"view": [0, 0, 0]}, "finite direction"),
            ({"lights": [[[0, 0, 1], [1, 1, 1]]]}, "pairs of four and three"), ({"lights": [[[0, 0, 1, 0], [1, -1, 1]]]}, "not be negative"),
            ({"repeat": 0}, "be positive"), ({"lights": LOOK["lights"] * 13}, "at most 12 pairs"),
        ):
            with pytest.raises(ValueError, match=said):
                page.wish("picture", **{**LOOK, **wrong})
