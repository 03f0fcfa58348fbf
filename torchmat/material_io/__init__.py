"""Materials on disk."""

from torchmat.geometry.height_file import load_height
from torchmat.material_io.folder import check_target, load_material, save_material
from torchmat.material_io.packing import pack, packed, unpack
from torchmat.material_io.relief_folder import save_relief

__all__ = [
    "check_target", "load_height", "load_material", "pack", "packed", "save_material", "save_relief", "unpack",
]
