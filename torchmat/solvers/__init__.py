"""Solvers: they know parameters and an objective, nothing of reflectance."""

from torchmat.solvers.descent import Descent, adam, lbfgs, minibatch
from torchmat.solvers.solver import (
    DESCENTS, LBFGS, SOLVERS, Adam, ClosedForm, LevenbergMarquardt, Minibatch, Problem, Solver, Stepping,
    VariableProjection, as_solver,
)

__all__ = [
    "DESCENTS", "LBFGS", "SOLVERS", "Adam", "ClosedForm", "Descent", "LevenbergMarquardt", "Minibatch", "Problem", "Solver",
    "Stepping", "VariableProjection", "adam", "as_solver", "lbfgs", "minibatch",
]
