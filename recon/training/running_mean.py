"""The mean of the weights along a training run, which is what is judged and used."""

from collections.abc import Callable, Sequence
from typing import Any

import torch


def follow(average: list[torch.Tensor], parameters: Sequence[torch.Tensor], step: int, most: float) -> None:
    """Move `average` towards the weights after step `step` (from 0). It keeps `most` of itself, less at first."""
    keep = min(most, (1 + step) / (10 + step))
    torch._foreach_lerp_(average, [p.detach() for p in parameters], 1 - keep)


def with_average(average: list[torch.Tensor], parameters: Sequence[torch.Tensor], do: Callable[[], Any]) -> Any:
    """Do something with the running mean in place of the weights."""
    own = [p.detach().clone() for p in parameters]
    with torch.no_grad():
        torch._foreach_copy_(list(parameters), average)
    try:
        return do()
    finally:
        with torch.no_grad():
            torch._foreach_copy_(list(parameters), own)
