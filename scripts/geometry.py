"""The same as `torchmat geometry`."""

import sys

from torchmat.cli import main

sys.exit(main(command="geometry"))
