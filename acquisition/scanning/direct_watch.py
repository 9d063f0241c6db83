"""Whether direct light is where it should be, told by the first points of a scan."""

import numpy as np

from nlos.acquisition.direct_peak import direct_peak
from nlos.acquisition.planning.direct_light import DirectLight
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.sample import Sample
from nlos.drivers.tcspc.counter import HistogramAxis

FIRST_POINTS = 10
_REACH_S = 1e-9
"""How far off is still where it should be: an unknown delay is measured by calibration, a wrong one is not guessed."""
_ENOUGH = 30.0
"""So many photons expected and none seen: no chance."""
_FAINTEST_CPS = 500.0
"""Direct light below this, where nobody has measured it, is not missed."""
_PART = 0.02
"""Of the direct light that first light found; less has another cause than a dimmer laser."""


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

    def look(self, sample: Sample) -> str:
        """What is wrong, in words; empty as long as nothing is known to be."""
        if self._done or sample.histogram.live_time_s <= 0 or not self._inside[sample.point.number]:
            return ""
        shift = round((self._seen_at_s[sample.point.number] - self._first_s) / self._plan.axis.bin_width_s)
        counts = sample.histogram.counts
        self._sum[: len(counts) - shift] += counts[shift:]
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
        off_s = peak.time_s - self._first_s
        off_s -= round(off_s / self._direct.period_s) * self._direct.period_s
        self._found = abs(off_s) <= _REACH_S
        if self._found or not self._direct.delay_known:
            self._found = True
            return ""
        return (
            f"direct light comes {off_s * 1e9:+.2f} ns from where it should: delay, wall distance or cables have "
            "changed since `nlos calibrate --first-light`"
        )

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
