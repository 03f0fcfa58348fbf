"""Editable texture maps from photographs of a material under many lights and views.

Names are loaded when they are first used: `import torchmat` alone takes no time, and the command line answers before
torch is there.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from torchmat.brdf import Brdf, load_brdf
    from torchmat.btf import Btf, Reader, load_btf, register_reader, split_samples
    from torchmat.btf.interpolated import RawBtf
    from torchmat.capturing.capture import capture
    from torchmat.errors import DataError, FitError, RangeError, ShapeError, TorchmatError
    from torchmat.fitting import FitConfig, Recipe, describe_model, describe_models, load_config, recover_geometry, register
    from torchmat.fitting.certainty.estimate import uncertainty
    from torchmat.fitting.certainty.plan import Plan, plan
    from torchmat.fitting.evaluate import evaluate
    from torchmat.fitting.fit import FitResult, fit
    from torchmat.fitting.refit import refit
    from torchmat.material_io import Exporter, Losses, export, load_material, pack, register_exporter, save_material
    from torchmat.models import Material
    from torchmat.models.uncertainty import Uncertainty
    from torchmat.rendering import Camera, Directional, Point, Scene, environment_lights
    from torchmat.rendering.render import render
    from torchmat.report import compare
    from torchmat.sample import sample_path, sample_truth
    from torchmat.studio.serve import open_studio
    from torchmat.solvers import LBFGS, Adam, ClosedForm, LevenbergMarquardt, Minibatch, VariableProjection

    __version__: str

_NAMES = {
    "brdf": ("Brdf", "load_brdf"),
    "btf": ("Btf", "Reader", "load_btf", "register_reader", "split_samples"),
    "btf.interpolated": ("RawBtf",),
    "capturing.capture": ("capture",),
    "errors": ("DataError", "FitError", "RangeError", "ShapeError", "TorchmatError"),
    "fitting": (
        "FitConfig", "FitResult", "Recipe", "describe_model", "describe_models", "evaluate", "fit", "load_config",
        "recover_geometry", "refit", "register",
    ),
    "fitting.certainty.estimate": ("uncertainty",),
    "fitting.certainty.plan": ("Plan", "plan"),
    "material_io": ("Exporter", "Losses", "export", "load_material", "pack", "register_exporter", "save_material"),
    "models": ("Material",),
    "models.uncertainty": ("Uncertainty",),
    "rendering": ("Camera", "Directional", "Point", "Scene", "environment_lights", "render"),
    "report": ("compare",),
    "sample": ("sample_path", "sample_truth"),
    "studio.serve": ("open_studio",),
    "solvers": ("LBFGS", "Adam", "ClosedForm", "LevenbergMarquardt", "Minibatch", "VariableProjection"),
}
_PLACES = {name: place for place, names in _NAMES.items() for name in names}

__all__ = [
    "LBFGS", "Adam", "Brdf", "Btf", "Camera", "ClosedForm", "DataError", "Directional", "Exporter", "FitConfig",
    "FitError", "FitResult", "LevenbergMarquardt", "Losses", "Material", "Minibatch", "Plan", "Point", "RangeError", "RawBtf",
    "Reader", "Recipe", "Scene", "ShapeError", "TorchmatError", "Uncertainty", "VariableProjection", "capture", "compare", "describe_model",
    "describe_models", "environment_lights", "evaluate", "export", "fit", "load_brdf", "load_btf", "load_config",
    "load_material", "open_studio", "pack", "plan", "recover_geometry", "refit", "register", "register_exporter", "register_reader", "render",
    "sample_path", "sample_truth", "save_material", "split_samples", "uncertainty",
]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from torchmat.machine import package_version

        value: Any = package_version()
    elif name in _PLACES:
        value = getattr(importlib.import_module(f"torchmat.{_PLACES[name]}"), name)
    else:
        try:
            return importlib.import_module(f"torchmat.{name}")  # a room, as `torchmat.models`
        except ModuleNotFoundError as error:
            if error.name != f"torchmat.{name}":
                raise
            raise AttributeError(f"module 'torchmat' has no attribute {name!r}") from None
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, "__version__"})
