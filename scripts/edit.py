"""The same as `torchmat edit`."""

import sys

from torchmat.cli import main

sys.exit(main(command="edit"))
