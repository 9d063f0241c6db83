"""Lets any linear map take part in differentiation: its backward pass is its adjoint, which is all a gradient needs."""

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.sparse
import torch

Map = Callable[[torch.Tensor], torch.Tensor]


class _Linear(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: torch.Tensor, apply: Map, adjoint: Map) -> torch.Tensor:
        ctx.forward_map, ctx.backward_map = apply, adjoint  # `apply` itself is taken: autograd calls it
        return apply(x)

    @staticmethod
    def backward(ctx: Any, *gradients: torch.Tensor) -> tuple[torch.Tensor, None, None]:
        return linear(gradients[0], ctx.backward_map, ctx.forward_map), None, None


def linear(x: torch.Tensor, apply: Map, adjoint: Map) -> torch.Tensor:
    """apply(x), differentiable to any order. Half precision is raised to float32: these maps are Fourier transforms."""
    if x.dtype in (torch.float16, torch.bfloat16):
        x = x.float()
    with torch.autocast(x.device.type, enabled=False):
        result: torch.Tensor = _Linear.apply(x, apply, adjoint)  # type: ignore[no-untyped-call]
    return result


class AlongTime:
    """A sparse matrix (V, T) applied along the third axis of (B, C, T, H, W)."""

    def __init__(self, matrix: scipy.sparse.csr_array) -> None:
        self.matrix = matrix
        self._held: dict[tuple[torch.device, torch.dtype], torch.Tensor] = {}

    def __call__(self, x: torch.Tensor) -> torch.Tensor:
        batch, channels, length, rows, cols = x.shape
        flat = x.reshape(batch * channels, length, rows * cols)
        if x.device.type == "cpu":
            held = self.matrix.astype(flat.numpy().dtype)
            done = torch.from_numpy(np.stack([held @ sample for sample in flat.numpy()]))
        else:
            there = self._on(x.device, x.dtype)
            done = torch.stack([torch.sparse.mm(there, sample) for sample in flat])
        return done.reshape(batch, channels, self.matrix.shape[0], rows, cols)

    def _on(self, device: torch.device, dtype: torch.dtype) -> torch.Tensor:
        """The matrix on a GPU, sorted, and kept there: to bring it takes longer than to apply it."""
        if (device, dtype) not in self._held:
            entries = self.matrix.tocoo()
            index = torch.from_numpy(np.stack([entries.row, entries.col])).long().to(device)
            values = torch.from_numpy(entries.data).to(device, dtype)
            held = torch.sparse_coo_tensor(index, values, self.matrix.shape, check_invariants=False)
            self._held[device, dtype] = held.coalesce()
        return self._held[device, dtype]
