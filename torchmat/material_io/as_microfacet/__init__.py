"""Any BRDF-like material as a microfacet one, the form that renderers know, and how far off that is."""

from torchmat.material_io.as_microfacet.convert import as_microfacet
from torchmat.material_io.as_microfacet.error import held_out_error, shading_error

__all__ = ["as_microfacet", "held_out_error", "shading_error"]
