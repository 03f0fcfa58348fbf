"""Materials on disk."""

from torchmat.material_io.folder import check_target, load_material, save_material

__all__ = ["check_target", "load_material", "save_material"]
