"""When the direct light of every point arrives, to a fraction of a bin: the brightest pulses if a plane wall explains
them, else the earliest, which a gated detector leaves fainter than a hidden object's light."""

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from nlos.acquisition.transient import TimeAxis
from nlos.calibration.arrival_rounds import DETECTION, Record, TimeOffsets, refined
from nlos.calibration.background import quiet_background
from nlos.calibration.by_blocks import chosen
from nlos.calibration.errors import InvalidData, NoDirectPeak, ShutterClosed
from nlos.calibration.impulse_response import ImpulseResponse
from nlos.calibration.matched_filter import boxcar_arrival, earliest_pulse, later_pulse, misfit, neighbours
from nlos.calibration.pane import is_pane
from nlos.calibration.wall_timing import FEWEST_POINTS

BOX_S = 100e-12
ACCEPTED_SHARE = 0.8
"""Of the arrivals near the fitted wall, the fit accepts so many ..."""
SEEN_SHARE = 0.5
"""... and so many points showed their pulse there before there was a fit."""
NEIGHBOURS = 9
UNLIKE = 0.05
"""Direct pulses have one shape: 0.01 in measured scans. Letters behind the corner: 0.09 to 0.17."""
AS_BRIGHT = 0.1
"""Of what is taken for direct light: a later pulse at `ACCEPTED_SHARE` of the points that may be the wall's."""
HIDDEN = (
    "what is brightest at {points} points comes at times that no plane wall explains, and its shape changes from point "
    "to point: it is a hidden object's light, and direct light is missing (a gated detector?) or too faint. Time 0 has "
    "to be told: `nlos calibrate` a scan of this bench that has its direct light, and give its constants with "
    "--constants; or use the file's own times of the wall with --set offsets=file."
)


def measure_time_offsets(
    counts: npt.ArrayLike,
    x_m: npt.ArrayLike,
    y_m: npt.ArrayLike,
    time: TimeAxis,
    response: ImpulseResponse | None = None,
    exposed: npt.ArrayLike | None = None,
) -> TimeOffsets:
    """The arrival of direct light at every point.

    `counts` (N, T) raw, `x_m` and `y_m` (N,) on the wall, `exposed` (N,) False for points that were not measured.
    Raises `NoDirectPeak` where hardly a point shows a pulse, `ShutterClosed` where the counts do not even vary.
    """
    recorded = np.asarray(counts)
    x, y = np.asarray(x_m, dtype=np.float64), np.asarray(y_m, dtype=np.float64)
    lit = np.ones(len(recorded), bool) if exposed is None else np.asarray(exposed, dtype=bool)
    box = max(3, round(BOX_S / time.bin_width_s))
    if recorded.shape[1] <= 2 * box:
        raise InvalidData(f"histograms of {recorded.shape[1]} bins are too short to find a pulse of {box} bins in.")
    record = Record(recorded, x, y, time, lit, quiet_background(recorded), box)
    first, gain = np.full(len(recorded), box / 2), np.zeros(len(recorded))
    some = chosen(recorded, lit)  # of a scan that has just begun, few
    first[lit], gain[lit] = boxcar_arrival(some, record.background[lit], box)
    try:
        brightest = refined(record, response, first, gain)
        behind = _behind_a_pane(record, brightest)
        if behind is not None:
            return behind
        if brightest.on_a_plane or lit.sum() < FEWEST_POINTS:
            return brightest
        if _unlike(record, brightest) > UNLIKE:
            raise NoDirectPeak(HIDDEN.format(points=int(brightest.found.sum())))
    except ShutterClosed:
        raise
    except NoDirectPeak:
        found = _of_earliest_light(record, response)
        if found is None:
            raise
        return found
    return _of_earliest_light(record, response) or brightest


def _of_earliest_light(record: Record, response: ImpulseResponse | None) -> TimeOffsets | None:
    """Where hidden light outshines the direct light of a gated detector: direct light is what comes first, as long as a
    plane wall explains it; where it is faint, points are looked at together with their neighbours. Light that comes at
    one time everywhere tells no wall from a stray reflection."""
    lit = np.flatnonzero(record.lit)
    for together in (1, NEIGHBOURS):
        near = neighbours(record.x[lit], record.y[lit], together)
        first, gain = np.full(len(record.lit), record.box / 2), np.zeros(len(record.lit))
        first[lit], gain[lit] = earliest_pulse(record.recorded, lit[near], record.background, record.box, DETECTION)
        try:
            found = refined(record, response, first, gain, steps=False)
        except NoDirectPeak:
            continue
        if found.wall is None or not found.on_a_plane or found.wall.accepted[found.found].mean() < ACCEPTED_SHARE:
            continue
        seen_there = np.abs(first - found.predicted_bins)[lit] < record.box  # before anything was known of the wall
        if seen_there.mean() > SEEN_SHARE and np.ptp(found.predicted_bins) > 4 * max(found.rms_bins, 0.1):
            return _behind_a_pane(record, found) or found
    return None


def _behind_a_pane(record: Record, first: TimeOffsets) -> TimeOffsets | None:
    """The wall's light where what was found is a pane's before it; None where nothing as sharp and bright comes later,
    or no pane explains it."""
    seen = first.found
    if first.wall is None or not seen.any():
        return None
    after = record.box + first.response.end_s / first.bin_width_s
    start = np.where(seen, first.offset_bins + after, 0.0)
    later, gain, above = later_pulse(record.recorded, start, record.background, record.box)
    bright = (gain > DETECTION) & (above > AS_BRIGHT * first.direct_counts)
    if bright[seen].mean() < ACCEPTED_SHARE:
        return None
    rest = np.where(np.arange(record.recorded.shape[1]) < start[:, None], 0, record.recorded)
    try:
        second = refined(replace(record, recorded=rest), first.response, later, gain, steps=False)
    except NoDirectPeak:
        return None
    if second.wall is None or not second.on_a_plane or second.wall.accepted[second.found].mean() < ACCEPTED_SHARE:
        return None
    if _unlike(record, second) > UNLIKE or not is_pane(first, second, record.x, record.y):
        return None
    return second


def _unlike(record: Record, found: TimeOffsets) -> float:
    """How much the pulses differ in shape from point to point, beyond chance."""
    seen = np.flatnonzero(found.found)
    return misfit(
        record.recorded, seen, found.measured_bins[seen], record.background[seen], found.response, found.bin_width_s
    )
