"""The same as `torchmat plan`."""

from torchmat.cli import program

program(command="plan")
