"""MaterialX 1.39: a document beside its textures, as OpenPBR that every renderer reads, or by the lobes themselves."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import torch
from torch import Tensor

from torchmat.errors import check_option, check_positive
from torchmat.images import write_image
from torchmat.material_io.exporter import Exporter, Losses
from torchmat.material_io.materialx_nodes import SPACE, VERSION, Graph, linked, typed
from torchmat.material_io.pictures import codes_of, normal_codes, values_of
from torchmat.material_io.renderer_form import COATED, losses_of_form, microfacet_form, microfacet_of
from torchmat.models import Material, Microfacet
from torchmat.models.ggx import usual_f90
from torchmat.models.renderers import DIELECTRIC, alphas_of_openpbr, as_openpbr

FORMS = ("portable", "closest")
DOCUMENT = "material.mtlx"
_DIMMED = "renderers dim it by what the specular part reflects"
_COMPENSATED = "renderers may add what light loses between facets"


def write_materialx(material: Material, path: Path, *, form: str = "portable", depth: int = 16, width: float = 1.0) -> Losses:
    """Write ``material.mtlx`` and its textures into an empty folder; return what it does not hold.

    Args:
        form: "portable" is one `open_pbr_surface`; "closest" adds a diffuse and Schlick's GGX lobe as the model does, for
            renderers that take graphs of BSDFs.
        depth: bits a channel of what lies in [0, 1], 8 or 16; F0 beyond that is a half float.
        width: width of the texture in units of the scene, by which the height is scaled.
    """
    check_option("export to materialx", "form", form, FORMS)
    check_positive("export to materialx", "width", width)
    maps = microfacet_form(material)
    document = _Document(material, maps, path, depth, width)
    held = document.portable() if form == "portable" else document.closest()
    document.close()
    lost = {"rolloff": "it has no place there", "layered": "renderers have their own way"}
    told = {"diffuse": _DIMMED} if form == "portable" and "layered" not in maps.options["parts"] else {}
    if form == "portable":
        told |= {"coat": COATED} if "coat" in maps.maps else {}
        lost["f90"] = "it has no place there"
    else:
        told = {"specular_f0": _COMPENSATED}
    extra = {"height": document.height} if document.height is not None else {}
    return losses_of_form(material, maps, microfacet_of(held, material), lost, told, extra)


class _Document:
    """A document that is being made, with the folder that its textures go to."""

    def __init__(self, material: Material, form: Microfacet, path: Path, depth: int, width: float) -> None:
        self.material, self.form, self.path, self.depth, self.width = material, form, path, depth, width
        self.maps = {name: value.detach() for name, value in form.maps.items()}
        self.root = ElementTree.Element("materialx", {"version": VERSION, "colorspace": SPACE})
        self.graph = Graph(self.root, material.tiles)
        self.height: Tensor | None = None
        self.held: dict[str, Tensor] = {}

    def _colour(self, name: str, values: Tensor, factor: float = 1.0) -> Tensor:
        """Add a colour as an output: sRGB codes where it lies in [0, 1], else half floats; return what it holds."""
        if float(values.max()) <= 1:
            codes = codes_of(values, self.depth, coded=True)
            file, found = f"{name}.png", values_of(codes, coded=True)
        else:
            codes = values.movedim(0, -1).contiguous().numpy().astype(np.float16)
            file, found = f"{name}.exr", values_of(codes)
        write_image(self.path / file, codes)
        self.graph.output(name, "color3", self.graph.image(name, file, "color3", coloured=file.endswith("png")))
        return found * factor

    def _grey(self, name: str, values: Tensor) -> Tensor:
        codes = codes_of(values, self.depth)
        write_image(self.path / f"{name}.png", codes)
        self.graph.output(name, "float", self.graph.image(name, f"{name}.png", "float"))
        return values_of(codes)

    def _shape(self, node_of: Callable[[str, str, str], None]) -> None:
        """Add the normal and the turned tangent, and link them by `node_of(map, kind, output)`."""
        if "normal" in self.maps:
            codes = normal_codes(self.maps["normal"], self.depth)
            write_image(self.path / "normal.png", codes)
            self.graph.output("normal", "vector3", self.graph.normal("normal.png"))
            self.held["normal"] = values_of(codes) * 2 - 1
            node_of("normal", "vector3", "normal")
        if "rotation" in self.maps:
            turn = torch.cat((self.maps["rotation"], torch.zeros_like(self.maps["rotation"][:1])))
            codes = codes_of(turn / 2 + 0.5, self.depth)
            write_image(self.path / "rotation.png", codes)
            self.graph.output("tangent", "vector3", self.graph.tangent("rotation.png"))
            self.held["rotation"] = values_of(codes)[:2] * 2 - 1
            node_of("tangent", "vector3", "tangent")

    def portable(self) -> dict[str, Tensor]:
        """Write an `open_pbr_surface`; return the maps that it holds."""
        found, maps = as_openpbr(self.form), self.maps
        shader = ElementTree.Element("open_pbr_surface", {"name": "surface", "type": "surfaceshader"})
        self.held |= {"diffuse": self._colour("base_color", found.base_colour.clamp(max=1))}
        linked(shader, "base_color", "color3", "base_color")
        f0 = self._colour("specular_color", found.specular_colour, DIELECTRIC)
        self.held["specular_f0"] = f0.clamp(max=1)
        linked(shader, "specular_color", "color3", "specular_color")
        rough = self._grey("specular_roughness", found.specular_roughness)
        linked(shader, "specular_roughness", "float", "specular_roughness")
        self.held["roughness"] = rough
        if "rotation" in maps:
            anisotropy = self._grey("specular_roughness_anisotropy", found.specular_roughness_anisotropy)
            linked(shader, "specular_roughness_anisotropy", "float", "specular_roughness_anisotropy")
            self.held["roughness"] = alphas_of_openpbr(rough, anisotropy).clamp(0, 1).sqrt()
        typed(shader, "specular_ior", "float", 1.5)
        self._shape(lambda name, kind, output: linked(shader, f"geometry_{name}", kind, output))
        if "coat" in maps:
            coat = self._grey("coat_weight", maps["coat"] / DIELECTRIC) * DIELECTRIC
            self.held |= {"coat": coat, "coat_roughness": self._grey("coat_roughness", maps["coat_roughness"])}
            for name in ("coat_weight", "coat_roughness"):
                linked(shader, name, "float", name)
            typed(shader, "coat_ior", "float", 1.5)
            typed(shader, "coat_darkening", "float", 0.0)
        if "sheen" in maps:
            self.held |= {"sheen": self._colour("fuzz_color", maps["sheen"].clamp(max=1)), "sheen_roughness": maps["sheen_roughness"]}
            linked(shader, "fuzz_color", "color3", "fuzz_color")
            typed(shader, "fuzz_weight", "float", 1.0)
            typed(shader, "fuzz_roughness", "float", float(maps["sheen_roughness"]))
        self._opacity(shader, "geometry_opacity")
        self.root.append(shader)
        return self.held

    def closest(self) -> dict[str, Tensor]:
        """Write a `surface` whose BSDF is the sum of the lobes; return the maps that it holds."""
        maps, root = self.maps, self.root
        sides: dict[str, str] = {}
        self._shape(lambda name, kind, output: sides.__setitem__(name, output))
        bsdfs = []

        def bsdf(category: str, name: str, tangent: bool = False) -> ElementTree.Element:
            node = ElementTree.Element(category, {"name": name, "type": "BSDF"})
            for side in ("normal", "tangent") if tangent else ("normal",):
                if side in sides:
                    linked(node, side, "vector3", sides[side])
            bsdfs.append(node)
            return node

        diffuse = bsdf("oren_nayar_diffuse_bsdf", "diffuse")
        self.held["diffuse"] = self._colour("diffuse_color", maps["diffuse"])
        linked(diffuse, "color", "color3", "diffuse_color")
        lobe = bsdf("generalized_schlick_bsdf", "specular", tangent=True)
        self.held["specular_f0"] = self._colour("specular_color0", maps["specular_f0"])
        linked(lobe, "color0", "color3", "specular_color0")
        f90 = usual_f90(maps["specular_f0"]) * maps.get("f90", torch.ones(1))
        f90 = self._colour("specular_color90", f90.expand(3, -1, -1))[:1]
        linked(lobe, "color90", "color3", "specular_color90")
        if "f90" in maps:
            self.held["f90"] = (f90 / usual_f90(self.held["specular_f0"]).clamp(min=1e-6)).clamp(0, 1)
        typed(lobe, "exponent", "float", 5.0)
        self.held["roughness"] = self._alphas(lobe, "specular", maps["roughness"])
        if "coat" in maps:
            coat = bsdf("generalized_schlick_bsdf", "coat")
            self.held["coat"] = self._colour("coat_color0", maps["coat"].expand(3, -1, -1))[:1]
            linked(coat, "color0", "color3", "coat_color0")
            self._colour("coat_color90", usual_f90(maps["coat"]).expand(3, -1, -1))
            linked(coat, "color90", "color3", "coat_color90")
            self.held["coat_roughness"] = self._alphas(coat, "coat", maps["coat_roughness"])
        if "sheen" in maps:
            sheen = bsdf("sheen_bsdf", "sheen")
            self.held |= {"sheen": self._colour("sheen_color", maps["sheen"]), "sheen_roughness": maps["sheen_roughness"]}
            linked(sheen, "color", "color3", "sheen_color")
            typed(sheen, "roughness", "float", float(maps["sheen_roughness"]))
        self._sum(bsdfs)
        shader = ElementTree.SubElement(root, "surface", {"name": "surface", "type": "surfaceshader"})
        typed(shader, "bsdf", "BSDF", nodename=f"sum_{len(bsdfs) - 1}")
        self._opacity(shader, "opacity")
        return self.held

    def _alphas(self, node: ElementTree.Element, name: str, roughness: Tensor) -> Tensor:
        """Link a lobe's two alphas, the squares of a picture of roughness; return the roughness that it holds."""
        both = torch.cat((roughness.expand(2, -1, -1) if len(roughness) == 1 else roughness, torch.zeros_like(roughness[:1])))
        codes = codes_of(both, self.depth)
        write_image(self.path / f"{name}_roughness.png", codes)
        root = self.graph.image(f"{name}_roughness", f"{name}_roughness.png", "vector3")
        square = self.graph.binary("multiply", f"{name}_alphas", "vector3", root, root)
        two = self.graph.node("convert", f"{name}_alpha", "vector2")
        typed(two, "in", "vector3", nodename=square)
        self.graph.output(f"{name}_roughness", "vector2", f"{name}_alpha")
        linked(node, "roughness", "vector2", f"{name}_roughness")
        return values_of(codes)[: len(roughness)]

    def _sum(self, bsdfs: list[ElementTree.Element]) -> None:
        self.root.extend(bsdfs)
        last = bsdfs[0].get("name", "")
        for number, one in enumerate(bsdfs[1:], 1):
            node = ElementTree.SubElement(self.root, "add", {"name": f"sum_{number}", "type": "BSDF"})
            typed(node, "in1", "BSDF", nodename=last)
            typed(node, "in2", "BSDF", nodename=one.get("name", ""))
            last = f"sum_{number}"

    def _opacity(self, shader: ElementTree.Element, name: str) -> None:
        if "opacity" in self.maps:
            self.held["opacity"] = self._grey("opacity", self.maps["opacity"])
            linked(shader, name, "float", "opacity")

    def close(self) -> None:
        """Add displacement and material, and write the document."""
        if "height" in self.material.maps:
            height = self.material.maps["height"].detach().float()
            low, high = float(height.min()), float(height.max())
            codes = codes_of((height - low) / max(high - low, 1e-30), 16)
            write_image(self.path / "height.png", codes)
            self.height = low + values_of(codes) * (high - low)
            image = self.graph.image("height", "height.png", "float")
            scaled = self.graph.binary("multiply", "height_range", "float", image, high - low)
            self.graph.output("height", "float", self.graph.binary("add", "height_value", "float", scaled, low))
            node = ElementTree.SubElement(self.root, "displacement", {"name": "relief", "type": "displacementshader"})
            linked(node, "displacement", "float", "height")
            typed(node, "scale", "float", self.width)
        material = ElementTree.SubElement(self.root, "surfacematerial", {"name": "material", "type": "material"})
        typed(material, "surfaceshader", "surfaceshader", nodename="surface")
        if self.height is not None:
            typed(material, "displacementshader", "displacementshader", nodename="relief")
        self.graph.close()
        ElementTree.indent(self.root)
        ElementTree.ElementTree(self.root).write(self.path / DOCUMENT, encoding="utf-8", xml_declaration=True)


MATERIALX = Exporter(
    "materialx", "a MaterialX document and its textures: OpenPBR, or the model's own lobes (form)", write_materialx,
)
