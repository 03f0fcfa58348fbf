"""How the threads of a command wait for work: the library of torch's threads reads that once, as it is loaded."""

from __future__ import annotations

import os

# libgomp lets an idle thread spin 300,000 times before it sleeps. Where other programs want the cores too it then takes them
# from the very thread that it waits for: a fit of 19 s took 118. A thousand spins bridge the gaps within a step.
SPINS = 1000


def let_threads_sleep() -> None:
    """Let idle threads give way soon, unless the environment says how they wait."""
    if not os.environ.keys() & {"GOMP_SPINCOUNT", "OMP_WAIT_POLICY"}:
        os.environ["GOMP_SPINCOUNT"] = str(SPINS)
