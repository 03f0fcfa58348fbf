"""An optional fast part: a few loops in C, compiled on first use, beside the plain torch that they stand for."""

from torchmat.fast.switch import library, road, road_taken, use

__all__ = ["library", "road", "road_taken", "use"]
