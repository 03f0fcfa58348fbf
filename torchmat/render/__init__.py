"""Pictures of materials."""

from torchmat.render.render import render

__all__ = ["render"]
