"""The same as `torchmat fit-many`."""

import sys

from torchmat.cli import main

if __name__ == "__main__":  # worker processes import this file
    sys.exit(main(command="fit-many"))
