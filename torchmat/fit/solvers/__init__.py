"""Solvers that step: they know parameters and an objective, nothing of reflectance."""

from torchmat.fit.solvers.descend import CONVERGED, DIVERGED, NOT_FINITE, STEP_LIMIT, Descent, adam, lbfgs, minibatch

__all__ = ["CONVERGED", "DIVERGED", "NOT_FINITE", "STEP_LIMIT", "Descent", "adam", "lbfgs", "minibatch"]
