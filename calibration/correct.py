"""The order of the corrections, in one place: dead time and pile-up, dark counts, alignment to the direct arrival,
ambient light, direct light."""

import logging
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from nlos.acquisition.transient import TimeAxis, Transient
from nlos.acquisition.wall import WallGrid
from nlos.calibration import raw_points
from nlos.calibration.alignment import align, align_variance, light_beyond, recorded_bins
from nlos.calibration.arrival_rounds import TimeOffsets
from nlos.calibration.background import Background, before_pulse, in_stretch, subtract
from nlos.calibration.by_blocks import chosen, some_at_a_time
from nlos.calibration.close_pulse import ClosePulse, doubt_close_pulse
from nlos.calibration.constants import BenchConstants
from nlos.calibration.correction_report import Report, report_of
from nlos.calibration.detector import subtract_dark, undo_dead_time
from nlos.calibration.direct_reflection import DirectLight, find_direct_light, known_direct_light, remove_direct_light
from nlos.calibration.errors import NoDirectPeak
from nlos.calibration.first_click import doubt_pile_up
from nlos.calibration.known_arrivals import bins_left, is_direct, known_arrival_bins, require_arrivals
from nlos.calibration.known_direct import KnownDirect
from nlos.calibration.light_of_pulse_before import dark_stretch
from nlos.calibration.raw_points import RawPoints
from nlos.calibration.second_pulse import SecondPulse, doubt_second_pulse, second_pulse
from nlos.calibration.time_offset import time_offsets_of
from nlos.calibration.wall_brightness import HiddenLight, doubt_wall_brightness, wall_brightness
from nlos.calibration.without_second_pulses import without_second_pulses

Floats = npt.NDArray[np.float64]
MOST_PULSES = 4
"""As many second pulses are taken out; a laser that sends more needs repair."""
LEAD_S = 300e-12
"""How long before its arrival a direct pulse may begin, where its impulse response was not measured."""
log = logging.getLogger(__name__)


@dataclass(frozen=True)
class CorrectedPoints:
    """Histograms of N points on one time axis whose time 0 is the direct arrival."""

    counts: npt.NDArray[np.float32]  # (N, T); negative where chance has it so
    variance: npt.NDArray[np.float32]  # (N, T)
    usable: npt.NDArray[np.bool_]
    """(N, T); False where direct light hides the scene, nothing was recorded or a dead time ends nobody knows when."""
    exposure_s: Floats  # (N,); 0 where no arrival is known
    time: TimeAxis
    offsets: TimeOffsets | None  # None where the arrivals were given
    direct: DirectLight
    background: Background
    beyond: float = 0.0
    """Light (counts) that is not used: after the last bin of `time`, at points that recorded longer."""
    pulses: tuple[SecondPulse, ...] = ()
    """Second pulses that were taken out."""
    light: Floats | None = None
    """(N,); how bright hidden light is for the wall's sake, where exposures were multiplied by it."""

    def known(self, offset_bins: Floats) -> KnownDirect:
        """What single frames of the same points are told."""
        told = self.background.stretch, self.direct.close_end_bin()
        return KnownDirect(offset_bins, self.pulses, self.light, *told)

    def report(self) -> Report:
        """Figures for people and JSON: what was found, and how well it fits."""
        width_s = self.time.bin_width_s
        return report_of(self.offsets, self.exposure_s > 0, self.direct, self.background, width_s)


@dataclass(frozen=True)
class Corrected:
    """A transient that the physics can use, and what was taken out of it, on the wall's grid."""

    transient: Transient
    points: CorrectedPoints

    def report(self) -> Report:
        """See `CorrectedPoints.report`."""
        return self.points.report()


def correct_points(
    raw: RawPoints,
    constants: BenchConstants | None = None,
    *,
    rectified: bool = False,
    known: KnownDirect | None = None,
    remove_direct: bool = True,
) -> CorrectedPoints:
    """Corrects a scan as a whole; what `constants` do not tell is measured from the scan itself.

    `rectified`: time 0 is the direct arrival already; `known`: when direct light comes is known. Otherwise each scan's
    own direct light tells it, and the constants' arrivals help out where it shows none. The result keeps the bins that
    every point recorded. Raises `InvalidData`, naming the first bad point, and `NoDirectPeak`.
    """
    raw.check(cut_tops=not rectified)
    if constants is None or constants.dead_time_s is None:
        doubt_pile_up(raw)
    undone, variance = undo_dead_time(raw, constants)
    counts, offsets = undone, None
    if rectified:
        arrival = np.full(len(counts), -raw.time.start_s / raw.time.bin_width_s)
    elif known is not None:
        arrival = np.asarray(known.offset_bins, dtype=np.float64).ravel()
    else:
        response = None if constants is None else constants.response
        try:
            offsets = time_offsets_of(raw, counts, response)
            arrival = offsets.offset_bins
        except NoDirectPeak:
            if constants is None or constants.arrivals is None:
                raise
        if constants is not None and constants.arrivals is not None:
            by_constants = known_arrival_bins(constants, raw.x_m, raw.y_m, raw.time)
            if offsets is None or not is_direct(offsets, by_constants):
                offsets, arrival = None, by_constants
    lead = (LEAD_S if offsets is None else -2 * offsets.response.start_s) / raw.time.bin_width_s
    counts = subtract_dark(undone, raw, constants)
    lit = np.isfinite(arrival) & (raw.exposure_s > 0)
    begin, dark_end = np.where(lit, arrival + lead, np.nan), np.where(lit, arrival - max(2.0, lead), 0)
    ambient = None if known is None else known.ambient
    if offsets is not None:
        ambient = dark_stretch(undone, raw.counts, dark_end, begin)
    background = before_pulse(counts, dark_end) if ambient is None else in_stretch(counts, begin, ambient)
    timed = _Timed(counts, variance, arrival, background, offsets)
    done = _finish(raw, timed, remove_direct=remove_direct)
    if known is not None and known.pulses:
        done = _without(raw, timed, known.pulses, done.direct.close)
    if offsets is not None and remove_direct:
        done = _without_any(raw, timed, done, offsets)
        doubt_close_pulse(done.direct.close, done.pulses)
    if known is not None:
        return _as_whole(done, known, known.close_end_bin if remove_direct else 0)
    return done if offsets is None or not remove_direct else _evened(done, offsets, raw)


def correct(
    transient: Transient,
    constants: BenchConstants | None = None,
    *,
    rectified: bool = False,
    known: KnownDirect | None = None,
    sync_count: npt.ArrayLike = 0.0,
    total_count: npt.ArrayLike = 0.0,
) -> Corrected:
    """`correct_points` for a scan on a grid; `sync_count` and `total_count` are (H, W)."""
    raw = raw_points.from_transient(transient, sync_count, total_count)
    return on_grid(correct_points(raw, constants, rectified=rectified, known=known), transient.wall)


def on_grid(done: CorrectedPoints, wall: WallGrid) -> Corrected:
    """Points of a whole grid in row order, as a transient."""
    shape = (done.time.bins, wall.rows, wall.cols)
    return Corrected(
        Transient(
            np.ascontiguousarray(done.counts.T).reshape(shape), done.exposure_s.reshape(shape[1:]), wall, done.time
        ),
        done,
    )


def correct_known(raw: RawPoints, constants: BenchConstants, bins: int | None = None) -> CorrectedPoints:
    """The same with nothing measured: arrivals, background and the direct light's shape are the constants', so that
    points can be corrected as they arrive, `bins` long. Raises `InvalidData` for constants without arrivals or for
    another bin width."""
    require_arrivals(constants, raw.time)
    counts, variance = undo_dead_time(raw, constants)
    arrival = known_arrival_bins(constants, raw.x_m, raw.y_m, raw.time)
    rates = [q.value for q in (constants.dark_hz, constants.ambient_hz) if q is not None]
    per_bin = sum(rates) * raw.time.bin_width_s * raw.sync_count
    background = Background(per_bin, np.zeros(len(counts)))
    return _finish(raw, _Timed(counts, variance, arrival, background, None), constants, bins=bins)


@dataclass(frozen=True)
class _Timed:
    """Histograms without dead time, not yet shifted, and when direct light arrives in each."""

    counts: npt.NDArray[np.generic]  # (N, T)
    variance: npt.NDArray[np.generic]  # (N, T)
    arrival: Floats  # (N,) bins, NaN where it is not known
    background: Background
    offsets: TimeOffsets | None  # None where the arrivals were given


def _finish(
    raw: RawPoints,
    timed: _Timed,
    known: BenchConstants | None = None,
    *,
    remove_direct: bool = True,
    mask_close: bool = True,
    bins: int | None = None,
) -> CorrectedPoints:
    """Alignment, background and direct light, the last as it is `known`, else looked for."""
    arrival, background, offsets = timed.arrival, timed.background, timed.offsets
    points, record = timed.counts.shape
    there = np.isfinite(arrival) & (arrival < record - 1) & (raw.exposure_s > 0)
    if not there.any():
        raise NoDirectPeak(f"at none of {points} points does direct light arrive within the record of {record} bins.")
    arrival = np.where(there, arrival, arrival[there].mean())
    if bins is None:
        bins = bins_left(raw, arrival, offsets)
    below = np.where(np.isfinite(background.error), background.per_bin, 0.0)[:, None]
    order: Literal["C", "F"] = "C" if timed.counts.flags.c_contiguous else "F"  # of a cube over time first
    aligned, spread = (np.zeros((points, bins), np.float32, order) for _ in range(2))
    usable = np.zeros((points, bins), np.bool_, order)
    for some in some_at_a_time(points):
        counts, variance = (np.ascontiguousarray(each[some]) for each in (timed.counts, timed.variance))
        start = arrival[some]
        told = np.isfinite(variance)
        aligned[some] = subtract(align(counts, start, bins), below[some])
        spread[some] = align_variance(np.where(told, variance, 0), start, bins)
        usable[some] = recorded_bins(start, record, bins) & there[some, None] & (align(~told, start, bins) == 0)
    aligned[~there], spread[~there] = 0, 0
    direct = DirectLight(np.zeros(bins), np.zeros(points), 0, 0.0)
    if known is not None and known.direct_shape is not None:
        direct = known_direct_light(aligned, known.direct_shape, known.direct_end_bin)
    elif remove_direct and known is None:
        found = find_direct_light(chosen(aligned, there), raw.time.bin_width_s, mask_close=mask_close)
        direct = replace(found, amplitude=np.zeros(points))
        direct.amplitude[there] = found.amplitude
    for some in some_at_a_time(points):
        usable[some] &= direct.usable()
        left = remove_direct_light(aligned[some], replace(direct, amplitude=direct.amplitude[some]))
        aligned[some] = np.where(usable[some], left, np.float32(0))
    beyond = 0.0
    if known is None:
        beyond = light_beyond(chosen(timed.counts, there), arrival[there], bins, background.at(there))
    exposure, axis = np.where(there, raw.exposure_s, 0.0), TimeAxis(bins, raw.time.bin_width_s)
    return CorrectedPoints(aligned, spread, usable, exposure, axis, offsets, direct, background, beyond)


def _without_any(raw: RawPoints, timed: _Timed, done: CorrectedPoints, offsets: TimeOffsets) -> CorrectedPoints:
    """The same without second pulses, the clearest first, until one is no bench's or is what another left."""
    while len(done.pulses) < MOST_PULSES:
        found = _second_pulse(done, raw, timed, offsets)
        if found is None or any(each.is_at(found.lag_s) for each in done.pulses):
            break
        doubt_second_pulse(found)
        if not found.even:
            break
        done = _without(raw, timed, (*done.pulses, found), done.direct.close)
    return done


def _second_pulse(done: CorrectedPoints, raw: RawPoints, timed: _Timed, offsets: TimeOffsets) -> SecondPulse | None:
    """That of `done`; one that is masked there where it can be taken out: so can what it shows once more."""
    if done.direct.close is not None and not any(each.is_at(done.direct.close.lag_s) for each in done.pulses):
        bare = _finish(raw, _pulsed_once(timed, done.pulses), mask_close=False)
        close = second_pulse(bare.counts, bare.variance, offsets, raw.x_m, raw.y_m)
        if close is not None and close.even:
            return close
    return second_pulse(done.counts, done.variance, offsets, raw.x_m, raw.y_m)


def _pulsed_once(timed: _Timed, pulses: tuple[SecondPulse, ...]) -> _Timed:
    """As if there had been none of these `pulses`."""
    if not pulses:
        return timed
    counts, variance = without_second_pulses(timed.counts, timed.variance, timed.arrival, timed.background, pulses)
    return replace(timed, counts=counts, variance=variance)


def _without(
    raw: RawPoints, timed: _Timed, pulses: tuple[SecondPulse, ...], close: ClosePulse | None
) -> CorrectedPoints:
    """`_finish` without second pulses. What is masked as `close`, which may be what is left of one, stays so."""
    done = _finish(raw, _pulsed_once(timed, pulses))
    close = max(filter(None, (close, done.direct.close)), key=lambda each: each.end_bin, default=None)
    done = replace(done, pulses=pulses, direct=replace(done.direct, close=close))
    return _masked(done, done.direct.close_end_bin())


def _as_whole(done: CorrectedPoints, known: KnownDirect, end_bin: int) -> CorrectedPoints:
    """The same as bright as its whole scan, and not usable before `end_bin`."""
    if known.light is not None:
        done = replace(done, exposure_s=done.exposure_s * known.light, light=known.light)
    return _masked(done, end_bin)


def _masked(done: CorrectedPoints, end_bin: int) -> CorrectedPoints:
    if end_bin <= done.direct.end_bin:
        return done
    kept, direct = np.arange(done.time.bins) >= end_bin, replace(done.direct, end_bin=end_bin)
    return replace(done, counts=done.counts * kept, usable=done.usable & kept, direct=direct)


def _evened(done: CorrectedPoints, offsets: TimeOffsets, raw: RawPoints) -> CorrectedPoints:
    """The same of a wall that is as bright everywhere."""
    direct = np.where(offsets.found, offsets.direct_counts, 0.0)
    hidden = HiddenLight(done.counts, done.variance, done.usable, done.exposure_s, direct, raw.x_m, raw.y_m)
    wall = offsets.wall if offsets.on_a_plane else None
    found = None if wall is None else wall_brightness(hidden, wall.scanner_position_m)
    if found is None:
        return done
    doubt_wall_brightness(found)
    return replace(done, exposure_s=done.exposure_s * found.light, light=found.light)
