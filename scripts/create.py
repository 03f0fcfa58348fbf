"""The same as `torchmat create`."""

from torchmat.cli import program

program(command="create")
