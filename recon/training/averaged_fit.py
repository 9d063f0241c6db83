"""Steps of a small network, and the running mean of its weights: what is kept of it."""

import copy
import math
from typing import Generic, TypeVar

import torch
from torch import Tensor, nn

N = TypeVar("N", bound=nn.Module)
CLIP = 1.0


class AveragedFit(Generic[N]):
    """AdamW on `network`, gradients clipped, and the `mean` of its weights over about 1 / (1 - average) steps, of fewer
    at first."""

    def __init__(self, network: N, rate: float, decay: float, average: float) -> None:
        self.network, self.mean = network, copy.deepcopy(network)
        self.optimiser = torch.optim.AdamW(network.parameters(), lr=rate, weight_decay=decay)
        self.steps = 0
        self._average = average

    def step(self, loss: Tensor, rate: float) -> None:
        """Down the gradient of `loss`."""
        self.optimiser.param_groups[0]["lr"] = rate
        self.optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), CLIP)
        self.optimiser.step()
        self.steps += 1
        keep = min(self._average, self.steps / (self.steps + 10))
        with torch.no_grad():
            for kept, now in zip(self.mean.parameters(), self.network.parameters(), strict=True):
                kept.lerp_(now, 1 - keep)


def falling(first: float, last: float, over: float) -> float:
    """A rate that falls from `first` to `last` along half a cosine while `over` goes from 0 to 1, and stays there."""
    return last + (first - last) * 0.5 * (1 + math.cos(math.pi * min(1.0, over)))
