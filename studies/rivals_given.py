"""LFE, NLOST and the U-Net, shown gaps filled as well as empty, as NANO is: for rows of the ablation tables.

As they ship they see the gaps of a sparse scan empty alone. Here the same rates come once more with the gaps filled
as NANO fills them; of a whole scan both are the same.
"""

from typing import Literal

import torch
from torch import Tensor, nn

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.configs.settings import Settings as AnySettings
from nlos.recon.layers.counts import exposed
from nlos.recon.layers.rates import fill
from nlos.recon.layers.unet import UNet
from nlos.recon.layers.volume_projection import AttentionProjection
from nlos.recon.layers.wiener_features import SNR_FACTORS, Counted, Features, WienerFeatures, counted, normalised
from nlos.recon.layers.wiener_volumes import ALIASING
from nlos.recon.methods import lfe, nlost, unet

VOLUMES = len(SNR_FACTORS) + 1


class Settings(AnySettings):
    """Which of them, and what is set there."""

    rival: Literal["lfe", "nlost", "unet"]
    farthest: float = 2.0
    weights: str | None = None


def filled_rates(seen: Counted, counts: Tensor, exposure: Tensor | None) -> Tensor:
    """(B, 1, T, H, W): the rates with their gaps filled, weighted by exposure as `rates.fill` does."""
    relative = exposed(counts, exposure).relative
    return fill(seen.rate * relative[:, None, None], relative)


class GivenLfe(lfe.LearnedFeatureEmbeddings):
    """LFE whose encoder is shown both."""

    inputs = 2

    def shown(self, seen: Counted, counts: Tensor, exposure: Tensor | None) -> Tensor:
        return torch.cat((filled_rates(seen, counts, exposure), seen.rate), dim=1)


class GivenNlost(nlost.Nlost):
    """NLOST whose encoder is shown both."""

    inputs = 2

    def shown(self, seen: Counted, counts: Tensor, exposure: Tensor | None) -> Tensor:
        return torch.cat((filled_rates(seen, counts, exposure), seen.rate), dim=1)


class FilledAndEmpty(WienerFeatures):
    """Two volumes of the filled rates and, as NANO's third, the sharper one of those with empty gaps."""

    @torch.no_grad()
    def forward(self, counts: Tensor, exposure: Tensor | None) -> Features:
        seen = counted(counts, exposure, self.together)
        kept = seen.measured.mean(dim=(1, 2)).clamp(min=1 / seen.measured[0].numel())
        snrs = [seen.snr * factor for factor in SNR_FACTORS]
        aliased = 1 / (1 / snrs[-1] + ALIASING * (1 / kept - 1))
        filled = self.light_cone(filled_rates(seen, counts, exposure), seen.exponent, torch.stack(snrs, dim=1))
        empty = self.light_cone(seen.rate, seen.exponent, aliased[:, None])
        volumes = normalised(torch.cat((filled, empty), dim=1)).clamp(-3, 4)
        return Features(volumes, self.light_cone.depths_m, seen)


class GivenUNet(unet.UNetMethod):
    """The U-Net over three volumes."""

    def __init__(self, settings: unet.Settings, wall: WallGrid, time: TimeAxis) -> None:
        super().__init__(settings, wall, time)
        self.physics = FilledAndEmpty(wall, time, farthest=settings.farthest)
        self.core = UNet(3, 2 * VOLUMES, 1 + settings.features, settings.widths)
        nn.init.normal_(self.core.head.weight, std=0.05)
        self.projection = AttentionProjection(VOLUMES, settings.features, 1, settings.finish_widths)


def build(settings: AnySettings, wall: WallGrid, time_axis: TimeAxis) -> nn.Module:
    """That network for this wall and time axis, untrained."""
    assert isinstance(settings, Settings)
    own = {"farthest": settings.farthest, "weights": None}
    if settings.rival == "lfe":
        return GivenLfe(lfe.Settings.model_validate(own), wall, time_axis)
    if settings.rival == "nlost":
        return GivenNlost(nlost.Settings.model_validate(own), wall, time_axis)
    return GivenUNet(unet.Settings.model_validate(own), wall, time_axis)
