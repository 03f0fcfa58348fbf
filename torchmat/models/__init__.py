"""Materials: maps plus a differentiable shade(light, view); the table of all of them."""

from torchmat.errors import RangeError, message
from torchmat.models.base import Material
from torchmat.models.blend import blend
from torchmat.models.compilation import can_compile, compiled
from torchmat.models.distribution import Distribution
from torchmat.models.edit import add_part, drop_part, replace_map
from torchmat.models.linear import Hsh, Lambert, Lptm, Ptm, Texture
from torchmat.models.microfacet import Microfacet
from torchmat.models.neural import Neural
from torchmat.models.pca import LocalPca, Pca
from torchmat.models.phong_srf import PhongSrf
from torchmat.models.rbf import Rbf
from torchmat.models.shading_map import ShadingMap
from torchmat.models.sphere_images import SphereImages

MATERIALS: dict[str, type[Material]] = {
    model.name: model
    for model in (
        Texture, Lambert, Ptm, Lptm, Hsh, PhongSrf, Pca, LocalPca, Rbf, Distribution, ShadingMap, SphereImages, Neural, Microfacet,
    )
}


def register_material(kind: type[Material]) -> None:
    """Add a material's class to the table by which folders are loaded; raises RangeError when its name is taken."""
    if kind.name in MATERIALS:
        step = "Give the class another name."
        raise RangeError(message("register_material", "the model's name", "be new", f"{kind.name!r} is taken", step))
    MATERIALS[kind.name] = kind


__all__ = [
    "MATERIALS", "Distribution", "Hsh", "Lambert", "LocalPca", "Lptm", "Material", "Microfacet", "Neural", "Pca", "PhongSrf", "Ptm",
    "Rbf", "ShadingMap", "SphereImages", "Texture", "add_part", "blend", "can_compile", "compiled", "drop_part", "register_material",
    "replace_map",
]
