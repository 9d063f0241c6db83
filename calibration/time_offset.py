"""When the direct light of every point arrives, to a fraction of a bin: the brightest pulses if a plane wall explains
them, else the earliest, which a gated detector leaves fainter than a hidden object's light."""

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S, TimeAxis
from nlos.calibration.arrival_rounds import DETECTION, PLANE_S, Record, TimeOffsets, refined
from nlos.calibration.background import quiet_background
from nlos.calibration.by_blocks import chosen
from nlos.calibration.drawn_wall import FEWEST_DRAWN
from nlos.calibration.errors import InvalidData, NoDirectPeak, ShutterClosed
from nlos.calibration.impulse_response import ImpulseResponse
from nlos.calibration.matched_filter import boxcar_arrival, earliest_pulse, later_pulse, misfit, neighbours
from nlos.calibration.pane import is_pane
from nlos.calibration.raw_points import RawPoints
from nlos.calibration.wall_timing import FEWEST_POINTS

Floats = npt.NDArray[np.float64]
BOX_S = 100e-12
ACCEPTED_SHARE = 0.8
"""Of the arrivals near the fitted wall, the fit accepts so many ..."""
SEEN_SHARE = 0.5
"""... and so many points showed their pulse there before there was a fit."""
NEIGHBOURS = 9
UNLIKE = 0.05
"""Direct pulses have one shape: 0.01 in measured scans. Letters behind the corner: 0.09 to 0.17."""
APART_S = 0.3e-9
"""Times of a few points, less those of the drawing, differ by no more where the scanner is a handbreadth beside it."""
AS_BRIGHT = 0.1
"""Of what is taken for direct light: a later pulse at `ACCEPTED_SHARE` of the points that may be the wall's."""
HIDDEN = (
    "what is brightest at {points} points comes at times that {why}, and its shape changes from point "
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
    return _of_record(_record(recorded, (x, y), time, lit), response)


def time_offsets_of(
    raw: RawPoints, counts: npt.NDArray[np.generic], response: ImpulseResponse | None = None
) -> TimeOffsets:
    """The same of a scan's points, whose `counts` (N, T) were corrected: where they lie on one line, on a circle about
    the scanner's axis, or are few, by where the bench's drawing has the scanner, if light agrees with that."""
    record = _record(counts, (raw.x_m, raw.y_m), raw.time, raw.exposure_s > 0)
    return _of_record(replace(record, scanner_m=raw.scanner_m), response)


def _record(
    recorded: npt.NDArray[np.generic], places: tuple[Floats, Floats], time: TimeAxis, lit: npt.NDArray[np.bool_]
) -> Record:
    box = max(3, round(BOX_S / time.bin_width_s))
    if recorded.shape[1] <= 2 * box:
        raise InvalidData(f"histograms of {recorded.shape[1]} bins are too short to find a pulse of {box} bins in.")
    background = np.ones(len(recorded))  # of points that were not measured nobody asks for theirs
    if lit.any():
        background[lit] = quiet_background(chosen(recorded, lit))
    return Record(recorded, *places, time, lit, background, box)


def _of_record(record: Record, response: ImpulseResponse | None) -> TimeOffsets:
    recorded, lit, box = record.recorded, record.lit, record.box
    first, gain = np.full(len(recorded), box / 2), np.zeros(len(recorded))
    some = chosen(recorded, lit)  # of a scan that has just begun, few
    first[lit], gain[lit] = boxcar_arrival(some, record.background[lit], box)
    try:
        brightest = refined(record, response, first, gain)
        behind = _behind_a_pane(record, brightest)
        if behind is not None:
            return behind
        if _is_direct(record, brightest):
            return brightest
        if brightest.wall is None and lit.sum() < FEWEST_POINTS:
            if brightest.found.sum() < FEWEST_DRAWN:
                return _of_few(record, response, brightest)
            return _of_earliest_light(record, response) or replace(brightest, off_the_drawing=True)
        if _unlike(record, brightest) > UNLIKE:
            raise _hidden(record, brightest)
    except ShutterClosed:
        raise
    except NoDirectPeak:
        found = _of_earliest_light(record, response)
        if found is None:
            raise
        return found
    return _of_earliest_light(record, response) or _undrawn(record, response, brightest)


def _of_few(record: Record, response: ImpulseResponse | None, brightest: TimeOffsets) -> TimeOffsets:
    """Of too few points for a fit: the brightest pulses, or else the earliest, whose times differ from point to point
    as those of the bench's drawing do; the brightest where neither do, or nobody has drawn it."""
    if record.scanner_m is None or _as_drawn(record, brightest):
        return brightest
    try:
        earliest = refined(record, response, *_earliest(record, 1), steps=False)
    except NoDirectPeak:
        earliest = brightest
    return earliest if _as_drawn(record, earliest) else replace(brightest, off_the_drawing=True)


def _as_drawn(record: Record, found: TimeOffsets) -> bool:
    assert record.scanner_m is not None
    x, y, z = record.scanner_m
    drawn_s = 2 * np.sqrt((record.x - x) ** 2 + (record.y - y) ** 2 + z**2) / SPEED_OF_LIGHT_M_PER_S
    late_s = (found.measured_bins * found.bin_width_s - drawn_s)[found.found]
    return bool(np.ptp(late_s) <= APART_S)


def _undrawn(record: Record, response: ImpulseResponse | None, brightest: TimeOffsets) -> TimeOffsets:
    """The brightest pulses by themselves, where they do not agree with the bench's drawing: that may be wrong."""
    if brightest.wall is None or not brightest.wall.drawn:
        return brightest
    try:
        return replace(_of_record(replace(record, scanner_m=None), response), off_the_drawing=True)
    except NoDirectPeak:
        raise _hidden(record, brightest) from None


def _is_direct(record: Record, found: TimeOffsets) -> bool:
    """Whether a wall explains it. One that is only drawn has to explain nearly all points, of one shape: on a line, or
    at a few points, some of a hidden object's light would agree with it."""
    if found.wall is None or not found.wall.drawn:
        return found.on_a_plane
    most = found.wall.accepted[found.found].mean() >= ACCEPTED_SHARE
    return bool(found.on_a_plane and most and _unlike(record, found) <= UNLIKE)


def _hidden(record: Record, found: TimeOffsets) -> NoDirectPeak:
    """With what its times do not agree with."""
    why = "no plane wall explains"
    if found.wall is None:
        why = "tell no wall, for the points are few or lie on one line (some more beside it would tell)"
    elif found.wall.drawn and record.scanner_m is not None:
        why = (
            "the wall does not explain where the bench has it, {2:.2f} m from a scanner at ({0:+.2f} m, {1:+.2f} m) "
            "(correct the bench file's geometry, if that is wrong)"
        ).format(*record.scanner_m)
    return NoDirectPeak(HIDDEN.format(points=int(found.found.sum()), why=why))


def _of_earliest_light(record: Record, response: ImpulseResponse | None) -> TimeOffsets | None:
    """Where hidden light outshines the direct light of a gated detector: direct light is what comes first, as long as a
    plane wall explains it; where it is faint, points are looked at together with their neighbours. Light that comes at
    one time everywhere tells no wall from a stray reflection."""
    lit = np.flatnonzero(record.lit)
    for together in (1, NEIGHBOURS):
        first, gain = _earliest(record, together)
        try:
            found = refined(record, response, first, gain, steps=False)
        except NoDirectPeak:
            continue
        if found.wall is None or not _is_direct(record, found):
            continue
        if found.wall.accepted[found.found].mean() < ACCEPTED_SHARE:
            continue
        seen_there = np.abs(first - found.predicted_bins)[lit] < record.box  # before anything was known of the wall
        scatter_s = PLANE_S if found.wall.drawn else max(found.rms_bins, 0.1) * found.bin_width_s
        tells = np.ptp(found.predicted_bins) * found.bin_width_s > 4 * scatter_s
        if seen_there.mean() > SEEN_SHARE and tells:
            return _behind_a_pane(record, found) or found
    return None


def _earliest(record: Record, together: int) -> tuple[Floats, Floats]:
    """Where each point's first pulse is and how far it stands out, (N,), of `together` neighbours at a time."""
    lit = np.flatnonzero(record.lit)
    near = neighbours(record.x[lit], record.y[lit], together)
    first, gain = np.full(len(record.lit), record.box / 2), np.zeros(len(record.lit))
    first[lit], gain[lit] = earliest_pulse(record.recorded, lit[near], record.background, record.box, DETECTION)
    return first, gain


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
