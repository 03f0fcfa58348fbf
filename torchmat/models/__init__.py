"""Materials: maps plus a differentiable shade(light, view); the table of all of them."""

from torchmat.models.base import Material
from torchmat.models.blend import blend
from torchmat.models.compilation import can_compile, compiled
from torchmat.models.distribution import Distribution
from torchmat.models.edit import add_part, drop_part, replace_map
from torchmat.models.linear import Hsh, Lambert, Lptm, Ptm, Texture
from torchmat.models.neural import Neural
from torchmat.models.pca import LocalPca, Pca
from torchmat.models.phong_srf import PhongSrf
from torchmat.models.shading_map import ShadingMap
from torchmat.models.sphere_images import SphereImages

MATERIALS: dict[str, type[Material]] = {
    model.name: model
    for model in (Texture, Lambert, Ptm, Lptm, Hsh, PhongSrf, Pca, LocalPca, Distribution, ShadingMap, SphereImages, Neural)
}

__all__ = [
    "MATERIALS", "Distribution", "Hsh", "Lambert", "LocalPca", "Lptm", "Material", "Neural", "Pca", "PhongSrf", "Ptm",
    "ShadingMap", "SphereImages", "Texture", "add_part", "blend", "can_compile", "compiled", "drop_part", "replace_map",
]
