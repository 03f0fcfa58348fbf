"""The same as `torchmat models`."""

from torchmat.cli import program

program(command="models")
