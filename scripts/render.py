"""The same as `torchmat render`."""

import sys

from torchmat.cli import main

sys.exit(main(command="render"))
