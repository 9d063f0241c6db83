"""Measures the constants of a bench from a raw scan, and from a run with the shutter closed where there is one."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from nlos.acquisition.planning.aim import Aim
from nlos.calibration.afterpulsing import ClickAfterClick, from_full_period
from nlos.calibration.agreement import disagreements, landed_at, off_its_aim, uneven
from nlos.calibration.arrival_rounds import TimeOffsets
from nlos.calibration.arrivals import Arrivals
from nlos.calibration.background import dark_rate_per_bin, quiet_before, sum_where
from nlos.calibration.constants import BenchConstants, Quantity
from nlos.calibration.correct import CorrectedPoints, correct_points
from nlos.calibration.dark_runs import dark_and_light
from nlos.calibration.detector import WHOLE_PERIOD, undo_dead_time
from nlos.calibration.drift import Drift, measure_drift, without_drift
from nlos.calibration.errors import InvalidData, PoorCalibration
from nlos.calibration.first_click import first_click
from nlos.calibration.geometry import ScannerGeometry
from nlos.calibration.geometry_fit import DirectTimes, GeometryFit, Spots, fit_geometry
from nlos.calibration.impulse_response import ImpulseResponse
from nlos.calibration.raw_points import RawPoints, joined
from nlos.calibration.spots_fit import PlacedScanner, place_with_run
from nlos.calibration.time_offset import measure_time_offsets
from nlos.calibration.wall_timing import FEWEST_POINTS, WallTiming

Floats = npt.NDArray[np.float64]
QUIET_AFTER_S = 15e-9
"""This long after the direct arrival neither hidden objects (2 m away) nor the detector's tail matter any more."""

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Measurement:
    """The constants, and what they were measured from, for reports and pictures."""

    constants: BenchConstants
    raw: RawPoints | None
    """All scans with light in them; None where there was only a dark run."""
    corrected: CorrectedPoints | None
    placed: PlacedScanner | None
    drift: Drift | None = None
    """Of the time zero while they were taken; None where the runs do not say when their points were."""
    dead_time_measured: bool = False
    """From these runs, so that one that is longer by the laser's period may be it as well."""
    off_aim: str = ""
    """What to say of these runs, and not of the constants: that they landed elsewhere."""

    @property
    def geometry(self) -> GeometryFit | None:
        """Scanner and wall, where the points tell them."""
        return None if self.placed is None else self.placed.fit


@dataclass(frozen=True)
class KnownBefore:
    """What is known from elsewhere than the runs. `spots`: where on the wall the beam was seen, for the mirrors' gains;
    a histogram over the laser's whole period tells the dead time by itself."""

    dead_time: Quantity | None = None
    response: ImpulseResponse | None = None
    spots: Spots | None = None
    meant_dark: Sequence[bool] = ()
    """Which of the runs were taken dark on purpose, in their order; none where it is empty."""


NOTHING_KNOWN = KnownBefore()


def measure_constants(
    runs: Sequence[RawPoints],
    *,
    devices: Mapping[str, str],
    sources: Sequence[str],
    measured_utc: str,
    aim: Aim | ScannerGeometry | None = None,
    known: KnownBefore = NOTHING_KNOWN,
) -> Measurement:
    """Constants from one or more runs of one bench; dark runs are those whose counts are flat in time, and those meant
    to be that show no wall.

    `aim`: what the scans were aimed by, for wall distance and tilt: the drawing, or an earlier fit. Raises
    `InvalidData` for bad counts and for a run beside a scan that is neither dark nor shows a wall, `NoDirectPeak`, and
    `PoorCalibration` where the points do not determine the arrivals.
    """
    dead_time, response, spots = known.dead_time, known.response, known.spots
    for run in runs:
        run.check()
    dark, light = dark_and_light(runs, known.meant_dark, sources)
    found = BenchConstants(
        devices, measured_utc, tuple(sources), (light or dark)[0].time.bin_width_s, response=response
    )
    raw = joined(light) if light else None
    if raw is not None and dead_time is None:
        after_click = measure_click_after_click(raw, response)
        if after_click is not None:
            dead_time = Quantity(after_click.dead_time_s, after_click.dead_time_error_s)
            found = replace(
                found,
                afterpulse_probability=Quantity(after_click.afterpulse_probability, after_click.afterpulse_error),
                afterpulse_decay_s=after_click.decay_s,
            )
        else:
            dead_time = first_click(raw).dead_time
    found = replace(found, dead_time_s=dead_time)
    if dark:
        found = _with_dark(found, joined(dark))
    if raw is None:
        return Measurement(found, None, None, None)
    log.debug("finding the direct light of %d points", len(raw.counts))
    corrected = correct_points(raw, found)
    offsets = corrected.offsets
    if offsets is None or offsets.wall is None or not offsets.wall.placed:
        raise PoorCalibration(_unplaced(raw, offsets))
    drift = measure_drift(raw, offsets)
    if drift is not None and drift.significant:
        offsets = without_drift(raw, offsets, drift)
    if offsets.wall is None:
        raise PoorCalibration("without the drift of the time zero the direct times tell no wall. Scan more points.")
    placed = None if aim is None else fit_scanner(raw, offsets, aim, spots)
    fit = None if placed is None else placed.fit
    arrivals, warnings, off_aim = _arrivals(raw, offsets, offsets.wall, raw.x_m, raw.y_m), [], ""
    if aim is not None and placed is not None:
        landed = landed_at(raw, offsets, aim, placed.fit)
        warnings, off_aim = disagreements(placed, landed, offsets.wall, raw), off_its_aim(placed, landed, raw)
        if spots is not None and landed.wall is not None:  # scans that these constants aim arrive where they are sent
            arrivals = _arrivals(raw, offsets, landed.wall, landed.x_m, landed.y_m)
    if not warnings and not off_aim:
        warnings = uneven(offsets, raw.x_m, raw.y_m)
    found = replace(
        found,
        arrivals=arrivals,
        warnings=tuple(warnings),
        response=offsets.response,
        direct_shape=corrected.direct.shape,
        direct_end_bin=corrected.direct.end_bin,
        ambient_hz=ambient_rate(raw, offsets, found, corrected.background.stretch),
        geometry=fit.geometry if fit else None,
        geometry_errors=fit.errors if fit else {},
    )
    own_dead_time = known.dead_time is None and dead_time is not None
    return Measurement(found, raw, corrected, placed, drift, own_dead_time, off_aim)


def _unplaced(raw: RawPoints, offsets: TimeOffsets | None) -> str:
    """Why the points of a scan tell no constants, and what does."""
    x, y = raw.x_m[raw.exposure_s > 0], raw.y_m[raw.exposure_s > 0]
    across = np.linalg.svd(np.column_stack([x - x.mean(), y - y.mean()]), compute_uv=False)
    if len(x) < FEWEST_POINTS:
        why = "are too few"
    elif across[-1] < 1e-3 * across[0]:
        why = "lie on one line"
    elif offsets is not None and offsets.wall is not None:
        why = "show direct light at nearly one time, as a circle about the scanner's axis does"
    else:
        why = "show direct light at times that tell no scanner (a rectified scan's are all one)"
    drawn = offsets is not None and offsets.wall is not None and offsets.wall.drawn
    picture = " A picture needs no constants: `nlos reconstruct` takes the bench file's geometry." if drawn else ""
    return (
        f"{len(x)} points do not tell wall distance and delay apart: they {why}. Take nine or more that span the wall, "
        f"near its middle and far from it.{picture}"
    )


def _with_dark(constants: BenchConstants, run: RawPoints) -> BenchConstants:
    """Adds the dark rate: clicks with the light off, less those that are afterpulses of others, and with those that the
    dead time took. Where a source keeps no clicks outside of the histogram, those in it stand for its share of the
    laser's period."""
    told, inside = run.total_count > 0, run.counts.sum(axis=1, dtype=np.float64)
    period_s, share = run.period_s, 1.0
    if period_s is not None:
        share = min(run.time.bins * run.time.bin_width_s / period_s, 1.0)
    elif not told.all():
        log.warning("no clicks and no laser pulses are known of a dark run: its dark rate is that of its window alone")
    clicks = float(run.total_count[told].sum() + inside[~told].sum() / share)
    variance = max(float(run.total_count[told].sum() + inside[~told].sum() / share**2), 1.0)
    seconds = float(run.exposure_s.sum())
    first = 1 - (constants.afterpulse_probability.value if constants.afterpulse_probability else 0.0)
    if constants.dead_time_s is not None:  # even light: of all the time, it is blind for as long as its clicks took
        live_s = seconds - clicks * constants.dead_time_s.value
        if not live_s > 0:
            raise InvalidData(
                f"{clicks:.0f} clicks in {seconds:g} s of a dark run, each blind for "
                f"{constants.dead_time_s.value * 1e9:g} ns, are more than there was time for. Check the dead time."
            )
        first *= seconds / live_s
    per_bin, _ = dark_rate_per_bin(run.counts, run.exposure_s)
    return replace(
        constants,
        dark_hz=Quantity(first * clicks / seconds, first * float(np.sqrt(variance)) / seconds),
        dark_per_bin_hz=first * per_bin,
        dark_time=run.time,
    )


def measure_click_after_click(raw: RawPoints, response: ImpulseResponse | None = None) -> ClickAfterClick | None:
    """Dead time and afterpulsing from histograms that cover the laser's whole period; None where they do not.

    Histograms are rolled to a common direct arrival, which is what their period being whole allows, and added up.
    """
    period_s = raw.period_s
    width = raw.time.bin_width_s
    if period_s is None or abs(raw.time.bins * width / period_s - 1) > WHOLE_PERIOD:
        return None
    bins = min(raw.time.bins, round(period_s / width))  # of a record that is a little longer
    counts, time = raw.counts[:, :bins], replace(raw.time, bins=bins)
    offsets = measure_time_offsets(counts, raw.x_m, raw.y_m, time, response, raw.exposure_s > 0)
    first = np.nan_to_num(np.floor(offsets.offset_bins)).astype(np.int64)
    lead = int(np.ceil(1e-9 / width))
    total = np.zeros(bins)
    for histogram, start in zip(counts, first, strict=True):
        total += np.roll(histogram, lead - start)
    quiet = np.arange(bins) * width > 1e-9 + QUIET_AFTER_S
    try:
        return from_full_period(total, float(raw.sync_count.sum()), width, quiet)
    except InvalidData:
        return None


def ambient_rate(
    raw: RawPoints, offsets: TimeOffsets, constants: BenchConstants, stretch: tuple[int, int] | None = None
) -> Quantity | None:
    """Clicks per second that neither laser nor dark counts make, from the bins before the direct pulse, or those of a
    `stretch` behind it that is darker; None without laser pulse counts or without such bins."""
    lead = max(2.0, 2 * -offsets.response.start_s / raw.time.bin_width_s)
    good = np.isfinite(offsets.offset_bins) & (raw.exposure_s > 0) & (raw.sync_count > 0)
    clicks = undo_dead_time(raw, constants)[0]
    if stretch is None:
        quiet = quiet_before(clicks, np.where(good, offsets.offset_bins - lead, 0.0))
    else:
        quiet = np.zeros(clicks.shape, dtype=bool)
        quiet[good & (offsets.offset_bins + lead <= stretch[0]), slice(*stretch)] = True
    opened_s = float((quiet.sum(axis=1) * raw.time.bin_width_s * raw.sync_count).sum())
    if not opened_s > 0:
        return None
    photons = float(sum_where(clicks, quiet).sum())
    dark, after = constants.dark_hz or Quantity(0.0, 0.0), constants.afterpulse_probability
    error = [np.sqrt(max(photons, 1.0)) / opened_s, dark.error]
    if after is not None and after.value > 0:  # what was subtracted for them is as uncertain as their probability
        with_after = undo_dead_time(raw, replace(constants, afterpulse_probability=None))[0]
        all_clicks = float(sum_where(with_after, quiet).sum())
        error.append((all_clicks - photons) / opened_s * after.error / after.value)
    return Quantity(photons / opened_s - dark.value, float(np.linalg.norm(error)))


def fit_scanner(
    raw: RawPoints, offsets: TimeOffsets, aim: Aim | ScannerGeometry, spots: Spots | None = None
) -> PlacedScanner | None:
    """Wall distance, tilt and delay by the commanded angles and direct arrivals, with `spots` the scanner's place and
    the mirrors' gains too; None where the points do not tell. Raises `InvalidData` for spots that do not."""
    x_rad, y_rad = aim.angles_rad(raw.x_m, raw.y_m)
    start = aim if isinstance(aim, ScannerGeometry) else ScannerGeometry(**vars(aim))
    width_s = raw.time.bin_width_s
    arrival_s = raw.time.start_s + offsets.measured_bins * width_s
    try:
        times = DirectTimes(x_rad, y_rad, arrival_s, offsets.error_bins * width_s)
        if spots is None:
            return PlacedScanner(fit_geometry(start, times), {})
        return place_with_run(spots, times, start)
    except InvalidData:
        if spots is not None:
            raise
        return None


def _arrivals(raw: RawPoints, offsets: TimeOffsets, wall: WallTiming, x_m: Floats, y_m: Floats) -> Arrivals:
    best_s = raw.time.start_s + offsets.offset_bins * raw.time.bin_width_s
    residual = np.nan_to_num(best_s - wall.arrival_s(x_m, y_m))
    return Arrivals(wall.scanner_position_m, wall.delay_s, wall.covariance, wall.rms_s, x_m, y_m, residual)
