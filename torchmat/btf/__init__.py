"""Measured data in: files or tensors become a Btf."""

from torchmat.btf.btf import Btf, Source
from torchmat.btf.listing import Listing
from torchmat.btf.load import load_btf
from torchmat.btf.pixels import images_of_files
from torchmat.btf.reader import READERS, Pixels, Reader, register_reader, unregister_reader
from torchmat.btf.split import Split, split_samples
from torchmat.btf.stream import Block

__all__ = [
    "READERS", "Block", "Btf", "Listing", "Pixels", "Reader", "Source", "Split", "images_of_files", "load_btf",
    "register_reader", "split_samples", "unregister_reader",
]
