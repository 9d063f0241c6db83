"""NLOST's attention: over the wall at every depth, then over depth at every pixel, in windows or everywhere."""

import torch
import torch.nn.functional as F
from torch import Tensor, nn


class Attention(nn.Module):
    """Multi-head self-attention over the middle axis of (N, L, C), with a bias table of relative places if asked for.

    Runs through the memory-efficient kernel: nothing of size L x L a head is kept.
    """

    def __init__(self, channels: int, heads: int, window: tuple[int, int] | None = None) -> None:
        super().__init__()
        self.heads = heads
        self.qkv = nn.Linear(channels, 3 * channels, bias=window is not None)
        self.out = nn.Linear(channels, channels)
        self.window = window
        if window is not None:
            self.table = nn.Parameter(torch.zeros((2 * window[0] - 1) * (2 * window[1] - 1), heads))
            nn.init.trunc_normal_(self.table, std=0.02)

    def bias(self, rows: int, cols: int) -> Tensor:
        """(heads, L, L) for a window of rows x cols, which may be smaller than the table's."""
        assert self.window is not None
        i = torch.arange(rows)[:, None] - torch.arange(rows)[None] + self.window[0] - 1
        j = torch.arange(cols)[:, None] - torch.arange(cols)[None] + self.window[1] - 1
        index = i[:, None, :, None] * (2 * self.window[1] - 1) + j[None, :, None, :]
        return self.table[index.reshape(rows * cols, rows * cols).to(self.table.device)].permute(2, 0, 1)

    def forward(self, x: Tensor, grid: tuple[int, int] | None = None) -> Tensor:
        q, k, v = self.qkv(x).reshape(*x.shape[:2], 3, self.heads, -1).permute(2, 0, 3, 1, 4)
        mask = None if grid is None else self.bias(*grid).to(q.dtype)
        mixed = F.scaled_dot_product_attention(q, k, v, attn_mask=mask)
        out: Tensor = self.out(mixed.transpose(1, 2).reshape(x.shape))
        return out


class Perceptron(nn.Module):
    """LN, then two layers, four times as wide between."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.LayerNorm(channels), nn.Linear(channels, 4 * channels), nn.GELU(), nn.Linear(4 * channels, channels)
        )

    def forward(self, x: Tensor) -> Tensor:
        out: Tensor = self.layers(x)
        return out


class LocalEncoder(nn.Module):
    """(B, C, D, H, W) -> the same: attention in windows of the wall, straight into attention over depth, then an MLP.

    Windows do not overlap; the last of a row may be smaller (padded, the padding cut off afterwards).
    """

    def __init__(self, channels: int, heads: int, window: int, depths: int = 64) -> None:
        super().__init__()
        self.window, self.depths = window, depths
        self.norm = nn.LayerNorm(channels)
        self.space = Attention(channels, heads, (window, window))
        self.depth = Attention(channels, heads, (1, depths))
        self.mlp = Perceptron(channels)

    def forward(self, x: Tensor) -> Tensor:
        batch, channels, depth, rows, cols = x.shape
        if depth > self.depths:
            raise ValueError(f"{depth} depth tokens, but the bias table holds {self.depths}: record fewer time bins")
        tall, wide = min(self.window, rows), min(self.window, cols)
        tokens = x.permute(0, 2, 3, 4, 1)  # (B, D, H, W, C)
        y = F.pad(self.norm(tokens), (0, 0, 0, -cols % wide, 0, -rows % tall))
        down, across = y.shape[2] // tall, y.shape[3] // wide
        y = y.reshape(batch, depth, down, tall, across, wide, channels).transpose(3, 4)
        y = self.space(y.reshape(-1, tall * wide, channels), (tall, wide))
        y = y.reshape(batch, depth, down, across, tall, wide, channels).transpose(3, 4)
        y = y.reshape(batch, depth, down * tall, across * wide, channels)[:, :, :rows, :cols]
        y = _over_depth(y, self.depth, (1, depth))
        tokens = tokens + y
        out: Tensor = (tokens + self.mlp(tokens)).permute(0, 4, 1, 2, 3)
        return out


class GlobalEncoder(nn.Module):
    """(B, C, D, H, W) -> the same: attention over the whole wall at every depth, then over depth, then an MLP."""

    def __init__(self, channels: int, heads: int) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(channels)
        self.space = Attention(channels, heads)
        self.depth = Attention(channels, heads)
        self.mlp = Perceptron(channels)

    def forward(self, x: Tensor) -> Tensor:
        batch, channels, depth, rows, cols = x.shape
        tokens = x.permute(0, 2, 3, 4, 1)
        y = self.space(self.norm(tokens).reshape(batch * depth, rows * cols, channels))
        y = _over_depth(y.reshape(batch, depth, rows, cols, channels), self.depth, None)
        tokens = tokens + y
        out: Tensor = (tokens + self.mlp(tokens)).permute(0, 4, 1, 2, 3)
        return out


def _over_depth(x: Tensor, attention: Attention, grid: tuple[int, int] | None) -> Tensor:
    """`attention` along D of (B, D, H, W, C)."""
    batch, depth, rows, cols, channels = x.shape
    y = attention(x.permute(0, 2, 3, 1, 4).reshape(-1, depth, channels), grid)
    out: Tensor = y.reshape(batch, rows, cols, depth, channels).permute(0, 3, 1, 2, 4)
    return out


class CompactNonLocal(nn.Module):
    """The compact generalised non-local form: every head's values times the scalar <q, k>; begins as nothing.

    query, value (N, C, L) -> (N, C, L). The group normalisation's gain starts at 0, so a block starts as identity.
    """

    def __init__(self, channels: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.query, self.key, self.value = (nn.Conv1d(channels, channels, 1, bias=False) for _ in range(3))
        self.out = nn.Conv1d(channels, channels, 1, groups=heads, bias=False)
        self.norm = nn.GroupNorm(heads, channels)
        nn.init.zeros_(self.norm.weight)
        nn.init.zeros_(self.norm.bias)

    def forward(self, query: Tensor, value: Tensor) -> Tensor:
        shape = (value.shape[0], self.heads, -1)
        q, k, v = (part.reshape(shape) for part in (self.query(query), self.key(value), self.value(value)))
        scale = (value.shape[1] // self.heads) ** -0.5 / q.shape[2] ** 0.5
        likeness = (q.float() * k.float()).sum(dim=2, keepdim=True) * scale
        out: Tensor = self.norm(self.out((likeness * v).reshape(value.shape)))
        return out


class CrossDecoder(nn.Module):
    """This branch asked by the other, (B, C, D, H, W) both: over the wall, then over depth, then an MLP.

    `doubled` adds the result twice, as the published block does. Scores are divided by the root of the number of
    tokens (the group normalisation undoes any factor, but half precision cannot hold the sum).
    """

    def __init__(self, channels: int, heads: int, doubled: bool = False) -> None:
        super().__init__()
        self.doubled = doubled
        self.norm_own, self.norm_other = nn.LayerNorm(channels), nn.LayerNorm(channels)
        self.space, self.depth = CompactNonLocal(channels, heads), CompactNonLocal(channels, heads)
        self.mlp = Perceptron(channels)

    def forward(self, own: Tensor, other: Tensor) -> Tensor:
        batch, channels, depth, rows, cols = own.shape
        tokens = own.permute(0, 2, 3, 4, 1)
        value, query = self.norm_own(tokens), self.norm_other(other.permute(0, 2, 3, 4, 1))

        def by_depth(x: Tensor) -> Tensor:  # (B D, C, H W)
            return x.permute(0, 1, 4, 2, 3).reshape(batch * depth, channels, rows * cols)

        def by_pixel(x: Tensor) -> Tensor:  # (B H W, C, D)
            return x.permute(0, 2, 3, 4, 1).reshape(batch * rows * cols, channels, depth)

        space = self.space(by_depth(query), by_depth(value)).reshape(batch, depth, channels, rows, cols)
        space = value + space.permute(0, 1, 3, 4, 2)
        deep = self.depth(by_pixel(query), by_pixel(space)).reshape(batch, rows, cols, channels, depth)
        result = tokens + deep.permute(0, 4, 1, 2, 3)
        if self.doubled:
            result = result + deep.permute(0, 4, 1, 2, 3)
        out: Tensor = (result + self.mlp(result)).permute(0, 4, 1, 2, 3)
        return out
