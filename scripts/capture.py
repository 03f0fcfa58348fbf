"""The same as `torchmat capture`."""

import sys

from torchmat.cli import main

sys.exit(main(command="capture"))
