"""The same as `torchmat pack`."""

from torchmat.cli import program

program(command="pack")
