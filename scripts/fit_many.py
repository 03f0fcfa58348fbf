"""The same as `torchmat fit-many`."""

from torchmat.cli import program

if __name__ == "__main__":  # worker processes import this file
    program(command="fit-many")
