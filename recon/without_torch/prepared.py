"""Counts made ready for a physics method, without torch: the same steps as `recon.physics.prepare`, for one scan."""

import numpy as np
import numpy.typing as npt

from nlos.acquisition.transient import TimeAxis
from nlos.recon.gridding import filled
from nlos.recon.noise import background_and_quality, best_snr, first_lit_bin, part_undone
from nlos.recon.physics_settings import PUBLISHED_SNR, PhysicsSettings
from nlos.recon.transport.falloff_weights import falloff_weights
from nlos.recon.transport.response_over_time import without_response

Cube = npt.NDArray[np.float32]


def prepare(
    counts: Cube,
    exposure_s: npt.NDArray[np.float64],
    settings: PhysicsSettings,
    time: TimeAxis,
    response: npt.NDArray[np.float64] | None = None,
) -> tuple[Cube, float]:
    """Signal (T, H, W) with its falloff, and a `response` (K,), undone and gaps filled, and the snr; see
    `recon.physics.prepare`."""
    measured = exposure_s > 0
    rates = counts
    if not (exposure_s == exposure_s[0, 0]).all():
        mean = exposure_s.sum() / max(int(measured.sum()), 1)
        weight = np.where(measured, mean / np.maximum(exposure_s, 1e-30), 0.0)
        rates = counts * weight.astype(counts.dtype)
    background, quality, end, opened = background_and_quality(rates[None], measured, time)
    physical = settings.conventions == "physical"
    undone = part_undone(quality) if physical else 1.0
    signal = rates.copy()
    if physical:
        first = first_lit_bin(rates[None, None])
        signal[first:] -= np.float32(background) * opened[first:, None, None]
    if response is not None:
        signal = without_response(signal, measured, response)
    weights = falloff_weights(time, settings.falloff * undone, settings.conventions)
    if physical:
        weights = weights[np.minimum(np.arange(time.bins), end - 1)]
    signal *= weights.astype(signal.dtype)[:, None, None]
    snr = settings.snr or (best_snr(quality) if physical else PUBLISHED_SNR)
    return filled(signal, measured), snr
