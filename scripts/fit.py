"""The same as `torchmat fit`."""

import sys

from torchmat.cli import main

sys.exit(main(command="fit"))
