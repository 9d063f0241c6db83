"""Whether direct light is where it should be, told by the first points of a scan."""

import numpy as np

from nlos.acquisition.direct_peak import direct_peak
from nlos.acquisition.planning.direct_light import DirectLight
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.sample import Sample
from nlos.acquisition.scanning.turned_axes import TurnedAxes
from nlos.drivers.tcspc.counter import HistogramAxis

FIRST_POINTS = 10
_REACH_S = 1e-9
"""How far off is still where it should be: an unknown delay is measured by calibration, a wrong one is not guessed."""
_ENOUGH = 30.0
"""So many photons expected and none seen: no chance."""
_FAINTEST_CPS = 500.0
"""Direct light below this, where nobody has measured it, is not missed."""
_LEAN_S = 0.25e-9
"""A wall that leans brings light earlier and later by so much; what is farther off is a hidden surface's."""
_SCALE, _SCALE_SIGMAS, _LEAST_S = 0.1, 5.0, 15e-12
"""Points to the side are farther away: by more than this part more or less, than the geometry says, at so many standard
errors and by so much time in all, is another wall. A wall that leans makes a slope, which does not count."""
_WALLS_PART = 1 / 3
"""The wall's light scatters by less than this part of what a hidden surface's does."""
_PART = 0.02
"""Of the direct light that first light found; less has another cause than a dimmer laser."""


_Peak = tuple[int, float, float]
"""Point, when its own direct peak came, and that time's error."""


class DirectWatch:
    """Adds up the first points, each shifted by its own expected arrival, and judges until it can tell. Points whose
    direct light lies outside the window, by what is known, are not asked."""

    def __init__(self, plan: ScanPlan, direct: DirectLight) -> None:
        self._plan, self._direct = plan, direct
        self._seen_at_s = direct.seen_at_s(plan)
        self._inside = direct.inside(plan)
        self._live_s, self._points = 0.0, 0
        self._found = self._done = False
        self._sum = np.zeros(plan.axis.bins)
        self._first_s = float(self._seen_at_s.min())
        self._turned = TurnedAxes(plan, direct)
        rest_s = direct.period_s - plan.axis.bins * plan.axis.bin_width_s
        self._whole = -0.5 * plan.axis.bin_width_s <= rest_s < _REACH_S
        """Whether the window is the laser's period, so that late light of the pulse before begins it."""
        self._peaks: list[_Peak] = []
        self._cyclic: list[_Peak] = []
        """The same where the window is a whole period: of a window whose end is followed by its beginning."""

    def look(self, sample: Sample) -> str:
        """What is wrong, in words; empty as long as nothing is known to be."""
        if sample.histogram.live_time_s <= 0:
            return ""
        if turned := self._turned.look(sample):
            return turned
        if self._done:
            return ""
        if self._direct.delay_known and not self._inside.any():
            return self._outside()
        if not self._inside[sample.point.number]:
            return ""
        shift = round((self._seen_at_s[sample.point.number] - self._first_s) / self._plan.axis.bin_width_s)
        counts = sample.histogram.counts
        self._sum[: len(counts) - shift] += counts[shift:]
        if self._points < FIRST_POINTS:
            for peaks, cyclic in ((self._peaks, False), (self._cyclic, True))[: 1 + self._whole]:
                if (peak := direct_peak(counts, self._plan.axis, cyclic)) is not None:
                    peaks.append((sample.point.number, peak.time_s, peak.error_s))
        self._live_s += sample.histogram.live_time_s
        self._points += 1
        if self._points < FIRST_POINTS and self._points < len(self._plan):
            return ""
        said = self._judged()
        self._done = said == "" and (self._points >= 4 * FIRST_POINTS or self._found)
        return said

    def _judged(self) -> str:
        axis: HistogramAxis = self._plan.axis
        peak = direct_peak(self._sum, axis)
        if peak is None:
            return self._missing()
        off_s = self._off_s(peak.time_s)
        self._found = abs(off_s) <= _REACH_S
        if self._whole and (said := self._overtaken(peak.time_s)):
            return said
        if self._found or not self._direct.delay_known:
            self._found = True
            return self._scaled()
        return (
            f"direct light comes {off_s * 1e9:+.2f} ns from where it should: delay, wall distance or cables have "
            "changed since `nlos calibrate --first-light`"
        )

    def _off_s(self, time_s: float) -> float:
        off_s = time_s - self._first_s
        return off_s - round(off_s / self._direct.period_s) * self._direct.period_s

    def _overtaken(self, first_s: float) -> str:
        """Of a whole period: whether the wall's light comes later than what the pulse before left at `first_s`."""
        peak = direct_peak(self._sum, self._plan.axis, cyclic=True)
        if peak is None or peak.time_s - first_s <= _REACH_S:
            return ""
        if self._direct.delay_known:
            is_wall = abs(self._off_s(peak.time_s)) <= _REACH_S < abs(self._off_s(first_s))
        else:
            enough = min(len(self._cyclic), len(self._peaks)) >= FIRST_POINTS - 2
            is_wall = enough and self._scatter_s(self._cyclic) < _WALLS_PART * self._scatter_s(self._peaks)
        if not is_wall:
            return ""
        begin_ns = max(0.0, np.floor(peak.time_s * 1e9 - 1.0))
        return (
            f"light of the pulse before is recorded ahead of direct light, which comes at {peak.time_s * 1e9:.2f} ns: "
            f"nothing looks for a hidden scene there. Set the scan file's histogram.offset_ns to {begin_ns:g}"
        )

    def _scatter_s(self, peaks: list[_Peak]) -> float:
        """Of peaks about the times that the geometry says, but for an offset."""
        return float(np.std([time_s - self._seen_at_s[number] for number, time_s, _ in peaks]))

    def _missing(self) -> str:
        """Silence is told from faintness by how much was to be expected."""
        known_cps = self._direct.direct_cps
        least_cps = _FAINTEST_CPS if known_cps is None else _PART * known_cps
        if least_cps * self._live_s < _ENOUGH:
            return ""
        return (
            f"no direct light in the first {self._points} points: the laser, the beam on the wall, or the delay that "
            "the time window was chosen for (`nlos calibrate --first-light` measures it)"
        )

    def _outside(self) -> str:
        first_ns, last_ns = self._direct.arrival_s.min() * 1e9, self._direct.arrival_s.max() * 1e9
        return (
            f"the time window holds no direct light: it comes {first_ns:.2f} to {last_ns:.2f} ns after the sync pulse. "
            "Set the scan file's histogram.offset_ns (`nlos calibrate --first-light` prints the line), or "
            "`alarms: {expect_direct: false}` for a detector that is gated to leave it out"
        )

    def _scaled(self) -> str:
        """Whether points to the side are farther away by as much as the geometry says. An offset, which cables make,
        and slopes, which a leaning wall makes, are fitted beside it."""
        if len(self._peaks) < FIRST_POINTS - 2:
            return ""
        points = np.array([number for number, _, _ in self._peaks], np.int64)
        came_s = np.array([time_s for _, time_s, _ in self._peaks])
        late_s = came_s - self._seen_at_s[points]
        walls = np.abs(late_s - np.median(late_s)) < _LEAN_S
        if walls.sum() < len(points) / 2:
            return (
                f"the first light in the time window varies by {np.ptp(late_s) * 1e9:.2f} ns from point to point, "
                "as no wall's light does: direct light comes before the window, or not at all (`nlos calibrate "
                "--first-light` finds it)"
            )
        if walls.sum() < FIRST_POINTS - 2:
            return ""
        points, came_s = points[walls], came_s[walls]
        where, expected_s = self._plan.positions, self._seen_at_s[points]
        columns = [expected_s - expected_s.mean(), np.ones(len(points))]
        columns += [each - each.mean() for each in (where.x_m[points], where.y_m[points]) if np.ptp(each) > 0]
        unit = np.array([max(float(np.linalg.norm(each)), 1e-30) for each in columns])
        design = np.column_stack(columns) / unit
        found, _, rank, _ = np.linalg.lstsq(design, came_s, rcond=1e-6)
        free = len(points) - len(columns)
        if rank < len(columns) or free < 2:
            return ""
        left_s = came_s - design @ found
        width_s = float(np.sqrt((left_s**2).sum() / free))
        width_s = max(width_s, 0.3 * self._plan.axis.bin_width_s, 2 * max(error_s for _, _, error_s in self._peaks))
        scale = float(found[0] / unit[0])
        error = width_s * float(np.sqrt(np.linalg.inv(design.T @ design)[0, 0])) / unit[0]
        off = abs(scale - 1)
        if off < max(_SCALE, _SCALE_SIGMAS * error) or off * float(np.ptp(expected_s)) < _LEAST_S:
            return ""
        return (
            f"direct light from the sides comes later than from ahead by {scale:.2f} +- {error:.2f} times what "
            "geometry.wall_distance_m and the mirror's volts per degree say: the wall is that many times farther away, "
            "or the beam is deflected that much farther. Mark spots (`nlos jog`), then `nlos calibrate --spots`"
        )
