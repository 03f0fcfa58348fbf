"""``python -m torchmat.cli``."""

import sys

from torchmat.cli import main

if __name__ == "__main__":
    sys.exit(main())
