"""Solvers, and fit(): a BTF and a model's name in, a material and a report out."""

from torchmat.fit.config import FitConfig, load_config
from torchmat.fit.evaluate import evaluate, predict
from torchmat.fit.fit import FitResult, fit
from torchmat.fit.recover import recover_geometry
from torchmat.fit.refit import Refit, refit
from torchmat.fit.registry import FITTERS, default_options

__all__ = [
    "FITTERS", "FitConfig", "FitResult", "Refit", "default_options", "evaluate", "fit", "load_config", "predict",
    "recover_geometry", "refit",
]
