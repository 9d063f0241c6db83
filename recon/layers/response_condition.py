"""How a network is told the width of the instrument's response: shifts that are 0 where there is none."""

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from torch import Tensor, nn

HIDDEN = 16


class ResponseCondition(nn.Module):
    """(width (B,), eta (B, conditions)) -> one shift (B, n) for each n of `sizes`.

    Whatever the weights, a width of 0 shifts nothing, so a network that is told nothing computes what it computed
    before; the shifts begin at 0 as well, so that weights from before responses were told serve as they are.
    """

    def __init__(self, conditions: int, sizes: Sequence[int]):
        super().__init__()
        self.sizes = list(sizes)
        self.first = nn.Linear(1 + conditions, HIDDEN)
        self.last = nn.Linear(HIDDEN, sum(sizes), bias=False)
        nn.init.zeros_(self.last.weight)

    def forward(self, width: Tensor, eta: Tensor) -> list[Tensor]:
        inputs = width[:, None] * torch.cat((torch.ones_like(eta[:, :1]), eta), dim=1)
        told = F.gelu(self.first(inputs)) - F.gelu(self.first(torch.zeros_like(inputs)))
        return list(self.last(told).split(self.sizes, dim=1))
