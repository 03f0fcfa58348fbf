"""The same as `torchmat plan`."""

import sys

from torchmat.cli import main

sys.exit(main(command="plan"))
