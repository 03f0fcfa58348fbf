"""``python -m torchmat.cli``."""

import sys

from torchmat.cli import main

sys.exit(main())
