"""Pictures of materials on objects, under lights, seen by a camera."""

from torchmat.render.camera import Camera
from torchmat.render.lights import Directional, Point, environment_lights
from torchmat.render.render import render
from torchmat.render.scene import Scene

__all__ = ["Camera", "Directional", "Point", "Scene", "environment_lights", "render"]
