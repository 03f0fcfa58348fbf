"""Solvers that step: they know parameters and an objective, nothing of reflectance."""

from torchmat.solvers.descent import Descent, adam, lbfgs, minibatch

__all__ = ["Descent", "adam", "lbfgs", "minibatch"]
