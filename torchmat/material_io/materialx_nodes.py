"""Nodes of a MaterialX document: pictures, and what is calculated of them, in a node graph with one output a map."""

from __future__ import annotations

from xml.etree import ElementTree

VERSION, SPACE = "1.39", "lin_rec709"
_SRGB = "srgb_texture"


def typed(parent: ElementTree.Element, name: str, kind: str, value: object = None, **links: str) -> None:
    """Add an input of a type to a node, with a value or links such as ``nodename``."""
    given = {} if value is None else {"value": value if isinstance(value, str) else _text(value)}
    ElementTree.SubElement(parent, "input", {"name": name, "type": kind, **given, **links})


def _text(value: object) -> str:
    if isinstance(value, list | tuple):
        return ", ".join(f"{part:.9g}" for part in value)
    return f"{value:.9g}" if isinstance(value, float) else str(value)


class Graph:
    """A node graph that is being made.

    Args:
        root: the document.
        tiles: whether pictures repeat.
    """

    def __init__(self, root: ElementTree.Element, tiles: bool) -> None:
        self.element = ElementTree.SubElement(root, "nodegraph", {"name": "maps"})
        self.mode = "periodic" if tiles else "clamp"
        self.outputs: list[tuple[str, str, str]] = []

    def node(self, category: str, name: str, kind: str) -> ElementTree.Element:
        """Add a node of a category and return it."""
        return ElementTree.SubElement(self.element, category, {"name": name, "type": kind})

    def image(self, name: str, file: str, kind: str, coloured: bool = False) -> str:
        """Add a picture; return the name of its node."""
        node = self.node("image", f"{name}_image", kind)
        space = {"colorspace": _SRGB} if coloured else {}
        ElementTree.SubElement(node, "input", {"name": "file", "type": "filename", "value": file, **space})
        for axis in "uv":
            typed(node, f"{axis}addressmode", "string", self.mode)
        return f"{name}_image"

    def binary(self, category: str, name: str, kind: str, first: str, second: str | float, second_kind: str = "") -> str:
        """Add a node of two inputs, the second a node's name or a number; return its name."""
        node = self.node(category, name, kind)
        typed(node, "in1", kind, nodename=first)
        if isinstance(second, str):
            typed(node, "in2", second_kind or kind, nodename=second)
        else:
            typed(node, "in2", second_kind or kind, second)
        return name

    def normal(self, file: str) -> str:
        """Add the normal of a picture of codes, in the frame of the scene."""
        node = self.node("normalmap", "normal_map", "vector3")
        typed(node, "in", "vector3", nodename=self.image("normal", file, "vector3"))
        return "normal_map"

    def tangent(self, file: str) -> str:
        """Add the tangent turned by a picture of cosine and sine: their codes span -1..1."""
        codes = self.image("rotation", file, "vector3")
        signed = self.binary("subtract", "rotation_signed", "vector3", self.binary("multiply", "rotation_twice", "vector3", codes, 2.0, "float"), 1.0, "float")
        sides = []
        for number, (axis, of) in enumerate((("tangent", "along"), ("bitangent", "up"))):
            node = self.node("extract", f"rotation_{of}", "float")
            typed(node, "in", "vector3", nodename=signed)
            typed(node, "index", "integer", number)
            world = self.node(axis, f"{axis}_{of}", "vector3")
            typed(world, "space", "string", "world")
            sides.append(self.binary("multiply", f"{axis}_share", "vector3", f"{axis}_{of}", f"rotation_{of}", "float"))
        total = self.binary("add", "turned", "vector3", *sides)
        node = self.node("normalize", "turned_tangent", "vector3")
        typed(node, "in", "vector3", nodename=total)
        return "turned_tangent"

    def output(self, name: str, kind: str, node: str) -> None:
        """Make a node's value an output of the graph."""
        self.outputs.append((name, kind, node))

    def close(self) -> None:
        """Write the outputs, which come last."""
        for name, kind, node in self.outputs:
            ElementTree.SubElement(self.element, "output", {"name": name, "type": kind, "nodename": node})


def linked(node: ElementTree.Element, name: str, kind: str, output: str) -> None:
    """Link an input of a node to an output of the graph."""
    typed(node, name, kind, nodegraph="maps", output=output)
