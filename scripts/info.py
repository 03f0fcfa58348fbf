"""The same as `torchmat info`."""

import sys

from torchmat.cli import main

sys.exit(main(command="info"))
