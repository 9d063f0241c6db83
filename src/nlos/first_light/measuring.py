"""Counts in the dark and at a few places on the wall, and what they tell: delay, response, rates, a window."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from nlos.acquisition.digits import plus_minus
from nlos.acquisition.direct_peak import DirectPeak, direct_peak
from nlos.acquisition.planning.preflight import PILE_UP, aim_of
from nlos.acquisition.scanning.left_to_take import ATTEMPTS
from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S
from nlos.doctor.area import WallArea, angles_of, area_of
from nlos.doctor.gates import gates
from nlos.doctor.hands import hands_for
from nlos.doctor.light_trials import lit
from nlos.drivers.bench import Bench
from nlos.drivers.errors import DeviceFault
from nlos.drivers.tcspc.axes import part_of_period, whole_period
from nlos.drivers.tcspc.counter import HistogramAxis

_DARK_S, _PLACE_S, _GATES = 2.0, 1.0, 10
_NEAR_S = 1.5e-9
_FINE_BINS = 1024
"""Of 4 ps: finer than any of these detectors, and no finer than what counters sort by."""
_SPREAD_S = 0.3e-9
"""Delays from several places differ by no more where geometry and aim are right."""
_SMALLEST_SPREAD_S, _DOUBT = 8e-12, 8.0
"""Nor by more than this, and than so many standard errors of one place's peak, where they are right to a few mm."""
_BEFORE_S, _WINDOW_S = 1.0e-9, 16e-9
"""A scan's window begins so much before the earliest direct light, and shows 2.4 m of hidden depth."""


@dataclass(frozen=True)
class Rate:
    """Counts per second and one standard error."""

    cps: float
    error_cps: float

    @classmethod
    def of(cls, counts: float, seconds: float) -> "Rate":
        return cls(counts / seconds, math.sqrt(max(counts, 1.0)) / seconds)

    def __str__(self) -> str:
        return plus_minus(self.cps, self.error_cps)

    def __sub__(self, other: "Rate") -> "Rate":
        return Rate(self.cps - other.cps, math.hypot(self.error_cps, other.error_cps))


@dataclass(frozen=True)
class Place:
    """What one place on the wall gave: its direct peak, and the delay that follows from how far away it is."""

    x_m: float
    y_m: float
    range_m: float
    peak: DirectPeak
    total: Rate


@dataclass(frozen=True)
class FirstLight:
    """`closed`: everything that is counted without the laser, None where nothing can shut it off; `dark`: with the
    detector covered, None where nobody could do that. `histogram` (T,) is the middle place's, over the whole period."""

    delay_s: float
    delay_error_s: float
    spread_s: float
    fwhm_s: float | None
    direct: Rate
    closed: Rate | None
    dark: Rate | None
    places: tuple[Place, ...]
    axis: HistogramAxis
    histogram: npt.NDArray[np.int64]
    window: HistogramAxis
    warnings: tuple[str, ...]

    @property
    def room(self) -> Rate | None:
        """Light that is not the laser's."""
        return None if self.dark is None or self.closed is None else self.closed - self.dark


def in_the_dark(bench: Bench) -> tuple[Rate | None, Rate | None]:
    """Clicks with the shutter closed, where there is one, and with the detector covered where somebody can do that.
    Raises `DeviceFault` for a channel without a single count: it may be dead, or not the one that the detector is
    plugged into."""
    axis = whole_period(bench.counter, bench.settings.laser.repetition_hz, _DARK_S)
    bench.counter.configure(axis)
    shuttered = bench.settings.shutter_on != "nothing"
    first, hands = _rate(bench, 0), hands_for(bench)
    dark = None
    if hands.cover(True):
        try:
            dark = _rate(bench, _GATES)
        finally:
            hands.cover(False)
    if first.cps == 0 and (dark is None or dark.cps == 0):
        raise DeviceFault(
            bench.counter.identity.model,
            f"not one count in {_DARK_S:g} s{' with the shutter closed' if shuttered else ''}: "
            "a dead channel looks like that.",
            "Check the detector's supply, its cable, and the detector input's level, edge and number.",
        )
    return first if shuttered else None, dark


def in_the_light(bench: Bench, closed: Rate | None, dark: Rate | None) -> FirstLight:
    """Five places, each over the laser's whole period; then the middle one in the finest bins. The shutter is open in
    here only. Raises `DeviceFault` where no direct light comes back."""
    settings = bench.settings
    area, period_s = area_of(bench), 1 / settings.laser.repetition_hz
    axis = whole_period(bench.counter, settings.laser.repetition_hz, _PLACE_S)
    bins = min(axis.bins, round(period_s / axis.bin_width_s))
    bench.counter.configure(axis)
    places, sums = [], []
    with lit(bench):
        for number, (x_m, y_m) in enumerate(_places(area)):
            bench.mirror.move_to(angles_of(bench, (x_m, y_m)))
            counts, total = _taken(bench, 2 * _GATES + number * _GATES)
            peak = direct_peak(counts[:bins], axis, cyclic=True)
            if peak is None:
                bench.shutter.close("no direct light")
                raise DeviceFault(
                    bench.counter.identity.model,
                    f"no direct light from ({x_m:+.2f}, {y_m:+.2f}) m: {total} counts/s with light"
                    f"{'' if closed is None else f', {closed} without'}.",
                    "Check laser, shutter, the beam on the wall and the detector's aim; `nlos monitor` shows both.",
                )
            places.append(Place(x_m, y_m, _range_m(bench, x_m, y_m), peak, total))
            sums.append(counts[:bins])
        bench.mirror.move_to(angles_of(bench, area.centre))
        fwhm_s = _fine_fwhm(bench, places[0].peak.time_s)
    bench.mirror.park()
    return _judged(bench, places, sums[0], axis, fwhm_s, (closed, dark))


def _judged(
    bench: Bench, places: list[Place], histogram: npt.NDArray[np.int64], axis: HistogramAxis,
    fwhm_s: float | None, rates: tuple[Rate | None, Rate | None],
) -> FirstLight:  # fmt: skip
    period_s = 1 / bench.settings.laser.repetition_hz
    first_s = places[0].peak.time_s - _there_and_back_s(places[0])
    late_s = np.array([p.peak.time_s - _there_and_back_s(p) - first_s for p in places])
    late_s -= np.round(late_s / period_s) * period_s
    delay_s = first_s + float(np.median(late_s))
    delay_s -= round(delay_s / period_s) * period_s
    spread_s = float(late_s.max() - late_s.min())
    error_s = float(np.std(late_s, ddof=1) / math.sqrt(len(late_s))) if len(late_s) > 1 else places[0].peak.error_s
    warnings = []
    if spread_s > _SPREAD_S:
        warnings.append(
            f"the delay differs by {spread_s * 1e9:.2f} ns from place to place: wall_distance_m, the scanner's place "
            "or the mirror's volts per degree are not as the bench file says. Mark spots (`nlos jog`) and calibrate."
        )
    elif spread_s > max(_SMALLEST_SPREAD_S, _DOUBT * float(np.median([p.peak.error_s for p in places]))):
        warnings.append(
            f"the delay differs by {spread_s * 1e12:.0f} ps from place to place, more than chance: the scanner's place "
            "or wall_distance_m is some way off, and the delay by 6.7 ps for each millimetre of that. Mark spots "
            "(`nlos jog`), calibrate --spots, and measure first light again."
        )
    highest = max(p.total.cps for p in places)
    if highest > PILE_UP * bench.settings.laser.repetition_hz:
        warnings.append(f"{highest:.3g} counts/s are above {PILE_UP:.0%} of the laser's pulses (pile-up): attenuate.")
    seen_s = [(delay_s + _there_and_back_s(p)) % period_s for p in places]
    start_s = max(0.0, math.floor((min(seen_s) - _BEFORE_S) * 1e9) * 1e-9)
    return FirstLight(
        delay_s, max(error_s, places[0].peak.error_s), spread_s, fwhm_s,
        Rate.of(places[0].peak.counts, _PLACE_S), *rates, tuple(places), axis, histogram,
        _window(bench, start_s), tuple(warnings),
    )  # fmt: skip


def _window(bench: Bench, start_s: float) -> HistogramAxis:
    """What scans of this bench begin with: 1024 bins of 16 ps, or the nearest that the counter has."""
    end_s = min(start_s + _WINDOW_S, 1 / bench.settings.laser.repetition_hz)
    return part_of_period(bench.counter, start_s, end_s, 8e-3, most_bins=1100)


def _fine_fwhm(bench: Bench, time_s: float) -> float | None:
    start_s = max(0.0, time_s - _NEAR_S)
    axis = part_of_period(bench.counter, start_s, start_s + 2 * _NEAR_S, _PLACE_S, _FINE_BINS)
    bench.counter.configure(axis)
    counts, _ = _taken(bench, 20 * _GATES)
    peak = direct_peak(counts, axis)
    return None if peak is None else peak.fwhm_s


def _taken(bench: Bench, number: int) -> tuple[npt.NDArray[np.int64], Rate]:
    """Counts (T,) and rate where the beam is, in the light. Raises `SafetyTrip` where that is too much of it."""
    taken = gates(bench, [_PLACE_S / _GATES] * _GATES, number, ATTEMPTS)
    for each in taken:
        bench.shutter.watch(each)
    live_s = sum(each.live_time_s for each in taken)
    counts = np.asarray(np.sum([each.counts for each in taken], axis=0, dtype=np.int64))
    return counts, Rate.of(sum(each.total_count for each in taken), live_s)


def _rate(bench: Bench, number: int) -> Rate:
    taken = gates(bench, [_DARK_S / _GATES] * _GATES, number, ATTEMPTS)
    return Rate.of(sum(each.total_count for each in taken), sum(each.live_time_s for each in taken))


def _places(area: WallArea) -> Sequence[tuple[float, float]]:
    """The middle first, then half-way to each corner."""
    x, y = area.centre
    return [(x, y), *(((x + corner[0]) / 2, (y + corner[1]) / 2) for corner in area.corners)]


def _range_m(bench: Bench, x_m: float, y_m: float) -> float:
    aim = aim_of(bench)
    x_rad, y_rad = aim.angles_rad(np.float64(x_m), np.float64(y_m))
    return float(aim.ranges_m(x_rad, y_rad))


def _there_and_back_s(place: Place) -> float:
    return 2 * place.range_m / SPEED_OF_LIGHT_M_PER_S
