"""How long a scan still takes, from what its points have taken so far."""

from collections.abc import Collection

from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.sample import Sample, is_pause


class TimeLeft:
    """Each point counts with its own dwell, and with what a point has cost beside it so far: points to come may be ten
    times as long as those that came."""

    def __init__(self, plan: ScanPlan, taken: Collection[int] = (), elapsed_s: float = 0.0) -> None:
        """`taken`: numbers of the points that an earlier recording holds, `elapsed_s` how long that took."""
        self._left, self._left_dwell_s = plan.most_samples - len(taken), plan.dwell_total_s
        self._left_dwell_s -= float(plan.dwell_s[list(taken)].sum())
        self._samples = 0
        self._dwell_s = self._live_s = 0.0
        """Of the samples so far: as planned, and as measured, which is less where points stop early."""
        self._before_s: float | None = None
        """What passed before the first sample: instruments are set up, a lag is measured. No other point pays that."""
        self.elapsed_s = elapsed_s
        """Bench time from the scan's start to the end of the last sample."""
        self.busy_s = 0.0
        """The same without pauses: what tells how long the rest takes."""

    def passed(self, sample: Sample) -> None:
        """One sample, in the order taken: its time has passed, whether it is a point's first or not."""
        live_s = sample.histogram.live_time_s
        after_s = max(sample.taken_s + live_s - self.elapsed_s, 0.0)
        self.elapsed_s += after_s
        self.busy_s += 0.0 if is_pause(after_s, live_s) else after_s
        if self._before_s is None:
            self._before_s = max(self.busy_s - live_s, 0.0)

    def took(self, sample: Sample) -> None:
        """It is its point's first: one less is left."""
        self._samples += 1
        self._dwell_s += sample.point.dwell_s
        self._live_s += sample.histogram.live_time_s

    @property
    def left_s(self) -> float | None:
        """Bench time until the last point of the plan is over; None before the first sample."""
        if not self._samples:
            return None
        beside_s = max(self.busy_s - self._live_s - (self._before_s or 0.0), 0.0) / max(self._samples - 1, 1)
        lit_s = max(self._left_dwell_s - self._dwell_s, 0.0) * self._live_s / self._dwell_s
        return max(self._left - self._samples, 0) * beside_s + lit_s

    def times_as_long(self, newest: Sample) -> float | None:
        """With one sample more, its point's first: how many times as long as these took the rest takes; None where
        nobody knows."""
        self.passed(newest)
        self.took(newest)
        left_s = self.left_s
        return None if left_s is None or not self.busy_s else left_s / self.busy_s
