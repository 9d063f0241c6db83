"""A detector's response as taps along time, (K,), K odd, the middle on time: applied, made, joined."""

import math

import torch
import torch.nn.functional as F
from torch import Tensor


def spread(light: Tensor, taps: Tensor) -> Tensor:
    """(N, T) convolved with (K,), K odd, along time."""
    if taps.numel() == 1:
        return light
    kernel = taps.flip(0).to(light)[None, None]
    return F.conv1d(light[:, None], kernel, padding=taps.numel() // 2)[:, 0]


def gaussian(width: float, like: Tensor) -> Tensor:
    """Of this standard deviation in bins; 0: no spread."""
    if width == 0:
        return like.new_ones(1)
    half = max(1, math.ceil(3 * width))
    shares = torch.exp(-0.5 * (torch.arange(-half, half + 1, device=like.device) / width).square())
    return (shares / shares.sum()).to(like)


def convolved(a: Tensor, b: Tensor) -> Tensor:
    """Two responses behind each other, as long as both."""
    return F.conv1d(F.pad(a, (len(b) - 1, len(b) - 1))[None, None], b.flip(0)[None, None])[0, 0]


def joined_bins(response: Tensor, factor: int) -> Tensor:
    """Shares a bin, of bins so many times wider; the middle stays on time."""
    half = len(response) // 2
    at = (torch.arange(len(response), device=response.device) - half) / factor
    wide = math.ceil(half / factor)
    out = response.new_zeros(2 * wide + 2)
    lower = at.floor()
    place = lower.long() + wide
    out.scatter_add_(0, place, response * (1 - (at - lower))).scatter_add_(0, place + 1, response * (at - lower))
    return out[:-1]
