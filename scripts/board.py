"""The same as `torchmat board`."""

from torchmat.cli import program

program(command="board")
