"""The same as `torchmat blend`."""

from torchmat.cli import program

program(command="blend")
