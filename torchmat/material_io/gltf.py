"""glTF 2.0 as one GLB: the maps of renderers with KHR_materials_specular, ior, anisotropy, clearcoat and sheen, on any mesh."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch

from torchmat import safe
from torchmat.errors import RangeError, message
from torchmat.machine import package_version
from torchmat.material_io.as_microfacet import as_microfacet
from torchmat.material_io.exporter import Exporter, Losses
from torchmat.material_io.glb import SUFFIX, Buffer, write_glb
from torchmat.material_io.gltf_material import MAP_OF_HEIGHT, material_of
from torchmat.material_io.pictures import codes_of, normal_codes, png_bytes
from torchmat.material_io.renderer_form import COATED, losses_of_form, microfacet_form
from torchmat.mesh_arrays import is_mesh
from torchmat.models import Material, Microfacet
from torchmat.models.renderers import DIELECTRIC, Gltf, as_gltf

_VERTICES, _INDICES = 34962, 34963
_REPEAT, _CLAMP, _LINEAR, _MIPMAPS = 10497, 33071, 9729, 9987
_DIMMED = "renderers dim it by what the specular part reflects"


def write_gltf(material: Material, path: Path, *, mesh: Any = "quad", depth: int = 16) -> Losses:
    """Write the GLB `path`: a mesh that shows the material; return what reading it does not bring back.

    Args:
        mesh: "quad", the unit square that faces +z, or a mesh (`torchmat.rendering.load_mesh`, `make_mesh`).
        depth: bits a channel of its PNG textures, 8 or 16; viewers may round to 8.
    """
    form = microfacet_form(material)
    buffer, maps = Buffer(), _at_normal_first(as_gltf(form), form)
    tree = _with_mesh(buffer, mesh)
    tree |= _Textures(buffer, material, form, maps, depth).written()
    write_glb(path, tree, buffer)
    return _losses(material, form, path)


def _at_normal_first(maps: Gltf, form: Microfacet) -> Gltf:
    """Return the maps with F0 kept where it is above F90, which glTF's `specular` bounds: the lobe is seen by it."""
    f0 = form.maps["specular_f0"].detach()
    weight = torch.maximum(maps.specular, f0.amax(dim=0, keepdim=True)).clamp(max=1)
    return maps._replace(specular=weight, specular_colour=safe.divide(f0, DIELECTRIC * weight))


def _losses(material: Material, form: Microfacet, path: Path) -> Losses:
    held = material_of(path)
    extra = {"height": held.maps["height"].detach()} if "height" in held.maps else {}
    lost = {"rolloff": "it has no place there", "layered": "renderers have their own way"}
    told = {} if "layered" in form.options["parts"] else {"diffuse": _DIMMED}
    told |= {"coat": COATED} if "coat" in form.maps else {}
    if "f90" in form.maps and "f90" not in held.maps:
        lost["f90"] = "it is not below what F0 needs"
    return losses_of_form(material, form, held if not held.has_relief else as_microfacet(held), lost, told, extra)


def _with_mesh(buffer: Buffer, mesh: Any) -> dict[str, Any]:
    """Return the tree of a scene of one mesh, whose numbers go into the buffer."""
    if isinstance(mesh, str) and mesh == "quad":
        position = np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [-0.5, 0.5, 0], [0.5, 0.5, 0]], np.float32)
        normal, tangent = (np.tile(np.array(one, np.float32), (4, 1)) for one in ([0, 0, 1], [1, 0, 0, 1]))
        uv, faces = np.array([[0, 1], [1, 1], [0, 0], [1, 0]], np.float32), np.array([0, 1, 3, 0, 3, 2])
        name = "quad"
    elif is_mesh(mesh):
        position, normal, uv = (np.array(getattr(mesh, part).numpy(), np.float32) for part in ("position", "normal", "uv"))
        tangent = np.concatenate((mesh.tangent.numpy(), mesh.handedness.numpy()[:, None]), axis=1).astype(np.float32)
        uv[:, 1] = 1 - uv[:, 1]  # v runs down in glTF
        faces, name = mesh.faces.numpy().reshape(-1), str(getattr(mesh, "name", "mesh"))
    else:
        step = "Give torchmat.rendering.load_mesh(path), or make_mesh('teapot')."
        raise RangeError(message("export to gltf", "mesh", "be 'quad' or a mesh", f"it is {mesh!r:.60}", step))
    attributes = {
        "POSITION": buffer.add_array(position, _VERTICES, bounds=True), "NORMAL": buffer.add_array(_unit(normal), _VERTICES),
        "TANGENT": buffer.add_array(np.concatenate((_unit(tangent[:, :3]), tangent[:, 3:]), axis=1), _VERTICES),
        "TEXCOORD_0": buffer.add_array(uv, _VERTICES),
    }
    kind = np.uint16 if len(position) < 65535 else np.uint32  # the largest number restarts a strip
    indices = buffer.add_array(faces.astype(kind), _INDICES)
    return {
        "asset": {"version": "2.0", "generator": f"torchmat {package_version()}"}, "scene": 0, "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": name}],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": indices, "material": 0}]}],
    }


def _unit(vectors: np.ndarray) -> np.ndarray:
    wide = vectors.astype(np.float64)
    return (wide / np.maximum(np.linalg.norm(wide, axis=1, keepdims=True), 1e-30)).astype(np.float32)


class _Textures:
    """The material of a tree, whose textures are put into the buffer one by one."""

    def __init__(self, buffer: Buffer, material: Material, form: Microfacet, maps: Gltf, depth: int) -> None:
        self.buffer, self.material, self.form, self.maps, self.depth = buffer, material, form, maps, depth
        self.images: list[dict[str, Any]] = []
        self.used: set[str] = set()

    def _texture(self, name: str, codes: np.ndarray) -> dict[str, Any]:
        view = self.buffer.add_bytes(png_bytes(codes))
        self.images.append({"bufferView": view, "mimeType": "image/png", "name": name})
        return {"index": len(self.images) - 1}

    def written(self) -> dict[str, Any]:
        """Return the parts of the tree."""
        maps, none = self.maps, torch.zeros_like(self.maps.roughness)
        described: dict[str, Any] = {"name": "material", **self._base()}
        rough = codes_of(torch.cat((none, maps.roughness, none)), self.depth)
        described["pbrMetallicRoughness"] |= {
            "metallicFactor": 0.0, "roughnessFactor": 1.0, "metallicRoughnessTexture": self._texture("roughness", rough),
        }
        if maps.normal is not None:
            described["normalTexture"] = self._texture("normal", normal_codes(maps.normal, self.depth))
        described["extensions"] = {f"KHR_materials_{name}": one for name, one in self._extensions().items()}
        extras = self._extras()
        if extras:
            described["extras"] = {"torchmat": extras}
        wrap = _REPEAT if self.material.tiles else _CLAMP
        sampler = {"magFilter": _LINEAR, "minFilter": _MIPMAPS, "wrapS": wrap, "wrapT": wrap}
        textures = [{"sampler": 0, "source": number} for number in range(len(self.images))]
        return {
            "extensionsUsed": sorted(described["extensions"]), "materials": [described], "images": self.images,
            "samplers": [sampler], "textures": textures,
        }

    def _base(self) -> dict[str, Any]:
        planes, mode = [self.maps.base_colour], dict[str, Any]()
        if "opacity" in self.form.maps:
            opacity = self.form.maps["opacity"].detach()
            planes.append(opacity)
            hard = bool(((opacity == 0) | (opacity == 1)).all())
            mode = {"alphaMode": "MASK", "alphaCutoff": 0.5} if hard else {"alphaMode": "BLEND"}
        codes = codes_of(torch.cat(planes), self.depth, coded=True)
        return {"pbrMetallicRoughness": {"baseColorTexture": self._texture("base colour", codes)}, **mode}

    def _extensions(self) -> dict[str, dict[str, Any]]:
        maps = self.maps
        most = maps.specular_colour.amax(dim=(1, 2)).clamp(min=1e-6)
        codes = codes_of(torch.cat((maps.specular_colour / most[:, None, None], maps.specular)), self.depth, coded=True)
        both = self._texture("specular colour, and specular as alpha", codes)
        found: dict[str, dict[str, Any]] = {
            "ior": {"ior": 1.5},
            "specular": {"specularTexture": both, "specularColorTexture": dict(both), "specularColorFactor": most.tolist()},
        }
        if maps.anisotropy is not None and maps.direction is not None:
            direction = torch.cat((maps.direction / 2 + 0.5, maps.anisotropy))
            found["anisotropy"] = {"anisotropyStrength": 1.0, "anisotropyTexture": self._texture("anisotropy", codes_of(direction, self.depth))}
        if maps.clearcoat is not None and maps.clearcoat_roughness is not None:
            most_coat = min(1.0, float(maps.clearcoat.max()))
            red = maps.clearcoat / max(most_coat, 1e-6)
            planes = torch.cat((red, maps.clearcoat_roughness, torch.zeros_like(red)))
            coat = self._texture("clearcoat and its roughness", codes_of(planes, self.depth))
            found["clearcoat"] = {
                "clearcoatFactor": most_coat, "clearcoatTexture": coat, "clearcoatRoughnessFactor": 1.0,
                "clearcoatRoughnessTexture": dict(coat),
            }
        if maps.sheen_colour is not None and maps.sheen_roughness is not None:
            most_sheen = maps.sheen_colour.amax(dim=(1, 2)).clamp(1e-6, 1)
            codes = codes_of(maps.sheen_colour / most_sheen[:, None, None], self.depth, coded=True)
            found["sheen"] = {
                "sheenColorFactor": most_sheen.tolist(), "sheenColorTexture": self._texture("sheen", codes),
                "sheenRoughnessFactor": float(maps.sheen_roughness),
            }
        return found

    def _extras(self) -> dict[str, Any]:
        """Return what glTF has no place for and readers of torchmat understand."""
        found: dict[str, Any] = {}
        if "height" in self.material.maps:
            height = self.material.maps["height"].detach().float()
            low, high = float(height.min()), float(height.max())
            codes = codes_of((height - low) / max(high - low, 1e-30), 16)
            found[MAP_OF_HEIGHT] = {**self._texture("height", codes), "low": low, "high": high, "unit": "texture widths"}
        return found


GLTF = Exporter(
    "gltf", "glTF 2.0 (GLB) with specular, anisotropy, clearcoat and sheen, on a quad or any mesh", write_gltf, SUFFIX,
)
