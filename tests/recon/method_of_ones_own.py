"""The brightest return: each point's light placed straight ahead, at half its path. An example; it sees no corner."""

import torch
from torch import nn

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.configs.settings import Settings as AnySettings
from nlos.recon.method import MethodResult


class Settings(AnySettings):
    """What may be set."""

    least_counts: float = 1.0
    """Points whose brightest bin holds less show nothing."""


class BrightestReturn(nn.Module):
    def __init__(self, settings: Settings, time: TimeAxis) -> None:
        super().__init__()
        self.least, self.depths_m = settings.least_counts, time.centres_s() * 299_792_458.0 / 2

    def forward(self, counts: torch.Tensor, exposure_s: torch.Tensor | None = None) -> MethodResult[torch.Tensor]:
        brightest = counts[:, 0].max(dim=1)
        depth_m = torch.from_numpy(self.depths_m).float().to(counts.device)[brightest.indices]
        return MethodResult(brightest.values, depth_m.where(brightest.values >= self.least, torch.nan))


def build(settings: Settings, wall: WallGrid, time: TimeAxis) -> nn.Module:
    return BrightestReturn(settings, time)
