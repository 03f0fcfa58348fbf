"""The exporters that come with the package, registered."""

from __future__ import annotations

from torchmat.material_io.blender import BLENDER
from torchmat.material_io.exporter import register_exporter
from torchmat.material_io.folder import FOLDER
from torchmat.material_io.gltf import GLTF
from torchmat.material_io.materialx import MATERIALX
from torchmat.material_io.mitsuba import MITSUBA
from torchmat.material_io.orm import ORM
from torchmat.material_io.packing import PACKED
from torchmat.material_io.volume import VOLUME

for _exporter in (FOLDER, VOLUME, PACKED, GLTF, MATERIALX, MITSUBA, BLENDER, ORM):
    register_exporter(_exporter)
