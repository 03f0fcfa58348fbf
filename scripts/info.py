"""The same as `torchmat info`."""

from torchmat.cli import program

program(command="info")
