"""Convolutions of volumes with fewer planes than the kernel has, in float32 while a network learns in bfloat16.

oneDNN leaves a part of the weights' gradient unwritten there (torch 2.13.0 on a CPU with AVX512-BF16, 16 channels and
more, kernels of 5 over 2 to 4 planes, of 3 over 2): what memory held before comes back, often NaN.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode


class ShallowInFloat32(TorchFunctionMode):
    """While it is entered, such convolutions are done in float32; all others as autocast has them."""

    def __torch_function__(
        self, func: Callable[..., Any], types: Any, args: Sequence[Any] = (), kwargs: Mapping[str, Any] | None = None
    ) -> Any:
        named = dict(kwargs or {})
        if func is not torch.conv3d:
            return func(*args, **named)
        volume, weight = (args[k] if len(args) > k else named[name] for k, name in enumerate(("input", "weight")))
        if not _shallow(volume, weight):
            return func(*args, **named)
        with torch.autocast("cpu", enabled=False):
            return func(*map(_in_float32, args), **{name: _in_float32(value) for name, value in named.items()})


def _shallow(volume: Tensor, weight: Tensor) -> bool:
    return volume.device.type == "cpu" and any(
        side < kernel for side, kernel in zip(volume.shape[-3:], weight.shape[-3:], strict=True)
    )


def _in_float32(value: Any) -> Any:
    return value.float() if isinstance(value, Tensor) else value
