"""Materials on disk."""

from torchmat.material_io.folder import load_material, save_material

__all__ = ["load_material", "save_material"]
