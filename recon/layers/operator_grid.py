"""Volumes on the grid that the operator works on."""

import torch.nn.functional as F
from torch import Tensor


def to_grid(field: Tensor, size: tuple[int, int, int], highest: bool = False) -> Tensor:
    """(B, C, D, H, W) averaged (or its maximum) over the cells of a coarser grid; interpolated to a finer one."""
    if all(new <= old for new, old in zip(size, field.shape[2:], strict=True)):
        for dim, new in enumerate(size, 2):  # as torch's own pooling, which takes up to ten times as long
            if field.shape[dim] % new == 0 and (highest or dim == 2):
                groups = field.reshape(*field.shape[:dim], new, -1, *field.shape[dim + 1 :])
                field = groups.amax(dim=dim + 1) if highest else groups.mean(dim=dim + 1)
        if tuple(field.shape[2:]) == size:
            return field
        return F.adaptive_max_pool3d(field, size) if highest else F.adaptive_avg_pool3d(field, size)
    return F.interpolate(field, size=size, mode="trilinear")
