"""Reflectance of homogeneous surfaces: measured tables and analytic formulas."""

from torchmat.brdf.analytic import ANALYTIC
from torchmat.brdf.analytic_brdf import AnalyticBrdf
from torchmat.brdf.base import Brdf
from torchmat.brdf.load import brdf_kind, is_brdf_file, is_isotropic_file, load_brdf
from torchmat.brdf.merl import MerlBrdf, tabulate
from torchmat.brdf.merl_file import read_merl, write_merl
from torchmat.brdf.rgl import RglBrdf, read_rgl

__all__ = [
    "ANALYTIC", "AnalyticBrdf", "Brdf", "MerlBrdf", "RglBrdf", "brdf_kind",
    "is_brdf_file", "is_isotropic_file", "load_brdf", "read_merl", "read_rgl",
    "tabulate", "write_merl",
]
