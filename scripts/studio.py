"""The same as `torchmat studio`."""

from torchmat.cli import program

program(command="studio")
