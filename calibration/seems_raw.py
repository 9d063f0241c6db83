"""Whether a scan that does not say so seems raw rather than timed from the wall.

A raw scan's light is one sharp pulse at every point, whose times fit a scanner before a plane wall and a delay. Light
of a small hidden object has such times, too, but no delay. The front of a board or a ball may look the same: what is
found is a question to whoever knows.
"""

import numpy as np

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S
from nlos.calibration.background import quiet_background
from nlos.calibration.errors import InvalidData
from nlos.calibration.raw_points import RawPoints
from nlos.calibration.time_offset import measure_time_offsets

POINTS = 1024
FEWEST = 16
SPREAD = 8
"""Bins: nine points in ten cannot see a hidden surface within one bin where it comes at times this much apart."""
PULSE_S = 400e-12
"""How wide the pulse may be, tail included ..."""
IN_PULSE = 0.33
"""... that holds this share of a point's light, at nine points of ten (0.36 in the demo, 0.7 in measured scenes;
at most 0.31 in rectified scenes of `../shared/data`)."""
LEAST_DELAY_S = 150e-12
SEED = 11


def mean_arrival_s(raw: RawPoints) -> float | None:
    """When the direct light of a scan that seems raw arrives, on average; None for one that does not."""
    lit = np.flatnonzero(raw.exposure_s > 0)
    some = lit[np.sort(np.random.default_rng(SEED).permutation(len(lit))[:POINTS])]
    counts, width_s = raw.counts[some], raw.time.bin_width_s
    if not len(some) or not _one_pulse_each(counts, max(3, round(PULSE_S / width_s))):
        return None
    try:
        offsets = measure_time_offsets(counts, raw.x_m[some], raw.y_m[some], raw.time)
    except InvalidData:
        return None
    wall = offsets.wall
    if wall is None or not offsets.rms_bins < 1 or np.mean(wall.accepted) < 0.9:
        return None
    if abs(wall.delay_s) < LEAST_DELAY_S:
        return None
    return float(np.nanmean(offsets.offset_bins)) * width_s + raw.time.start_s


def aligned_later_s(raw: RawPoints) -> float | None:
    """When a pulse comes that every point has at one time, well after time 0: direct light, aligned to there.

    None for a scan without one. What a hidden surface sends back comes at times that differ between points by more,
    wherever it is: least where it is opposite their middle.
    """
    lit = np.flatnonzero(raw.exposure_s > 0)
    counts, width_s = raw.counts[lit], raw.time.bin_width_s
    if len(lit) < FEWEST or not _one_pulse_each(counts, max(3, round(PULSE_S / width_s))):
        return None
    peaks = counts.argmax(axis=1)
    at = int(np.median(peaks))
    if at * width_s < LEAST_DELAY_S or np.mean(np.abs(peaks - at) <= 1) < 0.9:
        return None
    path_m = (raw.time.start_s + at * width_s) * SPEED_OF_LIGHT_M_PER_S
    reach_m = np.hypot(np.ptp(raw.x_m[lit]), np.ptp(raw.y_m[lit])) / 2
    spread_s = (np.hypot(path_m, 2 * reach_m) - path_m) / SPEED_OF_LIGHT_M_PER_S
    return raw.time.start_s + at * width_s if spread_s > SPREAD * width_s else None


def _one_pulse_each(counts: np.ndarray, width: int) -> bool:
    """Whether so many bins around its brightest hold most of the light of nearly every point (N, T)."""
    if counts.shape[1] <= 4 * width:
        return False
    light = np.asarray(counts, dtype=np.float32) - quiet_background(counts)[:, None].astype(np.float32)
    running = np.cumsum(np.pad(light, ((0, 0), (1, 0))), axis=1, dtype=np.float64)
    inside = (running[:, width:] - running[:, :-width]).max(axis=1)
    return bool(np.quantile(inside / np.maximum(running[:, -1], 1.0), 0.1) > IN_PULSE)
