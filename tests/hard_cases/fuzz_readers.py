"""Everything that reads a file: from what good files, how, and what must hold of whatever is read."""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import torch
from tests.btf.files import directions_of
from tests.hard_cases.fuzz_inputs import (
    Put, coefficients_putter, dfmf_putter, image_putter, material_putter, mesh_putter, named_putter, put_cached, put_config,
    put_distribution, put_glb, put_gltf, put_hdf5, put_lights, put_manifest, put_merl, put_merl_gz, put_merl_zip, put_mtlx,
    put_named_lights, put_packed, put_polygons,
    put_quantised, put_rti, put_small, put_stereo, put_textures, put_vendors_textures, put_volume, put_xyz, put_zip,
    relief_putter, rgl_putter,
)
from tests.rendering.mesh_files import assert_frames_hold

import torchmat as tm
from torchmat.btf.light_table import read_light_table, read_lights
from torchmat.btf.photographs import read_linear
from torchmat.errors import Notice
from torchmat.create.textures import find_textures, read_textures
from torchmat.fitting.config import FitConfig, load_config
from torchmat.geometry.height_file import load_height
from torchmat.material_io.folder import check_target
from torchmat.material_io.packing import unpack
from torchmat.rendering.lights import environment_lights
from torchmat.rendering.mesh import load_mesh


@dataclass(frozen=True)
class Reader:
    """One way to read files.

    `put` writes a good input into an empty folder and returns what to read. `read` reads it, asserts what must hold,
    and returns tensors and texts that tell one result from another. Files whose names end in one of `mutable` are
    changed. A change in one of the `exact` ways may be refused, but must never change the result.
    What `heals` is never refused. An error may name the key instead of the file (`names_key`). With `by_name` the names
    of files say something, and half of the changes are made to them.
    """

    name: str
    put: Put
    read: Callable[[Path], list[Any]]
    mutable: tuple[str, ...] = ("",)
    exact: tuple[str, ...] = ()
    heals: bool = False
    names_key: bool = False
    by_name: bool = False


def digest(found: list[Any]) -> str:
    """Return what tells two results apart."""
    parts = hashlib.sha256()
    for value in found:
        if isinstance(value, torch.Tensor):
            parts.update(f"{tuple(value.shape)}{value.dtype}".encode() + value.detach().contiguous().numpy().tobytes())
        else:
            parts.update(repr(value).encode())
    return parts.hexdigest()


def _finite(*values: torch.Tensor) -> None:
    for value in values:
        assert value.numel() > 0 and bool(torch.isfinite(value).all()), "not finite"


def _unit(directions: torch.Tensor) -> None:
    _finite(directions)
    assert float((directions.norm(dim=-1) - 1).abs().max()) < 1e-5, "not unit"


def _sound_btf(path: Path) -> tm.Btf:
    btf = tm.load_btf(path, cache=False, invalid="mask")
    images = btf.images(range(len(btf)))
    _finite(images, btf.weights(range(len(btf))))
    _unit(btf.light)
    _unit(btf.view)
    assert images.shape == (len(btf), 3, btf.height, btf.width) and len(btf.source.files) == len(btf)
    assert float(btf.light[:, 2].min()) > -1e-6 and float(btf.view[:, 2].min()) > 0, "below the surface"
    return btf


def _read_btf(path: Path) -> list[Any]:
    btf = _sound_btf(path)
    return [btf.images(range(len(btf))), btf.light, btf.view]


def _read_named(path: Path) -> list[Any]:
    """Read a BTF whose names hold its angles, and hold its directions against the three digits behind each mark."""
    btf = _sound_btf(path)
    for number, name in enumerate(btf.source.files):
        after = {mark: name.lower().split(mark) for mark in ("tl", "pl", "tv", "pv")}
        if any(len(parts) != 2 for parts in after.values()):
            continue  # two of a kind: which of them counts is the reader's to say
        angles = [int(parts[1][:3]) for parts in after.values()]
        wanted = torch.tensor([*directions_of(*angles[:2]), *directions_of(*angles[2:])])
        found = torch.cat((btf.light[number], btf.view[number])).double()
        assert float((found - wanted).abs().max()) < 1e-6, "the name says another direction"
    return [btf.images(range(len(btf))), btf.light, btf.view]


def _read_image(path: Path) -> list[Any]:
    picture = read_linear(path)
    assert picture.ndim == 3 and picture.shape[0] == 3 and picture.numel() > 0
    return [picture]


def _read_environment(path: Path) -> list[Any]:
    lights = environment_lights(read_linear(path), 4)
    for light in lights:
        _unit(torch.as_tensor(light.direction))
        _finite(torch.as_tensor(light.intensity))
    return [light.intensity for light in lights]


def _sound(material: tm.Material) -> list[Any]:
    up = torch.tensor([0.0, 0.0, 1.0])[:, None, None]
    aslant = torch.tensor([0.48, 0.36, 0.8])[:, None, None]
    _finite(*(value for value in material.maps.values()))
    assert min(material.size) >= 1
    with torch.no_grad():
        values = material.shade(aslant, up)
    assert not bool(torch.isnan(values).any()) and float(values.min()) >= 0, "shades to NaN or below 0"
    return [material.name, material.options, *(material.maps[name] for name in sorted(material.maps)), values]


def _read_material(path: Path) -> list[Any]:
    try:
        check_target(path)
    except tm.TorchmatError:
        pass  # a folder that is no material any more may be refused or not, but in the package's own words
    return _sound(tm.load_material(path))


def _read_glb(path: Path) -> list[Any]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", Notice)  # of parts that have another name after the change, and no place
        return _sound(tm.load_material(path))


def _read_brdf(path: Path) -> list[Any]:
    brdf = tm.load_brdf(path)
    light = torch.tensor([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8], [-0.48, 0.6, 0.64]])[:, :, None, None]
    with torch.no_grad():
        values = brdf.shade(light, torch.tensor([0.36, 0.48, 0.8])[:, None, None])
    assert not bool(torch.isnan(values).any()) and float(values.min()) >= 0, "shades to NaN or below 0"
    return [values]


def _read_mesh(path: Path) -> list[Any]:
    mesh = load_mesh(path)
    assert_frames_hold(mesh)
    return [mesh.position, mesh.faces, mesh.normal, mesh.uv, mesh.tangent]


def _read_config(path: Path) -> list[Any]:
    config = load_config(path)
    assert isinstance(config, FitConfig)
    return [config]


def _read_height(path: Path) -> list[Any]:
    height = load_height(path)
    assert height.ndim == 3 and height.shape[0] == 1
    _finite(height)
    return [height]


def _read_light_table(path: Path) -> list[Any]:
    table = read_light_table(path)
    found = [table.light] + ([] if table.intensity is None else [table.intensity])
    _finite(*found)
    assert len(table.light) == len(table.where) and (table.names is None or len(table.names) == len(table.light))
    return [*found, table.names]


def _read_lights(path: Path) -> list[Any]:
    light = read_lights(path, 4)
    assert light.shape == (4, 3)
    _unit(light)
    return [light]


def _read_textures(path: Path) -> list[Any]:
    textures = read_textures(find_textures(path))
    _finite(*textures.values())
    if "normal" in textures:
        _unit(textures["normal"].movedim(0, -1))
    return [textures[kind] for kind in sorted(textures)]


def _read_cached(folder: Path) -> list[Any]:
    btf = tm.load_btf(folder / "btf", cache=folder / "cache", invalid="mask")
    every = range(len(btf))
    return [btf.images(every), btf.weights(every), btf.light, btf.view, btf.source.files, btf.encoding, btf.source.kind]


_IMAGES = {
    "png": ("png", "uint8"), "png16": ("png", "uint16"), "grey png": ("png", "uint8", 1), "jpeg": ("jpg", "uint8"),
    "exr": ("exr", "float16"), "float exr": ("exr", "float32"), "tiff": ("tif", "uint8"), "tiff16": ("tif", "uint16"),
    "hdr": ("hdr", "float32"), "bmp": ("bmp", "uint8"), "tga": ("tga", "uint8"), "ppm": ("ppm", "uint8"),
}
_CHECKED = ("cut", "flip")  # formats with checksums notice both
_MATERIALS = {
    "png8": material_putter("lambert", {}, "png8"),
    "half": material_putter("phong_srf", {"residual": "half", "base": "phong"}, "half"),
    "tiff16": material_putter("ptm", {}, "tiff16"),
    "local_pca": material_putter("local_pca", {"clusters": 3, "components": 2}, "png16"),
    "stored small": put_small,
    "distribution": put_distribution,
    "shading map": material_putter("shading_map", {"slices": 4, "brdf": "phong"}, "half"),
    "sphere": material_putter("sphere_images", {"angles_deg": [0.0, 45.0, 90.0]}, "half"),
}
READERS = [
    Reader("manifest.csv", put_manifest, _read_btf, ("manifest.csv",)),
    Reader(".lp", put_rti, _read_btf, (".lp",)),
    Reader("UBO2003 names", named_putter("00081 tl%03d pl%03d tv%03d pv%03d.jpg"), _read_named, by_name=True),
    Reader("UTIA names", named_putter("tl%03d_pl%03d_tv%03d_pv%03d.png"), _read_named, by_name=True),
    Reader("zip, manifest", put_zip, _read_btf, exact=("cut", "flip")),
    Reader("zip, .lp", lambda folder: put_zip(folder, put_rti), _read_btf, exact=("cut", "flip")),
    Reader("store in the cache", put_cached, _read_cached, ("header.json", ".npz", ".raw"), heals=True),
    *[
        Reader(f"image, {name}", image_putter(*form), _read_image, exact=_CHECKED if "png" in name else ("cut",))
        for name, form in _IMAGES.items()
    ],
    Reader("image, XYZ exr", put_xyz, _read_image, exact=("cut",)),
    Reader("environment picture", image_putter("hdr", "float32"), _read_environment),
    *[Reader(f"material, {name}", put, _read_material, exact=("cut",)) for name, put in _MATERIALS.items()],
    Reader("packed material", put_packed, lambda path: _sound(unpack(path)), exact=("cut",)),
    Reader(".3pm", put_volume, _read_material, exact=("cut",)),
    Reader(".glb as a material", put_glb, _read_glb, exact=("cut",)),
    Reader(".ptm", coefficients_putter("ptm", "ptm"), _read_material, exact=("cut",)),
    Reader(".ptm, LRGB", coefficients_putter("lptm", "ptm"), _read_material, exact=("cut",)),
    Reader(".rti", coefficients_putter("hsh", "rti"), _read_material, exact=("cut",)),
    Reader("relight folder", coefficients_putter("hsh", "relight", image="png"), _read_material, exact=("cut",)),
    Reader(".bsdf, isotropic", rgl_putter(1), _read_brdf, exact=("cut",)),
    Reader(".bsdf, anisotropic", rgl_putter(5), _read_brdf, exact=("cut",)),
    Reader("MERL .binary", put_merl, _read_brdf, exact=("cut",)),
    Reader("MERL .binary.gz", put_merl_gz, _read_brdf, exact=_CHECKED),
    Reader("MERL, zip", put_merl_zip, _read_brdf, exact=_CHECKED),
    Reader("MERL as a BTF", put_merl, _read_btf, exact=("cut",)),
    Reader(".bsdf as a BTF", rgl_putter(5), _read_btf, exact=("cut",)),
    Reader("UBO2014 .btf", dfmf_putter(scalar=4), _read_btf, exact=("cut",)),
    Reader("UBO2014 .btf, logarithms", dfmf_putter(scalar=2, model=11, cosine=False, by_images=True), _read_btf, exact=("cut",)),
    *([Reader("NeuralBTF .h5", put_hdf5, _read_btf, exact=("cut",))] if find_spec("h5py") else []),
    Reader("config", put_config, _read_config, names_key=True),
    *[Reader(f"mesh, {kind}", mesh_putter(kind), _read_mesh, exact=("cut",) if kind in ("ply", "stl", "glb") else ())
      for kind in ("obj", "ply", "ply_ascii", "stl", "stl_ascii", "glb", "off")],
    Reader("mesh, gltf", put_gltf, _read_mesh),
    Reader("mesh, quantised gltf", put_quantised, _read_mesh),
    Reader("mesh, polygons of an obj", put_polygons, _read_mesh),
    Reader("height, folder", relief_putter("16"), _read_height, ("relief.json", "height.png"), ("cut",)),
    Reader("height, float", image_putter("exr", "float32", 1), _read_height, exact=("cut",)),
    Reader("light directions", put_lights, _read_lights),
    Reader("light directions, CSV", put_named_lights, _read_light_table),
    Reader("light_directions.txt", put_stereo, _read_btf, (".txt",)),
    Reader("texture set", put_textures, _read_textures, exact=_CHECKED),
    Reader("texture set, MaterialX", put_mtlx, _read_textures, (".mtlx",)),
    Reader("texture set, packed", put_vendors_textures, _read_textures, by_name=True),
]
BY_NAME = {reader.name: reader for reader in READERS}
