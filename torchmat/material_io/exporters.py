"""The exporters that come with the package, registered."""

from __future__ import annotations

from torchmat.material_io.blender import BLENDER
from torchmat.material_io.exporter import register_exporter
from torchmat.material_io.folder import FOLDER
from torchmat.material_io.gltf import GLTF
from torchmat.material_io.html import HTML
from torchmat.material_io.ktx2 import KTX2
from torchmat.material_io.materialx import MATERIALX
from torchmat.material_io.mitsuba import MITSUBA
from torchmat.material_io.orm import ORM
from torchmat.material_io.packing import PACKED
from torchmat.material_io.rti.page import OPENLIME
from torchmat.material_io.rti.ptm_file import PTM
from torchmat.material_io.rti.relight_folder import RELIGHT
from torchmat.material_io.rti.rti_file import RTI
from torchmat.material_io.tiled import TILED
from torchmat.material_io.volume import VOLUME

for _exporter in (
    FOLDER, VOLUME, PACKED, GLTF, MATERIALX, MITSUBA, BLENDER, ORM, RELIGHT, OPENLIME, PTM, RTI, KTX2, HTML, TILED,
):
    register_exporter(_exporter)
