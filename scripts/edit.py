"""The same as `torchmat edit`."""

from torchmat.cli import program

program(command="edit")
