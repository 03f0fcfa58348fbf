"""The same as `torchmat pack`."""

import sys

from torchmat.cli import main

sys.exit(main(command="pack"))
