"""The measured images themselves on an object: what a material made of them is compared with."""

from torchmat.btf.raw_btf import RawBtf

__all__ = ["RawBtf"]
