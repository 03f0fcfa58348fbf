"""Tables, plots and pages."""

from torchmat.report.comparison import compare, write_comparison
from torchmat.report.write import write_fit

__all__ = ["compare", "write_comparison", "write_fit"]
