"""Solvers that step: they know parameters and an objective, nothing of reflectance."""

from torchmat.fit.solvers.descend import Descent, adam, lbfgs, minibatch

__all__ = ["Descent", "adam", "lbfgs", "minibatch"]
