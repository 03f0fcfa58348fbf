"""The same as `torchmat board`."""

import sys

from torchmat.cli import main

sys.exit(main(command="board"))
