"""Height, normals, parallax and shadow: what works on a surface's shape, whatever its reflectance."""

from torchmat.geometry.integrate import frankot_chellappa, poisson
from torchmat.geometry.normals import normals_from_height, normals_from_slopes, slopes_from_height, slopes_from_normals
from torchmat.geometry.photometric_stereo import Stereo, find_highlight, lights_from_ball, photometric_stereo
from torchmat.geometry.from_photographs import Relief, relief_from_photographs, relief_from_picture
from torchmat.geometry.rays import Hits, clearance, soft_shadow, trace_view, visible

__all__ = [
    "Hits", "Relief", "Stereo", "clearance", "find_highlight", "frankot_chellappa", "lights_from_ball", "normals_from_height",
    "normals_from_slopes", "photometric_stereo", "poisson", "relief_from_photographs", "relief_from_picture",
    "slopes_from_height", "slopes_from_normals", "soft_shadow", "trace_view", "visible",
]
