"""A film's pictures finished one after the other: a recurrent network that carries over what it has seen.

What is carried, features and the picture before, is brought to where it is now by the registered way and by what the
network itself sees of the ways of single objects, as in frame-recurrent video restoration (Sajjadi et al., CVPR 2018),
and taken over by a gated recurrent unit (Ballas et al., ICLR 2016).
"""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from nlos.recon.layers.residual_block import ResidualBlock
from nlos.recon.over_time.given import OWN, TOLD

WIDTH, DEEP, CARRIED, FINE = 32, 64, 32, 16
MOTION = 5  # known of what came before: whether there is anything, frames since, and the way
FLOW = 1 / 32  # wall widths of way for an output of 1
NEARER = 1 / 64  # wall widths of depth for an output of 1


@dataclass(frozen=True)
class Shown:
    """One frame: NANO's picture over its brightest point and its depth in wall widths, less a half, (B, H, W) each, and
    of `over_time.given.Given` its `own` (B, OWN, H/2, W/2) and `told` (B, TOLD)."""

    albedo: Tensor
    depth: Tensor
    own: Tensor
    told: Tensor


@dataclass(frozen=True)
class Carried:
    """From one frame to the next: features (B, C, H/2, W/2), picture and depth (B, H, W)."""

    features: Tensor
    albedo: Tensor
    depth: Tensor


class FilmNetwork(nn.Module):
    """Frames in, pictures and what is carried out. Untrained it leaves pictures as they are."""

    def __init__(self) -> None:
        super().__init__()
        picture = 2 * 4  # two fields, four pixels of the finer grid to one of the coarser
        self.look = nn.Conv2d(picture + OWN + TOLD + MOTION, WIDTH, 3, padding=1)
        self.looked = ResidualBlock(2, WIDTH)
        self.ways = nn.Sequential(
            nn.Conv2d(WIDTH + CARRIED + picture, 32, 3, padding=1), nn.ReLU(),
            nn.Conv2d(32, 32, 3, padding=1), nn.ReLU(), nn.Conv2d(32, 2, 3, padding=1),
        )  # fmt: skip
        self.merge = nn.Conv2d(WIDTH + CARRIED + picture, WIDTH, 3, padding=1)
        self.merged = ResidualBlock(2, WIDTH)
        self.down = nn.Conv2d(WIDTH, DEEP, 3, stride=2, padding=1)
        self.deep = nn.Sequential(ResidualBlock(2, DEEP), ResidualBlock(2, DEEP))
        self.up = nn.Conv2d(DEEP, WIDTH, 1)
        self.last = ResidualBlock(2, WIDTH)
        self.gates = nn.Conv2d(WIDTH + CARRIED, 2 * CARRIED, 3, padding=1)
        self.fine = nn.Conv2d(WIDTH + CARRIED, 4 * FINE, 3, padding=1)
        self.finest = nn.Conv2d(FINE + 4, FINE, 3, padding=1)
        self.head = nn.Conv2d(FINE, 4, 3, padding=1)
        for parameter in (*self.ways[-1].parameters(), *self.head.parameters()):
            nn.init.zeros_(parameter)

    def forward(self, shown: Shown, before: Carried | None, way: Tensor, gap: Tensor) -> tuple[Tensor, Tensor, Carried]:
        """`way` (B, 3) in wall widths that what is seen has moved since the frame that `before` is of, `gap` (B,) how
        many frames ago that was -> brightness, from 0, and depth as it came, (B, H, W) each, and what is carried."""
        there = 0.0 if before is None else 1.0
        if before is None:
            size = (shown.albedo.shape[1] // 2, shown.albedo.shape[2] // 2)
            before = Carried(shown.own.new_zeros(len(way), CARRIED, *size), shown.albedo * 0, shown.depth)
            way = way * 0
        motion = torch.cat((torch.full_like(way[:, :1], there), there * gap[:, None].log2(), 8 * way), dim=1)
        told = torch.cat((shown.told, motion), dim=1)[:, :, None, None].expand(-1, -1, *shown.own.shape[2:])
        looked = self.looked(self.look(torch.cat((_folded(shown.albedo, shown.depth), shown.own, told), dim=1)))
        flow = way[:, :2, None, None].expand(-1, -1, *shown.own.shape[2:])
        moved = _moved(before, flow, way[:, 2])
        flow = flow + there * FLOW * self.ways(torch.cat((looked, *_all_of(moved)), dim=1)).float()
        moved = _moved(before, flow, way[:, 2])
        x = self.merged(self.merge(torch.cat((looked, *_all_of(moved)), dim=1)))
        coarse = F.interpolate(self.up(self.deep(self.down(x))), size=x.shape[2:], mode="bilinear")
        x = self.last(x + coarse)
        update, new = self.gates(torch.cat((x, moved.features), dim=1)).float().chunk(2, dim=1)
        update = update.sigmoid()
        features = (1 - update) * moved.features + update * new.tanh()
        fine = F.pixel_shuffle(F.relu(self.fine(torch.cat((x, features), dim=1))), 2)
        pictures = torch.stack((shown.albedo, shown.depth, moved.albedo, moved.depth), dim=1)
        out = self.head(F.relu(self.finest(torch.cat((fine, pictures), dim=1)))).float()
        share, added, deep_share, deeper = out.unbind(dim=1)
        albedo = (shown.albedo + there * share * (moved.albedo - shown.albedo) + added).clamp(min=0)
        depth = shown.depth + there * deep_share * (moved.depth - shown.depth) + NEARER * deeper
        return albedo, depth, Carried(features, albedo.clamp(max=1), depth)


def _folded(albedo: Tensor, depth: Tensor) -> Tensor:
    return F.pixel_unshuffle(torch.stack((albedo, depth), dim=1), 2)


def _all_of(carried: Carried) -> tuple[Tensor, Tensor]:
    return carried.features, _folded(carried.albedo, carried.depth)


def _moved(carried: Carried, flow: Tensor, deeper: Tensor) -> Carried:
    """By `flow` (B, 2, h, w), to the right and up, in wall widths."""
    albedo, depth = _sampled(torch.stack((carried.albedo, carried.depth), dim=1), flow).unbind(dim=1)
    return Carried(_sampled(carried.features, flow), albedo, depth + deeper[:, None, None])


def _sampled(fields: Tensor, flow: Tensor) -> Tensor:
    """(B, C, H, W) at where each place was before."""
    rows, cols = fields.shape[2:]
    if flow.shape[2:] != fields.shape[2:]:
        flow = F.interpolate(flow, size=(rows, cols), mode="bilinear", align_corners=False)
    y = (torch.arange(rows, device=fields.device) + 0.5) * (2 / rows) - 1
    x = (torch.arange(cols, device=fields.device) + 0.5) * (2 / cols) - 1
    at = torch.stack((x - 2 * flow[:, 0], y[:, None] + 2 * flow[:, 1]), dim=-1)
    return F.grid_sample(fields.float(), at, padding_mode="border", align_corners=False)
