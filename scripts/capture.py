"""The same as `torchmat capture`."""

from torchmat.cli import program

program(command="capture")
