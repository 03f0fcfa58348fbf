"""The same as `torchmat render`."""

from torchmat.cli import program

program(command="render")
