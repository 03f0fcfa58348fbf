"""A scene: the same picture as render's, what it uses, scenes as files, and scenes that see nothing."""

from __future__ import annotations

import math

import pytest
import torch
from tests.support import all_pairs, assert_close, hemisphere, plausible_images

import torchmat as tm
from torchmat import Btf, DataError, RangeError, Scene
from torchmat.btf.interpolated import RawBtf
from torchmat.models import Texture
from torchmat.models.cutout import Cutout
from torchmat.rendering import Camera, Directional, Point, render
from torchmat.rendering.scene_file import load_scene

LIGHTS = (Directional((0.3, 0.4, 0.9)), Point((1.0, 2.0, 3.0), (4.0, 2.0, 1.0)))


def checked(size: tuple[int, int] = (16, 16), dtype=torch.float32) -> Texture:
    """Return a texture with a colour of its own at each texel."""
    generator = torch.Generator().manual_seed(0)
    return Texture({"albedo": torch.rand(3, *size, generator=generator, dtype=torch.float64).to(dtype)})


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("shadows", [False, True])
def test_a_scene_is_the_same_picture_bit_for_bit(dtype, shadows):
    settings = {"size": (20, 30), "repeat": 2.0, "shadows": shadows, "rays": 4, "edges_only": True}
    scene = Scene("teapot", LIGHTS, view=(0.3, 0.2, 1), **settings)
    material = checked(dtype=dtype)
    assert torch.equal(render(material, scene), render(material, "teapot", LIGHTS, (0.3, 0.2, 1), **settings))
    assert torch.equal(scene.picture(material), tm.render(material, scene))


def test_a_camera_of_its_own_and_an_old_call_still_work():
    camera = Camera((0.5, 0.2, 4.0), field_of_view=0.5)
    scene = Scene("sphere", [(0, 0, 1)], camera, size=16)
    assert torch.equal(render(checked(), scene), render(checked(), "sphere", [(0, 0, 1)], size=16, camera=camera))


def test_nothing_stands_beside_a_scene():
    scene = Scene("quad", size=8)
    for given in ({"size": 9}, {"lights": [(0, 0, 1)]}, {"shadows": True}, {"view": (0, 0, 1)}):
        with pytest.raises(RangeError, match="come alone"):
            render(checked(), scene, **given)
    with pytest.raises(RangeError, match="RawBtf"):
        render("leather", scene)


def test_use_predicts_the_mean_of_a_linear_picture():
    """The picture's sum is the sum over the use of weight times value: the two share one notion."""
    material = checked((2, 2))
    for shadows in (False, True):
        lights = [(0.3, 0.5, 0.8), Directional((-0.6, 0.1, 0.4), (0.5, 0.5, 0.5))]
        scene = Scene("torus", lights, size=32, shadows=shadows)
        use = scene.use()
        with torch.no_grad():
            value = material.shade_at(use.uv[:, None, use.point], use.light[:, None], use.view[:, None])
            total = (value[:, 0] * use.weight).sum(dim=1)
        assert float(scene.visible().footprint.max()) < 1 / 2  # so that no smaller copy is blended in
        assert_close(total, scene.picture(material).sum(dim=(1, 2)))


def test_a_quad_seen_from_the_front_uses_all_of_one_light_and_view():
    use = Scene("quad", [(0.3, 0.0, 0.9)], size=16, rays=1).use()
    assert float(use.view[2].min()) > 0.9999
    assert float((use.light - use.light[:, :1]).abs().max()) < 1e-6
    assert bool(use.texels(8, 8).all())


def test_environments_are_thinned_evenly():
    import importlib

    module = importlib.import_module("torchmat.rendering.scene")
    lights = [Directional((x, 0.2, 1.0), (0.5, 0.5, 0.5)) for x in (-0.5, -0.25, 0.0, 0.25, 0.5)]
    full = Scene("sphere", lights, size=64).use()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "MOST_PAIRS", 8_000)
        few = Scene("sphere", lights, size=64).use()
    assert len(few.weight) < len(full.weight) / 3
    assert torch.equal(few.uv, full.uv)
    assert float(few.weight.sum()) == pytest.approx(float(full.weight.sum()), rel=0.01)
    light, view = (torch.from_numpy(d) for d in all_pairs(hemisphere(), hemisphere()))
    gap = few.sample_weights(light, view).weight - full.sample_weights(light, view).weight
    assert float(gap.abs().max()) < 0.01


def test_scenes_that_see_nothing_say_what_is_missing():
    with pytest.raises(RangeError, match="the camera must see the object"):
        Scene("sphere", camera=Camera((0, 0, 5), target=(0, 0, 9)), size=8).use()
    with pytest.raises(RangeError, match="a light must reach"):
        Scene("quad", [(0, 0, -1)], size=8).use()
    with pytest.raises(RangeError, match="there is no light"):
        Scene("quad", [], size=8).use()
    with pytest.raises(RangeError, match="back of its surface"):
        Scene("quad", view=(0, 0, -1), size=8).use()
    with pytest.raises(RangeError, match="a light must reach"):
        Scene("quad", [Directional((0, 0, 1), (0, 0, 0))], size=8).use()


def test_bad_scenes_are_told_when_they_are_made():
    with pytest.raises(RangeError, match="be an object"):
        Scene("patch")
    with pytest.raises(RangeError, match="rays"):
        Scene("quad", rays=3)
    with pytest.raises(RangeError, match="lie outside"):
        Scene("sphere", [Point((0, 0, 0))])


def test_the_example_is_read_as_written():
    scene = load_scene("teapot.toml")  # the name of one that ships, as its path
    assert (scene.mesh.name, scene.size, scene.repeat, scene.shadows) == ("teapot", 512, 3.0, True)
    assert [tuple(light.intensity) for light in scene.lights] == [(1.0, 1.0, 1.0), (0.3, 0.3, 0.35)]


def test_a_scene_file_has_camera_and_point_lights(tmp_path):
    text = """
    mesh = "quad"
    size = [6, 8]
    [camera]
    position = [0, 0.5, 4]
    field_of_view_deg = 30.0
    [[lights]]
    position = [0, 1, 3]
    intensity = [5, 5, 5]
    """
    (tmp_path / "scene.toml").write_text(text, encoding="utf-8")
    given = {"camera": Camera((0, 0.5, 4)), "size": (6, 8)}
    expected = render(checked(), "quad", [Point((0, 1, 3), (5, 5, 5))], **given)
    assert torch.equal(render(checked(), load_scene(tmp_path / "scene.toml")), expected)


@pytest.mark.parametrize(("text", "match"), [
    ("size = 8", "mesh"), ('mesh = "quad"\nmehs = 1', "mehs"),
    ('mesh = "quad"\nlights = [{}]', "direction or a position"),
    ('mesh = "quad"\nlights = [3]', "scene"), ('mesh = "quad"\n[camera]\nup = [0, 1, 0]', "position"),
    ('mesh = "none.obj"', "none.obj"), ("mesh =", "TOML"), ('mesh = "quad"\nsize = "big"', "size"),
])
def test_bad_scene_files_are_named(tmp_path, text, match):
    path = tmp_path / "scene.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(DataError, match=match) as caught:
        load_scene(path)
    assert "scene.toml" in str(caught.value)
    with pytest.raises(DataError, match="Check the path"):
        load_scene(tmp_path / "absent.toml")


def cut(material: Texture, top: int, left: int, height: int, width: int, repeats: bool = True) -> Texture:
    """Return a window of a texture as a material that knows which part it is."""
    maps = {"albedo": material.maps["albedo"][:, top : top + height, left : left + width]}
    return Texture(maps, tiles=False, cutout=Cutout(top, left, height, width, *material.size, repeats))


@pytest.mark.parametrize(("pixels", "level"), [(33, 0), (17, 1), (9, 2)])
def test_a_cutout_is_the_same_picture_where_the_scene_looks(pixels, level):
    """Of the whole and of the touched window, also through smaller copies."""
    whole = checked((128, 128))
    camera = Camera((0.1, 0.05, 4.0), target=(0.1, 0.05, 0.0), width=0.25)
    scene = Scene("quad", [(0.2, 0.1, 1)], camera, size=pixels, rays=1)
    window = scene.use().window(128, 128)
    assert window is not None and math.ceil(float(scene.use().levels(128, 128).max())) == level
    found = render(cut(whole, *window), scene)
    assert_close(found, render(whole, scene), 1e-5)


def test_a_cutout_repeats_as_the_whole_does_and_goes_on_beyond_its_border():
    part = cut(checked((8, 8)), 2, 2, 4, 4)
    up = torch.tensor([0.0, 0.0, 1.0])[:, None, None]
    place = torch.tensor([0.45, 0.6])[:, None, None]
    with torch.no_grad():
        assert_close(part.shade_at(place + 3, up, up), part.shade_at(place, up, up), 1e-5)
        corner = part.shade_at(torch.tensor([0.1, 0.9])[:, None, None], up, up)
    assert_close(corner[:, 0, 0], part.maps["albedo"][:, 0, 0], 1e-6)


def test_cutouts_must_fit():
    with pytest.raises(RangeError, match="rows"):
        Cutout(6, 0, 4, 4, 8, 8)
    with pytest.raises(RangeError, match="columns"):
        Cutout(0, 0, 4, 0, 8, 8)
    with pytest.raises(RangeError, match="not repeat"):
        checked((4, 4)).cut_from(Cutout(0, 0, 4, 4, 8, 8))


def test_a_cutout_survives_the_folder_and_resizing(tmp_path):
    part = cut(checked((8, 8)), 2, 2, 4, 4).stored_as("float")
    tm.save_material(part, tmp_path / "part")
    loaded = tm.load_material(tmp_path / "part")
    assert loaded.cutout == part.cutout and loaded.whole_size == (8, 8) and not loaded.tiles
    assert torch.equal(loaded.maps["albedo"], part.maps["albedo"])
    from torchmat.models.edit import resized

    assert resized(part, (2, 2)).whole_size == (4, 4)
    manifest = tmp_path / "part" / "manifest.json"
    manifest.write_text(manifest.read_text().replace('"whole_width": 8', '"whole_width": 3'))
    with pytest.raises(DataError, match="manifest"):
        tm.load_material(tmp_path / "part")


def test_raw_images_render_in_a_scene():
    light, view = all_pairs(hemisphere(), hemisphere(((0, 1), (40, 5))))
    btf = Btf.from_tensors(plausible_images(light, view, 6, 5), light, view)
    picture = render(RawBtf(btf, dtype=torch.float64), Scene("sphere", size=12))
    assert picture.shape == (3, 12, 12) and float(picture.max()) > 0
