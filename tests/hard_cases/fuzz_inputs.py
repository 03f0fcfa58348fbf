"""Good files to start from, one or a few for everything that reads a file.

Each function writes into an empty folder and returns what is to be read: the folder, or a file in it.
"""

from __future__ import annotations

import gzip
import json
import os
import struct
import tempfile
import zipfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import torch
from tests.brdf.files import merl_bytes, rgl_fields, tensor_bytes
from tests.btf.dfmf_files import put_small as put_dfmf
from tests.btf.files import ANGLES, put_btf, put_image, random_codes, zipped
from tests.material_io.forms import microfacet, rand
from tests.models.distributions import ALL_PARTS, distribution
from tests.models.examples import make
from tests.rendering.mesh_files import SQUARE, SQUARE_UV, TWO, Gltf, glb_of, put_obj, put_ply, put_stl

import torchmat as tm
from torchmat.geometry import Relief
from torchmat.images import write_image
from torchmat.material_io import save_material
from torchmat.material_io import EXPORTERS
from torchmat.material_io.packing import pack
from torchmat.material_io.relief_folder import save_relief
from torchmat.models.storage import StoredAs

MADE = (1_700_000_000, 1_700_000_000)  # when files were made: by it a store in the cache knows its source again
Put = Callable[[Path], Path]


def named_putter(pattern: str) -> Put:
    def put(folder: Path) -> Path:
        for number, angles in enumerate(ANGLES):
            put_image(folder / (pattern % angles), random_codes(number, (2, 3, 3)))
        return folder

    return put


def put_rti(folder: Path) -> Path:
    for number in range(3):
        put_image(folder / f"{number}.png", random_codes(number, (2, 3, 3)))
    folder.joinpath("dirs.lp").write_text("3\n0.png 0 0 1\n1.png 0.6 0 0.8\n2.png 0 -0.6 0.8\n")
    return folder


def put_manifest(folder: Path) -> Path:
    return put_btf(folder, shape=(2, 3, 3))


def put_zip(folder: Path, put: Put = put_manifest) -> Path:
    put(folder / "d")
    archive = zipped(folder / "d")
    for path in (folder / "d").iterdir():
        path.unlink()
    (folder / "d").rmdir()
    return archive


def put_cached(folder: Path) -> Path:
    (folder / "btf").mkdir()
    for path in put_btf(folder / "btf", shape=(2, 3, 3)).iterdir():
        os.utime(path, MADE)
    tm.load_btf(folder / "btf", cache=folder / "cache", invalid="mask")
    return folder


def image_putter(suffix: str, dtype: str, channels: int = 3) -> Put:
    def put(folder: Path) -> Path:
        # Grains of noise as in photographs, so that a lost part shows in the pixels.
        return put_image(folder / f"a.{suffix}", random_codes(1, (16, 16, channels), dtype))

    return put


def material_putter(model: str, options: dict, storage: str) -> Put:
    def put(folder: Path) -> Path:
        tm.save_material(make(model, options, 4, 6, dtype=torch.float32, storage=storage), folder)
        return folder

    return put


def put_small(folder: Path) -> Path:
    """Write a material that stores one map in a smaller size."""
    material = make("lambert", {}, 4, 6, dtype=torch.float32, storage="png8")
    return tm.save_material(material.stored_at({"albedo": StoredAs(size=(2, 3))}), folder)


def put_distribution(folder: Path) -> Path:
    tm.save_material(distribution(4, 4, lobes=2, parts=ALL_PARTS, relief=True), folder)
    return folder


MTLX = """<?xml version="1.0"?>
<materialx version="1.39">
  <open_pbr_surface name="s" type="surfaceshader">
    <input name="base_color" type="color3" nodegraph="g" output="base"/>
    <input name="specular_roughness" type="float" nodename="r"/>
    <input name="base_metalness" type="float" nodename="parts" output="outb"/>
    <input name="geometry_normal" type="vector3" nodename="bump"/>
  </open_pbr_surface>
  <nodegraph name="g"><input name="f" type="filename" value="one.png"/>
    <image name="c" type="color3"><input name="file" type="filename" interfacename="f"/></image>
    <output name="base" type="color3" nodename="c"/></nodegraph>
  <image name="orm" type="color3"><input name="file" type="filename" value="two.png"/></image>
  <extract name="r" type="float"><input name="in" type="color3" nodename="orm"/><input name="index" type="integer" value="1"/></extract>
  <separate3 name="parts" type="multioutput"><input name="in" type="color3" nodename="orm"/></separate3>
  <normalmap name="bump" type="vector3"><input name="in" type="vector3" nodename="n"/></normalmap>
  <image name="n" type="vector3"><input name="file" type="filename" value="three.png"/></image>
</materialx>
"""


def put_packed(folder: Path) -> Path:
    return pack(distribution(4, 4, lobes=2, parts=ALL_PARTS, relief=True), folder, 8)


@cache
def _glb() -> bytes:
    with tempfile.TemporaryDirectory() as room:
        material = microfacet("normal", "anisotropy", "f90", "coat", "sheen", size=(3, 4)).on_relief(0.01 * rand(1, 3, size=(3, 4)))
        save_material(material, Path(room) / "a.glb")
        return (Path(room) / "a.glb").read_bytes()


def put_glb(folder: Path) -> Path:
    """Write a GLB of a small material with all parts that it may have."""
    (folder / "a.glb").write_bytes(_glb())
    return folder / "a.glb"


def put_mtlx(folder: Path) -> Path:
    """Write a texture set whose names say nothing beside a MaterialX document that says it all."""
    for number, name in enumerate(("one", "two", "three")):
        codes = random_codes(number, (4, 4, 3))
        codes[..., -1] = codes[..., -1] // 4 + 190
        put_image(folder / f"{name}.png", codes)
    (folder / "a.mtlx").write_text(MTLX)
    return folder


def put_volume(folder: Path) -> Path:
    codes = np.random.default_rng(0).integers(0, 256, 4 * 2 * 3 * 3, dtype=np.uint8)
    (folder / "a.3pm").write_bytes(b"VL\n#components 3\n3 2 4\n255\n" + codes.tobytes())
    return folder / "a.3pm"


def coefficients_putter(model: str, form: str, **asked: str) -> Put:
    """Return what writes a small material in a form of RTI programs."""

    def put(folder: Path) -> Path:
        material = make(model, {"space": "srgb"}, 3, 4, dtype=torch.float32)
        target = folder / f"a.{form}" if EXPORTERS[form].suffix else folder
        EXPORTERS[form].write(material, target, **asked)
        return target

    return put


@cache
def rgl(azimuths: int) -> bytes:
    return tensor_bytes(rgl_fields(azimuths))


def rgl_putter(azimuths: int) -> Put:
    def put(folder: Path) -> Path:
        (folder / "a.bsdf").write_bytes(rgl(azimuths))
        return folder / "a.bsdf"

    return put


def put_merl(folder: Path) -> Path:
    table = np.random.default_rng(0).uniform(-0.1, 5, (3, 4, 3, 6))
    (folder / "a.binary").write_bytes(merl_bytes(table))
    return folder / "a.binary"


_CONFIG = """model = "phong_srf"
holdout = 0.2
holdout_by = "pair"
seed = 3
geometry = "flat"
tiles = true
[options]
residual = "half_light"
ridge = 0.5
[data]
kind = "manifest"
crop = [0, 0, 8, 8]
exposure = 1.5
"""


def put_config(folder: Path) -> Path:
    (folder / "a.toml").write_text(_CONFIG)
    return folder / "a.toml"


def mesh_putter(kind: str) -> Put:
    def put(folder: Path) -> Path:
        path = folder / f"a.{kind.removesuffix('_ascii')}"
        normal = np.tile([0.0, 0, 1], (4, 1))
        if kind == "obj":
            return put_obj(path, SQUARE, TWO, SQUARE_UV, normal)
        if kind in ("ply", "ply_ascii"):
            return put_ply(path, SQUARE, TWO, SQUARE_UV, normal, binary=kind == "ply")
        if kind == "stl":
            return put_stl(path, SQUARE, TWO)
        if kind == "glb":
            part = {"position": SQUARE, "faces": TWO, "uv": SQUARE_UV, "normal": normal, "material": 0}
            nodes = [{"mesh": 0, "children": [1]}, {"mesh": 0, "translation": [1, 2, 3]}]
            path.write_bytes(glb_of([part], nodes, materials=[{}]))
        else:
            path.write_bytes(_TEXT_MESHES[kind])
        return path

    return put


_FACET = b"facet normal 0 0 1\nouter loop\nvertex 0 0 %d\nvertex 1 0 %d\nvertex 0 1 %d\nendloop\nendfacet\n"
_TEXT_MESHES = {
    "off": b"OFF\n4 2 0\n0 0 0\n1 0 1\n1 1 1\n0 1 0\n3 0 1 2\n3 0 2 3\n",
    "stl_ascii": b"solid a\n%s%sendsolid a\n" % (_FACET % (0, 0, 0), _FACET % (1, 1, 1)),
}


def put_gltf(folder: Path) -> Path:
    data = glb_of([{"position": SQUARE, "faces": TWO, "uv": SQUARE_UV}], [{"mesh": 0}])
    length = struct.unpack_from("<I", data, 12)[0]
    tree = json.loads(data[20 : 20 + length])
    tree["buffers"][0]["uri"] = "a.bin"
    (folder / "a.gltf").write_text(json.dumps(tree))
    (folder / "a.bin").write_bytes(data[28 + length :])
    return folder / "a.gltf"


def put_quantised(folder: Path) -> Path:
    """Write a glTF with normalised integers, a sparse accessor and a strip, its numbers in the text."""
    gltf = Gltf(extensionsRequired=["KHR_mesh_quantization"])
    sparse = {
        "count": 1, "indices": {"bufferView": gltf.view(np.array([2], "<u2")), "componentType": 5123},
        "values": {"bufferView": gltf.view(np.array([[99, 88, 77]], "<i2"))},
    }
    attributes = {
        "POSITION": gltf.accessor(SQUARE * 100, "i2", stride=8, normalized=True, sparse=sparse),
        "NORMAL": gltf.accessor(np.tile([-90, 0, 90], (4, 1)), "i1", stride=4, normalized=True),
        "TEXCOORD_0": gltf.accessor(SQUARE_UV * 65535, "u2", normalized=True),
    }
    return gltf.put(folder, attributes, gltf.accessor([1, 2, 0, 3], "u1"), mode=5)


def put_polygons(folder: Path) -> Path:
    """Write an OBJ of polygons that are not convex, told by relative numbers, with blanks and line ends of all kinds."""
    text = "v 0 0 0 0.5 0.5 0.5\nv 2 0 0\nv 2\t1 0\nv 1 1 0\nv 1 2 0\nv 0 2 0\nvt 0 0\nvt 1 0\nvn 0 0 1\n"
    text += "usemtl a\ng b\nf -4/1/1 -3/2/1 -2/1/1 -1/2/1 \\\n-6/1/1 -5/-1/-1\nf 1//1 2//1 3//1 4//1\nf 1 2 3 # end\nl 1 2\n"
    (folder / "a.obj").write_text(text)
    return folder / "a.obj"


def relief_putter(depth: str) -> Put:
    def put(folder: Path) -> Path:
        height = torch.rand(1, 4, 5, generator=torch.Generator().manual_seed(0))
        normal = torch.tensor([0.0, 0.0, 1.0])[:, None, None].expand(3, 4, 5)
        return save_relief(Relief(height, normal), folder, depth)

    return put


def put_lights(folder: Path) -> Path:
    (folder / "lights.txt").write_text("# x y z\n0 0 1\n0.6 0 0.8\n0 -0.6 0.8\n-0.6 0 0.8\n")
    return folder / "lights.txt"


def put_xyz(folder: Path) -> Path:
    write_image(folder / "a.exr", random_codes(1, (16, 16, 3), "float16"), ("X", "Y", "Z"))
    return folder / "a.exr"


def dfmf_putter(**settings: object) -> Put:
    def put(folder: Path) -> Path:
        return put_dfmf(folder / "a.btf", **settings)

    return put


def put_hdf5(folder: Path) -> Path:
    import h5py

    with h5py.File(folder / "a.h5", "w") as file:
        file["ground_light"] = np.array([[0, 0], [0.6, 0], [0, -0.6]], np.float32)
        file["ground_camera_dir"] = np.zeros((3, 2), np.float32)
        images = np.random.default_rng(0).random((3, 2, 3, 3), np.float32)
        file.create_dataset("ground_color", data=images, chunks=(1, 2, 3, 3), compression="gzip", fletcher32=True)
    return folder / "a.h5"


def put_merl_gz(folder: Path) -> Path:
    (folder / "a.binary.gz").write_bytes(gzip.compress(put_merl(folder).read_bytes(), mtime=0))
    (folder / "a.binary").unlink()
    return folder / "a.binary.gz"


def put_merl_zip(folder: Path) -> Path:
    with zipfile.ZipFile(folder / "a.zip", "w") as archive:
        archive.writestr("a.binary", put_merl(folder).read_bytes())
    (folder / "a.binary").unlink()
    return folder / "a.zip"


def put_vendors_textures(folder: Path) -> Path:
    """Write a set with packed channels, a normal map of unknown kind, a colour with alpha and a preview."""
    for number, (name, channels) in enumerate((("diff", 4), ("nor", 3), ("arm", 3), ("disp", 1))):
        codes = random_codes(number, (4, 4, channels))
        codes[..., -1] = codes[..., -1] // 4 + 190
        put_image(folder / f"wall_1_{name}_2k.png", codes)
    put_image(folder / "wall_1.png", random_codes(9, (4, 4, 3)))
    return folder


def put_stereo(folder: Path) -> Path:
    for number in range(4):
        put_image(folder / f"{number}.png", random_codes(number, (2, 3, 3)))
    put_lights(folder).rename(folder / "light_directions.txt")
    (folder / "light_intensities.txt").write_text("1 1 1\n0.5 1 2\n1 2 4\n3 3 3\n")
    (folder / "filenames.txt").write_text("0.png\n1.png\n2.png\n3.png\n")
    return folder


def put_named_lights(folder: Path) -> Path:
    (folder / "lights.csv").write_text("file;x;y;z;r;g;b\na.png;0;0;1;1;1;2\nb.png;0,6;0;0,8;1;1;2\nc d.png;0;-0,6;0,8;1;1;2\n")
    return folder / "lights.csv"


def put_textures(folder: Path) -> Path:
    for number, kind in enumerate(("Color", "NormalGL", "Roughness", "Displacement")):
        codes = random_codes(number, (4, 4, 3 if number < 2 else 1))
        codes[..., -1] = codes[..., -1] // 4 + 190
        put_image(folder / f"a_{kind}.png", codes)
    return folder
