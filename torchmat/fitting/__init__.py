"""fit(): a BTF and a model in, a material and a report out; and all that models, relief, choice and tiles need for it."""

from torchmat.fitting.config import FitConfig, load_config
from torchmat.fitting.describe import ModelDescription, describe_model, describe_models
from torchmat.fitting.evaluate import evaluate, predict
from torchmat.fitting.fit import FitResult, fit
from torchmat.fitting.recipe import RECIPES, Recipe, register
from torchmat.fitting.recipes import default_options
from torchmat.fitting.refit import Refit, refit
from torchmat.fitting.relief.recover import recover_geometry

__all__ = [
    "RECIPES", "FitConfig", "FitResult", "ModelDescription", "Recipe", "Refit", "default_options", "describe_model",
    "describe_models", "evaluate", "fit", "load_config", "predict", "recover_geometry", "refit", "register",
]
