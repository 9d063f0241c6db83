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


def along_time(matrix: scipy.sparse.csr_array, x: torch.Tensor) -> torch.Tensor:
    """A sparse matrix (V, T) applied along the third axis of (B, C, T, H, W)."""
    batch, channels, length, rows, cols = x.shape
    flat = x.reshape(batch * channels, length, rows * cols)
    if x.device.type == "cpu":
        held = matrix.astype(flat.numpy().dtype)
        done = torch.from_numpy(np.stack([held @ sample for sample in flat.numpy()]))
    else:
        entries = matrix.tocoo()
        index = torch.from_numpy(np.stack([entries.row, entries.col])).to(x.device)
        values = torch.from_numpy(entries.data).to(x.device, x.dtype)
        held = torch.sparse_coo_tensor(index, values, matrix.shape, check_invariants=False)
        done = torch.stack([torch.sparse.mm(held, sample) for sample in flat])
    return done.reshape(batch, channels, matrix.shape[0], rows, cols)
