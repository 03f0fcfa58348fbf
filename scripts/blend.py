"""The same as `torchmat blend`."""

import sys

from torchmat.cli import main

sys.exit(main(command="blend"))
