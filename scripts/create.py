"""The same as `torchmat create`."""

import sys

from torchmat.cli import main

sys.exit(main(command="create"))
