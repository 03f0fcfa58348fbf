"""Materials on disk."""

from torchmat.geometry.height_file import load_height
from torchmat.material_io import exporters  # noqa: F401  registers what comes with the package
from torchmat.material_io.change_folder import change_material
from torchmat.material_io.write_export import export
from torchmat.material_io.exporter import EXPORTERS, Exporter, Losses, register_exporter, unregister_exporter
from torchmat.material_io.folder import check_target, save_material
from torchmat.material_io.packing import pack, packed, unpack
from torchmat.material_io.read_folder import load_material
from torchmat.material_io.relief_folder import save_relief
from torchmat.material_io.uncertainty_textures import load_uncertainty

__all__ = [
    "EXPORTERS", "Exporter", "Losses", "change_material", "check_target", "export", "load_height", "load_material", "load_uncertainty",
    "pack", "packed", "register_exporter", "save_material", "save_relief", "unpack", "unregister_exporter",
]
