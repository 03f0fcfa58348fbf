"""The same as `torchmat refit`."""

from torchmat.cli import program

program(command="refit")
