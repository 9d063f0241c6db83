"""A response inverted together with the light cone, band by band of time: what the torch methods share."""

from collections.abc import Callable

import torch

from nlos.acquisition.transient import TimeAxis
from nlos.recon.transport.light_cone import LightConeConvolution
from nlos.recon.transport.resampling import LightConeResampling
from nlos.recon.transport.response_bands import BANDS, bands_of

Invert = Callable[[torch.Tensor, torch.Tensor, torch.Tensor], torch.Tensor]


def inverted_in_bands(
    signal: torch.Tensor,
    snr: float | torch.Tensor,
    response: torch.Tensor,
    time: TimeAxis,
    resample: LightConeResampling,
    cone: LightConeConvolution,
    invert: Invert,
) -> torch.Tensor:
    """The sum over bands of `invert(light on the cone, snr (1,), the response's spectrum (1, 1, F))`, (B, 1, V, H, W).

    `signal` (B, 1, T, H, W), `snr` one or (B,); `response` (B, K), shares a bin of `time`, K odd, the middle on time.
    """
    done = []
    levels = torch.as_tensor(snr, dtype=signal.dtype, device=signal.device).expand(len(signal))
    for sample, level, taps in zip(signal, levels, response.expand(len(signal), -1), strict=True):
        profile = sample.mean(dim=(0, 2, 3)).cpu().numpy()
        bands = bands_of(profile, BANDS, taps.cpu().double().numpy(), time, resample.cells, cone.padded[0])
        total: torch.Tensor | None = None
        for window, spectrum in zip(bands.windows, bands.spectra, strict=True):
            weight = torch.from_numpy(window).to(sample)[:, None, None]
            spread = torch.from_numpy(spectrum).to(sample.device)[None, None]
            part = invert(resample((sample * weight)[None]), level[None], spread)
            total = part if total is None else total + part
        assert total is not None
        done.append(total)
    return torch.cat(done)
