"""What the methods that solve on the light cone share: the way to it and back, and a response inverted with it."""

from abc import abstractmethod
from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import torch

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.physics import prepare
from nlos.recon.physics_settings import LightConeSettings
from nlos.recon.transport.conventions import depths_m
from nlos.recon.transport.falloff import Falloff
from nlos.recon.transport.light_cone import LightConeConvolution, Snr
from nlos.recon.transport.resampling import LightConeResampling
from nlos.recon.transport.response_bands import BANDS, bands_of, plane_brightness
from nlos.recon.volume_method import VolumeMethod

Prior = float | npt.NDArray[np.float64]
Invert = Callable[[torch.Tensor, Snr, torch.Tensor | None], torch.Tensor]
"""(light (B, 1, V, H, W), snr one or (B,), spectrum (1, 1, F) of a response or None) -> albedo, all on the cone."""


class LightConeMethod(VolumeMethod):
    """(B, C, T, H, W) counts -> (B, C, D, H, W) albedo, not below 0, one plane a bin: `solved` is what differs."""

    def __init__(self, settings: LightConeSettings, wall: WallGrid, time: TimeAxis) -> None:
        super().__init__()
        self.settings, self.time = settings, time
        self.depths_m = depths_m(time, settings.conventions)
        self.falloff = Falloff(time, settings.falloff, settings.conventions)
        self.resample = LightConeResampling(time, settings.conventions)
        self.cone = LightConeConvolution(wall, time, settings.conventions, settings.tile)

    def volume(
        self, counts: torch.Tensor, exposure_s: torch.Tensor | None = None, response: torch.Tensor | None = None
    ) -> torch.Tensor:
        """The albedo volume; a `response` (B, K), shares a bin, K odd, the middle on time, is part of the operator."""
        signal, snr = prepare(counts, exposure_s, self.settings, self.time, self.falloff)
        return self.resample.adjoint(self.solved(signal, snr, response)).clamp_(min=0)

    @abstractmethod
    def solved(self, signal: torch.Tensor, snr: Snr, response: torch.Tensor | None) -> torch.Tensor:
        """The albedo on the light cone, (B, C, V, H, W), from the signal over time, (B, C, T, H, W)."""

    def inverted(
        self, signal: torch.Tensor, snr: Snr, response: torch.Tensor | None, invert: Invert, prior: Prior = 1.0
    ) -> torch.Tensor:
        """`invert` of the light on the cone; with a response the sum of it over bands of time, each as bright as a
        plane would be without one. `prior` is what 1 / snr is multiplied by at lateral frequency 0."""
        if response is None:
            return invert(self.resample(signal), snr, None)
        done = []
        told = torch.as_tensor(self.settings.snr_where_told(snr), dtype=signal.dtype, device=signal.device)
        levels, responses = told.expand(len(signal)), response.expand(len(signal), -1)
        for sample, level, taps in zip(signal, levels, responses, strict=True):
            profile = sample.mean(dim=(0, 2, 3)).cpu().numpy()
            numbers = taps.cpu().double().numpy()
            bands = bands_of(profile, BANDS, numbers, self.time, self.resample.cells, self.cone.padded[0])
            bright = plane_brightness(self.cone.filter.plane_power(), bands.spectra, prior / float(level))
            total: torch.Tensor | None = None
            for window, spectrum in zip(bands.windows / bright[:, None], bands.spectra, strict=True):
                weight = torch.from_numpy(window).to(sample)[:, None, None]
                spread = torch.from_numpy(spectrum).to(sample.device)[None, None]
                part = invert(self.resample((sample * weight)[None]), level[None], spread)
                total = part if total is None else total + part
            assert total is not None
            done.append(total)
        return torch.cat(done)
