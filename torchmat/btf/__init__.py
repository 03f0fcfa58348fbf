"""Measured data in: files or tensors become a Btf."""

from torchmat.btf.btf import Btf, Source
from torchmat.btf.load import load_btf
from torchmat.btf.split import Split, split_samples
from torchmat.btf.stream import Block

__all__ = ["Block", "Btf", "Source", "Split", "load_btf", "split_samples"]
