"""Why a fit stopped: the words that reports and results use."""

CONVERGED = "converged"
CLOSED_FORM = CONVERGED  # solved at once: nothing is left to gain
OPEN = "directions left open"  # damped away while they promised a lower cost
STEP_LIMIT = "step limit"
BUDGET = "budget spent"
NOT_FINITE, DIVERGED = "not finite", "diverged"
