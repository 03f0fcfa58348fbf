"""The same as `torchmat studio`."""

import sys

from torchmat.cli import main

sys.exit(main(command="studio"))
