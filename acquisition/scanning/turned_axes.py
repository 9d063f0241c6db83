"""Whether the beam goes another way than it is sent, told by arrival times where the wall leans by the bench file.

Before a flat wall that faces the scanner, a reversed axis or two that are swapped change no time at all.
"""

import numpy as np
import numpy.typing as npt

from nlos.acquisition.direct_peak import direct_peak
from nlos.acquisition.planning.direct_light import DirectLight
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.sample import Sample

_FIRST, _MORE = 10, 54
"""Every one of the first points is looked at, and so many more over the whole scan: the first may all be one row."""
_FEWEST = 8
_BETTER = 3.0
"""So many times nearer to the times of turned axes than to those of the drawn ones, at least."""
_SIGMAS, _LEAST_S = 5.0, 15e-12


class TurnedAxes:
    """Compares the times at which direct light came with what it would be for every way to turn the axes."""

    def __init__(self, plan: ScanPlan, direct: DirectLight) -> None:
        self._plan, self._direct, self._inside = plan, direct, direct.inside(plan)
        self._every = max(len(plan) // _MORE, 1)
        self._looked = 0
        self._points: list[int] = []
        self._came_s: list[float] = []
        self._errors_s: list[float] = []

    def look(self, sample: Sample) -> str:
        """Which axes are turned, in words; empty as long as nothing is known to be."""
        number = sample.point.number
        if not self._direct.turned_s or not self._inside[number]:
            return ""
        self._looked += 1
        if self._looked > _FIRST and self._looked % self._every:
            return ""
        peak = direct_peak(sample.histogram.counts, self._plan.axis)
        if peak is None:
            return ""
        self._points.append(number)
        self._came_s.append(peak.time_s)
        self._errors_s.append(peak.error_s)
        return self._judged() if len(self._points) >= _FEWEST else ""

    def _judged(self) -> str:
        points, came_s = np.array(self._points), np.array(self._came_s)
        drawn_s = self._off_s(came_s - self._direct.arrival_s[points])
        error_s = max(float(np.median(self._errors_s)), 0.3 * self._plan.axis.bin_width_s)
        if drawn_s < max(_SIGMAS * error_s, _LEAST_S):
            return ""
        off_s = {how: self._off_s(came_s - turned_s[points]) for how, turned_s in self._direct.turned_s.items()}
        how = min(off_s, key=lambda each: off_s[each])
        if off_s[how] * _BETTER > drawn_s:
            return ""
        return (
            f"direct light arrives earlier or later from point to point as if {how} ({off_s[how] * 1e12:.0f} ps RMS "
            f"off that, {drawn_s * 1e12:.0f} ps off the bench file's geometry): or the wall leans differently than "
            "geometry.wall_pitch_deg and wall_yaw_deg say. `nlos doctor` asks where the beam lands"
        )

    def _off_s(self, late_s: npt.NDArray[np.float64]) -> float:
        """Root mean square, less what cables and whole periods make; points whose first peak is not the wall's do not
        count."""
        late_s = late_s - np.median(late_s)
        late_s -= np.round(late_s / self._direct.period_s) * self._direct.period_s
        kept = np.abs(late_s) <= max(4 * float(np.median(np.abs(late_s))), _LEAST_S)
        return float(np.sqrt((late_s[kept] ** 2).mean()))
