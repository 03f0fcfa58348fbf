"""The same as `torchmat export`."""

import sys

from torchmat.cli import main

sys.exit(main(command="export"))
