"""Editable texture maps from photographs of a material under many lights and views."""

from torchmat.brdf import Brdf, load_brdf
from torchmat.btf import Btf, load_btf, split_samples
from torchmat.errors import DataError, FitError, RangeError, ShapeError, TorchmatError
from torchmat.fitting import FitConfig, FitResult, evaluate, fit, load_config
from torchmat.material_io import load_material, save_material
from torchmat.models import Material
from torchmat.rendering import Scene, render
from torchmat.report import compare
from torchmat.sample import sample_path, sample_truth

__all__ = [
    "Brdf", "Btf", "DataError", "FitConfig", "FitError", "FitResult", "Material", "RangeError", "Scene", "ShapeError",
    "TorchmatError", "compare", "evaluate", "fit", "load_brdf", "load_btf", "load_config", "load_material", "render",
    "sample_path", "sample_truth", "save_material", "split_samples",
]
