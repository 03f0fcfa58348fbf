"""Pictures of materials on objects, under lights, seen by a camera."""

from torchmat.rendering.camera import Camera
from torchmat.rendering.lights import Directional, Point, environment_lights
from torchmat.rendering.render import render
from torchmat.rendering.scene import Scene

__all__ = ["Camera", "Directional", "Point", "Scene", "environment_lights", "render"]
