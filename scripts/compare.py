"""The same as `torchmat compare`."""

from torchmat.cli import program

program(command="compare")
