"""Calls of compiled functions with tensors: pointers, sizes and the number of threads."""

from __future__ import annotations

import ctypes

import torch
from torch import Tensor

from torchmat.fast.switch import double_library

_ENDINGS = {torch.float32: "_float", torch.float64: "_double"}


def fits(*tensors: Tensor) -> bool:
    """Return whether tensors are plain arrays of one precision that the compiled part has, on the processor, and not empty."""
    first = tensors[0].dtype
    return first in _ENDINGS and all(
        type(one) in (Tensor, torch.nn.Parameter) and one.dtype == first and one.device.type == "cpu" and one.layout == torch.strided
        and one.numel() > 0 for one in tensors
    ) and not torch._C._are_functorch_transforms_active() and not torch.compiler.is_compiling() and (
        first == torch.float32 or double_library() is not None
    )


def wants_gradient(*tensors: Tensor) -> bool:
    """Return whether what is made of tensors must carry gradients."""
    return torch.is_grad_enabled() and any(one.requires_grad for one in tensors)


def call(library: ctypes.CDLL, name: str, *arguments: Tensor | int | float | bool | None) -> None:
    """Call a function of the precision of its first tensor, that of doubles of their own part.

    Tensors must be contiguous; threads are torch's, and come last.
    """
    first = next(one for one in arguments if isinstance(one, Tensor))
    found: list[ctypes.c_void_p | ctypes.c_double | ctypes.c_int64] = []
    for one in arguments:
        if one is None or isinstance(one, Tensor):
            assert one is None or one.is_contiguous()
            found.append(ctypes.c_void_p(None if one is None else one.data_ptr()))
        else:
            found.append(ctypes.c_double(one) if isinstance(one, float) else ctypes.c_int64(one))
    part = library if first.dtype == torch.float32 else double_library()
    function = getattr(part, name + _ENDINGS[first.dtype])
    function.restype = None
    function(*found, ctypes.c_int64(torch.get_num_threads()))
