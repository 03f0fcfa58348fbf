"""Names that commands know before the package is loaded: a misspelt one need not wait for torch.

What stands here is told to the user and decides nothing; a test holds it to the truth.
"""

from __future__ import annotations

import sys

CONFIG_KEYS = (
    "model", "options", "holdout", "holdout_by", "seed", "geometry", "tiles", "target", "tile_size", "memory_mb", "data",
)
OPTIONS: dict[str, tuple[str, ...]] = {
    "texture": ("storage", "solver", "objective"),
    "lambert": ("normals", "storage", "solver", "objective"),
    "lptm": ("storage", "solver", "objective"),
    "ptm": ("storage", "solver", "objective"),
    "hsh": ("terms", "storage", "solver", "objective"),
    "phong_srf": ("residual", "phong", "base", "ridge", "solver", "storage", "objective"),
    "pca": ("components", "storage", "solver", "objective"),
    "local_pca": ("clusters", "components", "storage", "solver", "objective"),
    "sphere_images": ("pictures", "size", "base", "smoothness", "storage", "solver", "objective"),
    "shading_map": ("slices", "brdf", "overflow", "azimuths", "joint", "storage", "solver", "objective"),
    "distribution": (
        "lobes", "fresnel", "rotation", "tilt", "normal", "specular_mask", "specular_size", "effort", "solver",
        "storage", "objective",
    ),
    "neural": ("latent", "hidden", "layers", "effort", "storage", "solver", "objective"),
    "auto": (),
}


def known_options() -> dict[str, tuple[str, ...]]:
    """Return the options of each model: as they stand here, or where the package is loaded those of all registered ones."""
    loaded = sys.modules.get("torchmat.fitting.recipe")
    return OPTIONS if loaded is None else {**OPTIONS, **{name: tuple(one.options) for name, one in loaded.RECIPES.items()}}
