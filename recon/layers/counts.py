"""Counts as every network takes them first: neighbouring bins added up, exposure over its mean."""

from typing import NamedTuple

import torch.nn.functional as F
from torch import Tensor


class Exposed(NamedTuple):
    """How long the points of a scan were exposed."""

    relative: Tensor  # (B, H, W), mean 1 over the measured points, 0 = not measured
    measured: Tensor  # (B, H, W) bool
    points: Tensor  # (B,) how many were measured, at least 1


def added(x: Tensor, factor: int, bins: int) -> Tensor:
    """(B, C, T, H, W) -> (B, C, bins, H, W): so many neighbours added, zeros after the end, what is beyond cut."""
    used = x[:, :, : bins * factor]
    if missing := bins * factor - used.shape[2]:
        used = F.pad(used, (0, 0, 0, 0, 0, missing))
    return used.reshape(*used.shape[:2], bins, factor, *used.shape[3:]).sum(dim=3)


def exposed(counts: Tensor, exposure: Tensor | None) -> Exposed:
    """Of counts (B, 1, T, H, W); exposure (B, H, W) in any unit, 0 = not measured, or None for an even one."""
    if exposure is None:
        exposure = counts.new_ones(counts.shape[0], *counts.shape[3:])
    exposure = exposure.to(counts)
    measured = exposure > 0
    points = measured.sum(dim=(1, 2)).clamp(min=1)
    mean = (exposure.sum(dim=(1, 2)) / points).clamp(min=1e-30)
    return Exposed(exposure / mean[:, None, None], measured, points)
