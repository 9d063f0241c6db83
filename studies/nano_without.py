"""NANO without one of its parts that no setting of its own switches, for rows of the ablation tables."""

from typing import Literal

import torch
from torch import Tensor, nn

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.configs.settings import Settings as AnySettings
from nlos.recon.layers.rates import Rates
from nlos.recon.layers.told_response import Told
from nlos.recon.layers.volume_projection import AttentionProjection
from nlos.recon.layers.wiener_volumes import WienerVolumes
from nlos.recon.methods import nano


class Settings(nano.Settings):
    """NANO's, and what it goes without."""

    without: Literal["empty gaps", "2D network"]


class FilledVolumes(WienerVolumes):
    """The volume of the rates whose gaps were left empty is that of the filled ones once more."""

    def forward(self, rates: Rates, log_noise: Tensor, response: Told | None = None) -> Tensor:
        volumes = super().forward(rates, log_noise, response)
        return torch.cat((volumes[:, :-1], volumes[:, -2:-1]), dim=1)


class Nothing(nn.Module):
    """(B, C, H, W) -> zeros (B, 2, H, W): picture and depth stay as attention has them."""

    def forward(self, inputs: Tensor) -> Tensor:
        return inputs.new_zeros(len(inputs), 2, *inputs.shape[2:])


def build(settings: AnySettings, wall: WallGrid, time_axis: TimeAxis) -> nano.Nano:
    """NANO for this wall and time axis, without that part."""
    assert isinstance(settings, Settings)
    network = nano.build(settings, wall, time_axis)
    if settings.without == "empty gaps":
        network.physics = FilledVolumes(wall, time_axis, settings.falloff)
    else:
        assert isinstance(network.projection, AttentionProjection)
        network.projection.finish = Nothing()  # type: ignore[assignment]
    return network
