"""The same as `torchmat compare`."""

import sys

from torchmat.cli import main

sys.exit(main(command="compare"))
