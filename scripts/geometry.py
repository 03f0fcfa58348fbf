"""The same as `torchmat geometry`."""

from torchmat.cli import program

program(command="geometry")
