"""``python -m torchmat.cli``."""

from torchmat.cli import program

if __name__ == "__main__":
    program()
