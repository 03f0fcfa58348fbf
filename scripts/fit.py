"""The same as `torchmat fit`."""

from torchmat.cli import program

program(command="fit")
