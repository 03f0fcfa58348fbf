"""The same as `torchmat refit`."""

import sys

from torchmat.cli import main

sys.exit(main(command="refit"))
