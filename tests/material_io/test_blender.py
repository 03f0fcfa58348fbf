"""The script for Blender: it runs against a stand-in for Blender's module that knows its nodes and sockets by name."""

from __future__ import annotations

import sys
import types

import pytest
from tests.material_io.forms import microfacet, rand

import torchmat as tm
from torchmat import RangeError
from torchmat.material_io.blender import SCRIPT

# Sockets by node, as the manual of Blender 4.2 lists them.
NODES = {
    "ShaderNodeBsdfPrincipled": (
        "Base Color|Metallic|Roughness|IOR|Alpha|Normal|Weight|Subsurface Weight|Specular IOR Level|Specular Tint|Anisotropic|"
        "Anisotropic Rotation|Tangent|Transmission Weight|Coat Weight|Coat Roughness|Coat IOR|Coat Tint|Coat Normal|Sheen Weight|"
        "Sheen Roughness|Sheen Tint|Emission Color|Emission Strength", "BSDF",
    ),
    "ShaderNodeTexImage": ("Vector", "Color|Alpha"), "ShaderNodeNormalMap": ("Strength|Color", "Normal"),
    "ShaderNodeMath": ("Value|Value|Value", "Value"), "ShaderNodeSeparateColor": ("Color", "Red|Green|Blue"),
    "ShaderNodeTangent": ("", "Tangent"), "ShaderNodeVectorRotate": ("Vector|Center|Axis|Angle|Rotation", "Vector"),
    "ShaderNodeNewGeometry": ("", "Position|Normal|Tangent|True Normal|Incoming|Parametric|Backfacing|Pointiness|Random Per Island"),
    "ShaderNodeDisplacement": ("Height|Midlevel|Scale|Normal", "Displacement"), "NodeGroupOutput": ("BSDF|Displacement", ""),
    "ShaderNodeBsdfDiffuse": ("Color|Roughness|Normal|Weight", "BSDF"), "ShaderNodeBsdfTransparent": ("Color|Weight", "BSDF"),
    "ShaderNodeAddShader": ("Shader|Shader", "Shader"), "ShaderNodeMixShader": ("Fac|Shader|Shader", "Shader"),
    "ShaderNodeGroup": ("", "BSDF|Displacement"), "ShaderNodeOutputMaterial": ("Surface|Volume|Displacement|Thickness", ""),
}
SETTINGS = {
    "ShaderNodeTexImage": {"image", "label", "extension"}, "ShaderNodeMath": {"operation"}, "ShaderNodeTangent": {"direction_type"},
    "ShaderNodeVectorRotate": {"rotation_type"}, "ShaderNodeGroup": {"node_tree"}, "ShaderNodeBsdfPrincipled": {"distribution"},
}


class Sockets(list):
    """Sockets by number and by name, as Blender's collections have them."""

    def __getitem__(self, key):
        return next(one for one in self if one.name == key) if isinstance(key, str) else super().__getitem__(key)


class Node:
    def __init__(self, kind):
        names = [part.split("|") if part else [] for part in NODES[kind]]
        make = lambda found, out: Sockets(types.SimpleNamespace(name=name, node=self, out=out, default_value=None) for name in found)  # noqa: E731
        self.__dict__.update(dict.fromkeys(SETTINGS.get(kind, ())))
        self.__dict__.update(kind=kind, inputs=make(names[0], False), outputs=make(names[1], True), location=None)

    def __setattr__(self, name, value):
        assert name == "location" or name in SETTINGS.get(self.kind, ()), f"{self.kind} has no {name}"
        self.__dict__[name] = value


class Tree:
    def __init__(self):
        self.found, self.joined, self.sockets = [], [], []
        self.nodes = types.SimpleNamespace(new=self._new, clear=self.found.clear)
        self.links = types.SimpleNamespace(new=self._join)
        self.interface = types.SimpleNamespace(new_socket=lambda **one: self.sockets.append(one))

    def _new(self, kind):
        self.found.append(Node(kind))
        return self.found[-1]

    def _join(self, output, socket):
        assert output.out and not socket.out
        self.joined.append((output.node.kind, output.name, socket.node.kind, socket.name))

    def one(self, kind):
        return next(node for node in self.found if node.kind == kind)


class Named(dict):
    def __init__(self, make):
        super().__init__()
        self.make = make

    def new(self, name, *kinds):
        self[name] = self.make()
        return self[name]


@pytest.fixture
def bpy(monkeypatch):
    """A stand-in for Blender's module that fails for names which Blender has not."""
    loaded = []

    def load(path, check_existing):
        loaded.append(path)
        return types.SimpleNamespace(colorspace_settings=types.SimpleNamespace(name=None), path=path)

    shown = types.SimpleNamespace(data=types.SimpleNamespace(materials=[]))
    data = types.SimpleNamespace(
        images=types.SimpleNamespace(load=load), node_groups=Named(Tree),
        materials=Named(lambda: types.SimpleNamespace(use_nodes=False, node_tree=Tree())),
    )
    module = types.ModuleType("bpy")
    module.__dict__.update(app=types.SimpleNamespace(version=(4, 2, 0)), data=data, context=types.SimpleNamespace(active_object=shown), loaded=loaded)
    monkeypatch.setitem(sys.modules, "bpy", module)
    return module


def run(path):
    exec(compile((path / SCRIPT).read_text("utf-8"), str(path / SCRIPT), "exec"), {"__file__": str(path / SCRIPT)})  # noqa: S102


def test_the_script_builds_a_group_that_uses_every_picture(tmp_path, bpy):
    material = microfacet("normal", "anisotropy", "coat", "sheen").on_relief(0.02 * rand(1, 3) - 0.005)
    losses = tm.export(material, tmp_path / "m", to="blender", width=2.0, name="wool")
    run(tmp_path / "m")
    group = bpy.data.node_groups["wool"]
    assert {path.split("/")[-1] for path in bpy.loaded} == {path.name for path in (tmp_path / "m").glob("*.png")}
    fed = {socket for _, _, kind, socket in group.joined if kind == "ShaderNodeBsdfPrincipled"}
    assert fed == {"Base Color", "Specular Tint", "Roughness", "Anisotropic", "Coat Weight", "Coat Roughness", "Sheen Tint", "Normal", "Tangent"}
    spaces = {node.label: node.image.colorspace_settings.name for node in group.found if node.kind == "ShaderNodeTexImage"}
    assert {name for name, space in spaces.items() if space == "sRGB"} == {"base_color", "specular_tint", "sheen_tint"}
    lift = group.one("ShaderNodeDisplacement")
    height, scale, middle = material.maps["height"].detach(), lift.inputs["Scale"].default_value, lift.inputs["Midlevel"].default_value
    assert scale * (1 - middle) == pytest.approx(2 * float(height.max())) and -scale * middle == pytest.approx(2 * float(height.min()))
    f0 = float(material.maps["specular_f0"].detach().max())
    index = group.one("ShaderNodeBsdfPrincipled").inputs["IOR"].default_value
    assert ((index - 1) / (index + 1)) ** 2 == pytest.approx(f0)
    assert losses.errors["native"] < 1e-5 and losses.lost == {}
    assert bpy.data.materials["wool"].node_tree.joined[0] == ("ShaderNodeGroup", "BSDF", "ShaderNodeOutputMaterial", "Surface")
    assert bpy.context.active_object.data.materials == [bpy.data.materials["wool"]]
    run(tmp_path / "m")  # again: nothing stands twice
    assert len(group.found) == len({id(node) for node in group.found}) and len(group.sockets) == 2


def test_the_least_material(tmp_path, bpy):
    material = microfacet(opacity=(rand(1, 3) > 0.5).float()).repeating(False)
    losses = tm.export(material, tmp_path / "m", to="blender")
    run(tmp_path / "m")
    group = bpy.data.node_groups["torchmat"]
    assert {node.extension for node in group.found if node.kind == "ShaderNodeTexImage"} == {"EXTEND"}
    assert ("ShaderNodeTexImage", "Color", "ShaderNodeBsdfPrincipled", "Alpha") in group.joined
    assert not [node for node in group.found if node.kind in ("ShaderNodeTangent", "ShaderNodeDisplacement")]
    assert "Cycles dims it" in losses.approximated["diffuse"]


def test_the_closest_form_adds_up_the_lobes(tmp_path, bpy):
    material = microfacet("normal", "anisotropy", "f90", "coat", "sheen", opacity=rand(1, 12), specular_f0=rand(3, 2, 0.03, 0.18))
    losses = tm.export(material, tmp_path / "m", to="blender", form="closest")
    run(tmp_path / "m")
    group = bpy.data.node_groups["torchmat"]
    assert {path.split("/")[-1] for path in bpy.loaded} == {path.name for path in (tmp_path / "m").glob("*.png")}
    lobes = [node for node in group.found if node.kind == "ShaderNodeBsdfPrincipled"]
    assert [node.inputs["Metallic"].default_value for node in lobes] == [1.0, 1.0, None]
    assert {node.distribution for node in lobes} == {"GGX"}
    fibres = lobes[2].inputs
    assert fibres["Specular IOR Level"].default_value == 0 and fibres["Base Color"].default_value[:3] == (0, 0, 0)
    kinds = [node.kind for node in group.found]
    assert kinds.count("ShaderNodeAddShader") == 3
    assert kinds.count("ShaderNodeMixShader") == 3  # shares of F90 of both lobes, and opacity
    assert sum(socket == "Normal" and source == "ShaderNodeNormalMap" for source, _, _, socket in group.joined) == 4
    assert ("ShaderNodeMixShader", "Shader", "NodeGroupOutput", "BSDF") in group.joined
    assert losses.errors["native"] < 1e-5 and losses.lost == {}
    assert "dims" not in losses.approximated.get("diffuse", "") and "Cycles' fibres" in losses.approximated["sheen"]


def test_of_the_closest_form_f0_above_1_is_cut_and_layers_are_lost(tmp_path):
    bright = microfacet(specular_f0=rand(3, 2, 0.5, 1.5))
    losses = tm.export(bright, tmp_path / "a", to="blender", form="closest")
    assert float((losses.held.maps["specular_f0"] - bright.maps["specular_f0"].clamp(max=1)).detach().abs().max()) < 1e-4
    assert set(tm.export(microfacet("layered"), tmp_path / "b", to="blender", form="closest").lost) == {"layered"}
    with pytest.raises(RangeError, match="form"):
        tm.export(microfacet(), tmp_path / "c", to="blender", form="nearest")


def test_what_cycles_has_no_place_for_is_lost(tmp_path):
    losses = tm.export(microfacet("f90", "rolloff", "layered"), tmp_path / "m", to="blender")
    assert set(losses.lost) == {"f90", "rolloff", "layered"} and losses.errors["native"] > 0


def test_a_name_with_quotes_stays_a_name(tmp_path, bpy):
    name = 'a"b\'c\\{x}'
    tm.export(microfacet(), tmp_path / "m", to="blender", name=name)
    run(tmp_path / "m")
    assert name in bpy.data.node_groups
