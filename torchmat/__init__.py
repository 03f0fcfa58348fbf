"""Editable texture maps from photographs of a material under many lights and views."""

from torchmat.brdf import Brdf, load_brdf
from torchmat.btf import Btf, Reader, load_btf, register_reader, split_samples
from torchmat.btf.interpolated import RawBtf
from torchmat.errors import DataError, FitError, RangeError, ShapeError, TorchmatError
from torchmat.fitting import (
    FitConfig, FitResult, Recipe, describe_model, describe_models, evaluate, fit, load_config, recover_geometry, refit, register,
)
from torchmat.machine import package_version
from torchmat.material_io import Exporter, Losses, export, load_material, pack, register_exporter, save_material
from torchmat.models import Material
from torchmat.rendering import Camera, Directional, Point, Scene, environment_lights, render
from torchmat.report import compare
from torchmat.solvers import LBFGS, Adam, ClosedForm, LevenbergMarquardt, Minibatch, VariableProjection
from torchmat.sample import sample_path, sample_truth

__version__ = package_version()

__all__ = [
    "LBFGS", "Adam", "Brdf", "Btf", "Camera", "ClosedForm", "DataError", "Directional", "Exporter", "FitConfig",
    "FitError", "FitResult", "LevenbergMarquardt", "Losses", "Material", "Minibatch", "Point", "RangeError", "RawBtf",
    "Reader", "Recipe", "Scene", "ShapeError", "TorchmatError", "VariableProjection", "compare", "describe_model",
    "describe_models", "environment_lights", "evaluate", "export", "fit", "load_brdf", "load_btf", "load_config",
    "load_material", "pack", "recover_geometry", "refit", "register", "register_exporter", "register_reader", "render",
    "sample_path", "sample_truth", "save_material", "split_samples",
]
