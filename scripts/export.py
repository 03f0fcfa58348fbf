"""The same as `torchmat export`."""

from torchmat.cli import program

program(command="export")
