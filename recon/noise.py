"""How noisy a transient is, from nothing but its own counts, and what that means for an inverse filter."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from nlos.acquisition.transient import TimeAxis
from nlos.recon.gate import open_bins

if TYPE_CHECKING:
    import torch

REFERENCE_BIN_S = 32e-12
REFERENCE_POINTS = 64 * 64
MOST_LINES = 32  # of a wall measured everywhere, in each direction; more tell no more about its noise
WINDOWS = 20  # the background is the darkest of this many stretches of the time axis

SHORTEST_STRETCH = 8
STANDS_OUT = 6.0  # in standard deviations of a stretch's sum, over all points

# Measured on seven scenes of a foreign renderer, noiseless and at 20, 5 and 1 peak counts: log10 of the quality, the
# part of the falloff exponent worth undoing, and log10 of the best snr. See docs/decisions/060.
QUALITY = (-0.4, 0.26, 0.73, 1.1, 2.0)
UNDONE = (0.52, 0.64, 0.76, 1.0, 1.0)
LOG_SNR = (-1.5, -1.1, -0.9, 0.0, 0.3)


@dataclass(frozen=True)
class Noise:
    """What was found in a batch, one value a sample."""

    background: "torch.Tensor"  # (B,) counts per bin, ambient light and dark counts
    quality: "torch.Tensor"
    """(B,) log10 of signal over noise energy up to `end`, as if in 32 ps bins on 64 x 64 points."""
    end: "torch.Tensor"
    """(B,) the bin after the last one that holds light: later ones hold noise alone."""
    opened: "torch.Tensor"
    """(B, T) False where a gate was shut, and no background is."""

    def snr(self) -> "torch.Tensor":
        """The signal to noise ratio at which a Wiener filter serves best, (B,)."""
        return 10 ** _interpolate(self.quality, LOG_SNR)

    def undone(self) -> "torch.Tensor":
        """The part of the falloff exponent worth undoing, (B,): 1 unless far bins hold mostly noise."""
        return _interpolate(self.quality, UNDONE)


class OneNoise(NamedTuple):
    """`Noise` of one sample."""

    background: float
    quality: float
    end: int
    opened: npt.NDArray[np.bool_]  # (T,)


def estimate(rates: "torch.Tensor", measured: "torch.Tensor | None", time: TimeAxis) -> Noise:
    """Background and quality of (B, C, T, H, W) over the points `measured` (B, H, W), or all.

    Noise is white along time and light is not, so the second difference along time is nearly all noise. Bins that
    are 0 everywhere at the beginning (cut, or gated) take no part.
    """
    import torch

    found = [_estimate(sample, None if measured is None else measured[b], time) for b, sample in enumerate(rates)]
    numbers = torch.tensor([one[:3] for one in found], dtype=torch.float64)
    background, quality, end = numbers.T.to(rates.device)
    opened = torch.from_numpy(np.stack([one.opened for one in found])).to(rates.device)
    return Noise(background.to(rates.dtype), quality.to(rates.dtype), end.long(), opened)


def _estimate(sample: "torch.Tensor", measured: "torch.Tensor | None", time: TimeAxis) -> OneNoise:
    if sample.device.type == "cpu":
        return background_and_quality(sample.detach().numpy(), None if measured is None else measured.numpy(), time)
    import torch

    if measured is None or bool(measured.all()):
        rows, cols = (torch.from_numpy(_spread(size)).to(sample.device) for size in sample.shape[-2:])
        chosen, points = sample[..., rows[:, None], cols].flatten(2), sample.shape[-2] * sample.shape[-1]
    else:
        chosen, points = sample[..., measured], int(measured.sum())
    return _judge(chosen.detach().cpu().numpy(), points, time)


def background_and_quality(
    sample: npt.NDArray[np.floating[Any]], measured: npt.NDArray[np.bool_] | None, time: TimeAxis
) -> OneNoise:
    """`estimate` for one sample (C, T, H, W)."""
    if measured is None or measured.all():
        rows, cols = (_spread(size) for size in sample.shape[-2:])
        chosen = sample[..., rows[:, None], cols].reshape(*sample.shape[:2], -1)
        return _judge(chosen, sample.shape[-2] * sample.shape[-1], time)
    return _judge(sample[..., measured], int(measured.sum()), time)


def best_snr(quality: float) -> float:
    """The signal to noise ratio at which a Wiener filter serves best."""
    return float(10 ** np.interp(quality, QUALITY, LOG_SNR))


def part_undone(quality: float) -> float:
    """The part of the falloff exponent worth undoing."""
    return float(np.interp(quality, QUALITY, UNDONE))


def _judge(x: npt.NDArray[np.floating[Any]], points: int, time: TimeAxis) -> OneNoise:
    """Of chosen points (C, T, N), a few MB, for which NumPy on one core is quickest, out of `points`."""
    first = first_lit_bin(x[None, ..., None])
    gate = open_bins(np.concatenate(list(x), axis=1))
    opened = np.ones(x.shape[1], bool) if gate is None else gate
    lit, there = x[:, first:], opened[first:]
    mean = lit.mean(axis=(0, 2), dtype=np.float64)
    seen = mean[there]
    stretch = max(min(8, len(seen)), len(seen) // WINDOWS)
    background = float(np.convolve(seen, np.full(stretch, 1 / stretch), mode="valid").min())
    end = last_lit_bin(mean - background * there)
    lit = lit[:, :end] - np.float32(background) * there[:end, None]
    energy = float(np.mean(lit**2, dtype=np.float64))
    noise = energy
    if lit.shape[1] > 2:
        noise = float(np.mean(np.diff(lit, 2, axis=1) ** 2, dtype=np.float64)) / 6
    ratio = min(max((energy - noise) / max(noise, 1e-300), 1e-3), 1e6)
    quality = float(np.log10(ratio * (REFERENCE_BIN_S / time.bin_width_s) * (points / REFERENCE_POINTS)))
    return OneNoise(background, quality, first + end, opened)


def without_background(rates: "torch.Tensor", noise: Noise) -> "torch.Tensor":
    """`rates` less the background (B,), where bins at the beginning that were cut, or in which a gate was shut, stay
    0."""
    level = noise.background.to(rates.dtype).view(-1, 1, 1, 1, 1) * noise.opened.view(len(rates), 1, -1, 1, 1)
    level[:, :, : first_lit_bin(rates)] = 0
    return rates - level


def first_lit_bin(rates: Any) -> int:
    """The first bin of (B, C, T, H, W) that is not 0 everywhere; 0 if all are. Arrays or tensors."""
    for k in range(rates.shape[2]):
        if rates[:, :, k].any():
            return k
    return 0


def last_lit_bin(excess: npt.NDArray[np.float64]) -> int:
    """The bin after the last stretch of `excess` (T,), the mean over points less the background, that stands out of its
    noise; T where none does."""
    bins = len(excess)
    if bins < 8 * SHORTEST_STRETCH:
        return bins
    sigma = float(np.sqrt(np.mean(np.diff(excess, 2) ** 2) / 6))
    ends = []
    for length in (SHORTEST_STRETCH, max(SHORTEST_STRETCH, bins // 64), max(SHORTEST_STRETCH, bins // 16)):
        sums = np.convolve(excess, np.ones(length), mode="valid")
        standing = np.flatnonzero(sums > STANDS_OUT * sigma * np.sqrt(length))
        ends += [int(standing[-1]) + length] if len(standing) else []
    return max(ends) if ends else bins


def _spread(size: int) -> npt.NDArray[np.int64]:
    """Up to `MOST_LINES` indices below `size`, evenly spread and the same from either end."""
    if size <= MOST_LINES:
        return np.arange(size)
    half = (2 * np.arange(MOST_LINES // 2) + 1) * size // (2 * MOST_LINES)
    return np.concatenate([half, size - 1 - half[::-1]])


def _interpolate(x: "torch.Tensor", values: tuple[float, ...]) -> "torch.Tensor":
    import torch

    found = np.interp(x.detach().cpu().double().numpy(), QUALITY, values)
    return torch.from_numpy(found).to(x.device, x.dtype)
