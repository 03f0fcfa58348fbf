"""Names that commands know before the package is loaded: a misspelt one need not wait for torch.

What stands here is told to the user and decides nothing; a test holds it to the truth.
"""

from __future__ import annotations

import sys

Bound = tuple[str, float, float]  # what a number must do, and the least and the largest that does

CONFIG_KEYS = (
    "model", "options", "holdout", "holdout_by", "seed", "test", "geometry", "relief", "finish", "indirect", "tiles",
    "target",
    "tile_size", "memory_mb", "uncertainty", "data",
)
OPTIONS: dict[str, tuple[str, ...]] = {
    "texture": ("storage", "solver", "objective"),
    "lambert": ("normals", "storage", "solver", "objective"),
    "lptm": ("space", "storage", "solver", "objective"),
    "ptm": ("space", "storage", "solver", "objective"),
    "hsh": ("terms", "space", "storage", "solver", "objective"),
    "phong_srf": ("residual", "phong", "base", "ridge", "solver", "storage", "objective"),
    "pca": ("components", "storage", "solver", "objective"),
    "local_pca": ("clusters", "components", "storage", "solver", "objective"),
    "rbf": ("components", "space", "smoothing", "storage", "solver", "objective"),
    "sphere_images": ("pictures", "size", "base", "smoothness", "storage", "solver", "objective"),
    "shading_map": ("slices", "brdf", "overflow", "azimuths", "joint", "storage", "solver", "objective"),
    "distribution": (
        "lobes", "fresnel", "rotation", "tilt", "normal", "specular_mask", "specular_size", "effort", "solver",
        "storage", "objective", "denominator", "fresnel_exponent", "specular_spacing",
    ),
    "neural": ("latent", "hidden", "layers", "effort", "storage", "solver", "objective"),
    "microfacet": (
        "anisotropy", "normal", "f90", "coat", "sheen", "rolloff", "layered", "effort", "solver", "storage", "objective",
    ),
    "auto": (),
}


TABLES: dict[str, tuple[str, ...]] = {
    "target": ("error", "psnr", "bytes", "seconds", "highlights"),
    "data": (
        "kind", "encoding", "invalid", "duplicates", "exposure", "crop", "downscale", "lights", "views", "normalise",
        "light_table", "ball", "circle", "intensities", "mask", "skip_bad_lights", "near", "distance", "falloff",
        "clipped_weight",
    ),
}
CHOICES: dict[str, dict[str, tuple[object, ...]]] = {
    "lambert": {"normals": ("auto", "map", "height")},
    "ptm": {"space": ("linear", "srgb")},
    "lptm": {"space": ("linear", "srgb")},
    "hsh": {"terms": (4, 9, 16), "space": ("linear", "srgb")},
    "rbf": {"space": ("linear", "srgb")},
    "phong_srf": {
        "residual": ("half", "half_light", "quadratic", "cosine"), "phong": ("mean_brdf", "per_light"),
        "base": ("phong", "ashikhmin_shirley"),
    },
    "sphere_images": {"base": ("phong", "blinn", "cook_torrance", "ggx")},
    "shading_map": {
        "brdf": (
            "lambert", "phong", "blinn", "ashikhmin_shirley", "ward", "cook_torrance", "ggx", "ggx_anisotropic",
        ),
        "overflow": ("clamp", "scale"),
    },
}
STORAGES = ("half", "float", "png8", "png16", "tiff8", "tiff16", "paint8", "paint16")
ENCODINGS = ("auto", "srgb", "linear", "xyz")
KINDS = ("manifest", "rti", "ubo2003", "utia", "stereo", "brdf", "ubo2014", "neuralbtf")
HOLDOUT_WAYS = ("pair", "light", "view", "both", "arc")
MEASURES = ("none", "quick", "full", "auto")
FILTERS = ("bilinear", "nearest", "area")
INTEGRATIONS, RELIEF_DEPTHS, PACK_DEPTHS = ("fourier", "poisson"), ("16", "float"), (8, 16)
CRITERIA, PLAN_VIEWS = ("mean", "D"), ("fixed", "free")
RAYS = (1, 4, 9, 16)
POSITIVE: Bound = ("be positive", 5e-324, sys.float_info.max)
FROM_1: Bound = ("be at least 1", 1, sys.float_info.max)
SHARE: Bound = ("lie in [0, 1)", 0, 1 - 2**-53)
EXPORTERS = (
    "folder", "3pm", "packed", "gltf", "materialx", "mitsuba", "blender", "orm", "relight", "openlime", "ptm", "rti", "ktx2", "html", "tiled",
)
LAMPS = ("auto", "spheres", "flash", "shading")  # where a capture has its lights from
PAPERS = ("A3", "A4", "A5", "letter", "legal", "tabloid")
MESHES = ("patch", "quad", "cube", "sphere", "torus", "teapot")


def known_exporters() -> tuple[str, ...]:
    """Return the names of exporters: as they stand here, or where the package is loaded those of all registered ones."""
    loaded = sys.modules.get("torchmat.material_io.exporter")
    return EXPORTERS if loaded is None else tuple(loaded.EXPORTERS)


def known_kinds() -> tuple[str, ...]:
    """Return the names of readers: as they stand here, or where the package is loaded those of all registered ones."""
    loaded = sys.modules.get("torchmat.btf.reader")
    return KINDS if loaded is None else (*KINDS, *loaded.READERS)


def known_options() -> dict[str, tuple[str, ...]]:
    """Return the options of each model: as they stand here, or where the package is loaded those of all registered ones."""
    loaded = sys.modules.get("torchmat.fitting.recipe")
    return OPTIONS if loaded is None else {**OPTIONS, **{name: tuple(one.options) for name, one in loaded.RECIPES.items()}}
