"""Materials without a BTF: from one picture, from the textures that artists already have, from photographs of a sphere."""

from torchmat.create.edits import EDITS, edited
from torchmat.create.from_picture import material_from_picture
from torchmat.create.from_sphere import sphere_images_from_photographs
from torchmat.create.from_textures import material_from_textures
from torchmat.create.microfacet import microfacet_from_picture, microfacet_from_textures

__all__ = [
    "EDITS", "edited", "material_from_picture", "material_from_textures", "microfacet_from_picture", "microfacet_from_textures",
    "sphere_images_from_photographs",
]
