"""How noisy a transient is, from nothing but its own counts, and what that means for an inverse filter."""

from dataclasses import dataclass

import numpy as np
import torch

from acquisition.transient import TimeAxis

REFERENCE_BIN_S = 32e-12
REFERENCE_POINTS = 64 * 64
WINDOWS = 20  # the background is the darkest of this many stretches of the time axis

# Measured on seven scenes of a foreign renderer, noiseless and at 20, 5 and 1 peak counts: log10 of the quality, the
# part of the falloff exponent worth undoing, and log10 of the best snr. See docs/decisions/060.
QUALITY = (-0.4, 0.26, 0.73, 1.1, 2.0)
UNDONE = (0.52, 0.64, 0.76, 1.0, 1.0)
LOG_SNR = (-1.5, -1.1, -0.9, 0.0, 0.3)


@dataclass(frozen=True)
class Noise:
    """What was found in a batch, one value a sample."""

    background: torch.Tensor  # (B,) counts a bin, ambient light and dark counts
    quality: torch.Tensor
    """(B,) log10 of signal over noise energy, as if in 32 ps bins on 64 x 64 points."""

    def snr(self) -> torch.Tensor:
        """The signal to noise ratio at which a Wiener filter serves best, (B,)."""
        return 10 ** _interpolate(self.quality, LOG_SNR)

    def undone(self) -> torch.Tensor:
        """The part of the falloff exponent worth undoing, (B,): 1 unless far bins hold mostly noise."""
        return _interpolate(self.quality, UNDONE)


def estimate(rates: torch.Tensor, measured: torch.Tensor | None, time: TimeAxis) -> Noise:
    """Background and quality of (B, C, T, H, W) over the points `measured` (B, H, W), or all.

    Noise is white along time and light is not, so the second difference along time is nearly all noise. Bins that
    are 0 everywhere at the beginning (cut, or gated) take no part.
    """
    first = first_lit_bin(rates)
    batch = rates.shape[0]
    if measured is None:
        measured = torch.ones(batch, *rates.shape[-2:], dtype=torch.bool, device=rates.device)
    weight = measured[:, None, None].to(rates.dtype)
    points = weight.sum((1, 2, 3, 4))
    lit = rates[:, :, first:]
    mean = (lit * weight).sum((1, 3, 4)) / (points * rates.shape[1])[:, None]  # (B, T)
    stretch = max(min(8, mean.shape[1]), mean.shape[1] // WINDOWS)
    background = mean.unfold(1, stretch, 1).mean(-1).amin(1)
    energy = ((lit - background.view(-1, 1, 1, 1, 1)).square() * weight).mean((1, 2, 3, 4))
    noise = energy
    if lit.shape[2] > 2:
        second = lit[:, :, 2:] - 2 * lit[:, :, 1:-1] + lit[:, :, :-2]
        noise = (second.square() * weight).mean((1, 2, 3, 4)) / 6
    ratio = ((energy - noise) / noise.clamp(min=1e-30)).clamp(1e-3, 1e6)
    per_reference = (REFERENCE_BIN_S / time.bin_width_s) * points / REFERENCE_POINTS
    return Noise(background, torch.log10(ratio * per_reference))


def without_background(rates: torch.Tensor, background: torch.Tensor) -> torch.Tensor:
    """`rates` less `background` (B,), where bins at the beginning that were cut or gated stay 0."""
    level = background.to(rates.dtype).view(-1, 1, 1, 1, 1).expand(-1, 1, rates.shape[2], 1, 1).clone()
    level[:, :, : first_lit_bin(rates)] = 0
    return rates - level


def first_lit_bin(rates: torch.Tensor) -> int:
    """The first bin that is not 0 everywhere; 0 if all are."""
    lit = rates.ne(0).any(-1).any(-1).any(1).any(0)
    return int(lit.to(torch.uint8).argmax())


def _interpolate(x: torch.Tensor, values: tuple[float, ...]) -> torch.Tensor:
    found = np.interp(x.detach().cpu().double().numpy(), QUALITY, values)
    return torch.from_numpy(found).to(x.device, x.dtype)
