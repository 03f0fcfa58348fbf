"""Materials without a BTF: from one picture, or from the textures that artists already have."""

from torchmat.create.from_picture import material_from_picture
from torchmat.create.from_textures import material_from_textures

__all__ = ["material_from_picture", "material_from_textures"]
