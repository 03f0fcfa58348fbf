"""Measured data in: files or tensors become a Btf."""

from torchmat.btf.btf import Block, Btf, Source
from torchmat.btf.load import load_btf
from torchmat.btf.split import Split, split_samples

__all__ = ["Block", "Btf", "Source", "Split", "load_btf", "split_samples"]
