"""The same as `torchmat models`."""

import sys

from torchmat.cli import main

sys.exit(main(command="models"))
