"""Says which candidates of an adaptive scan come next: how long each, from the light so far; where, from pictures.

The light so far and a model of the picture's error say whether more points or longer ones help most. Pictures cost
seconds: on a simulated bench they are made between two batches, at the same shares of the time in every run; on a real
one the live process makes them, and only its map is read here, so that the scan waits for nothing.
"""

import time
from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from nlos.acquisition.planning.preflight import ExpectedRates
from nlos.acquisition.scanning.advice import Advice
from nlos.live.process import read_state, state_file
from nlos.recon.points_and_photons import expected_error
from nlos.recon.wall_doubt import Wanted, wanted_on_wall

if TYPE_CHECKING:
    from nlos.acquisition.planning.plan import ScanPlan
    from nlos.acquisition.sample import Sample
    from nlos.live.looks import Looks

PICTURES_AT = (0.4,)
"""Shares of the time after which a simulated scan is looked at."""
LEAST_LEFT_S = 20.0
"""And only where as much is left to plan: a picture takes one to three seconds of a core."""
ALIKE = 0.005
"""A dwell is kept until another is expected to make the picture better by more."""
AGAIN_S = 0.5


class WhereNext:
    """The engine's adviser: fed with every sample, asked before every batch."""

    def __init__(self, plan: "ScanPlan", looks: "Looks | None" = None, watched: Path | None = None) -> None:
        """`looks`: makes pictures here, on a simulated bench. `watched`: the recording whose live process does. Without
        either, points are spread evenly."""
        assert plan.budget is not None
        self._plan, self._budget, self._looks = plan, plan.budget, looks
        self._state = None if watched is None else state_file(watched)
        self._counts = np.zeros(plan.axis.bins)
        self._live_s = 0.0
        self._pixel = plan.positions.row.astype(np.intp) * plan.wall.cols + plan.positions.col
        self._turn = np.zeros(len(plan))  # of each point within its pass, from a half
        for each in range(int(plan.pass_.max()) + 1):
            of = np.flatnonzero(plan.pass_ == each)
            self._turn[of] = np.arange(len(of)) + 0.5
        self._dwells_s = [float(plan.dwell_s[plan.pass_ == each][0]) for each in range(int(plan.pass_.max()) + 1)]
        self._pixels = len(np.unique(self._pixel))
        self._wanted: Wanted | None = None
        self._length_before: int | None = None
        self._pictures = 0
        self._looked_s = -np.inf
        self.seconds = 0.0
        """What all advice took, pictures included."""

    def add(self, sample: "Sample") -> None:
        """One more sample."""
        self._counts += sample.histogram.counts
        self._live_s += sample.histogram.live_time_s
        if self._looks is not None:
            self._looks.add(sample)

    def advise(self, taken: Collection[int], left_us: int) -> Advice | None:
        """Points of one dwell, the most wanted first; None while nothing is known yet."""
        began_s = time.perf_counter()
        try:
            return self._advice(np.fromiter(taken, dtype=np.intp, count=len(taken)), left_us)
        finally:
            self.seconds += time.perf_counter() - began_s

    def _advice(self, taken: npt.NDArray[np.intp], left_us: int) -> Advice | None:
        if not len(taken) or not self._live_s > 0:
            return None
        self._look(left_us)
        if self._budget.after_first and self._wanted is None:
            return None  # whose order is as good
        free = np.ones(len(self._plan), dtype=np.bool_)
        free[taken] = False
        # A place that was measured for less than half as long counts as new: pictures want even light.
        pixels = self._plan.wall.rows * self._plan.wall.cols
        measured_s = np.bincount(self._pixel[taken], self._plan.dwell_s[taken], pixels).astype(np.float64)
        new = free & (measured_s[self._pixel] < self._plan.dwell_s / 2)
        fits = [k for k in range(len(self._dwells_s)) if self._cost_us(k) <= left_us]
        first_visits = not self._budget.after_first and any((new & (self._plan.pass_ == k)).any() for k in fits)
        if first_visits:
            length, said = self._length(measured_s, left_us)
        else:
            new, said = free, "a second visit"
            length = max((k for k in fits if (free & (self._plan.pass_ == k)).any()), default=-1)
        candidates = np.flatnonzero(new & (self._plan.pass_ == length))
        if not len(candidates):
            return None
        turn, placed = self._turn[candidates], "spread evenly"
        if self._wanted is not None:
            density = self._wanted.new if first_visits else self._wanted.again
            turn, placed = turn / density.reshape(-1)[self._pixel[candidates]], "where intervals are wide"
        wanted = candidates[np.argsort(turn, kind="stable")][: self._budget.batch]
        return Advice(wanted.tolist(), f"{placed}: {said}")

    def _cost_us(self, length: int) -> int:
        return round(self._dwells_s[length] * 1e6) + self._budget.step_us

    def _length(self, measured_s: npt.NDArray[np.float64], left_us: int) -> tuple[int, str]:
        """The dwell with which the picture of all the time that is left will be best, and why: the one
        before where it is expected to be as good, for pictures want even light. `measured_s`: of each pixel, so far."""
        rate_hz = ExpectedRates.of_histogram(self._counts, self._live_s, self._plan.axis).indirect_hz
        longest, seen, errors = len(self._dwells_s) - 1, int(np.count_nonzero(measured_s)), []
        for length, dwell_s in enumerate(self._dwells_s):
            enough = int(np.count_nonzero(measured_s >= dwell_s / 2))
            fit = min(self._pixels - enough, left_us // self._cost_us(length))
            again_us = left_us - fit * self._cost_us(length)  # where all are visited: longest dwells once more
            more_s = fit * dwell_s + again_us / self._cost_us(longest) * self._dwells_s[longest]
            points = max(seen, enough + fit)
            errors.append(expected_error(points, rate_hz * (self._live_s + more_s) / points) if fit else np.inf)
        best = max(k for k, error in enumerate(errors) if error <= min(errors))
        if self._length_before is not None and errors[self._length_before] <= errors[best] + ALIKE:
            best = self._length_before
        self._length_before = best
        told = ", ".join(
            f"{error:.3f} at {self._dwells_s[k] * 1e3:g} ms" for k, error in enumerate(errors) if error < np.inf
        )
        return best, f"{rate_hz * self._dwells_s[best]:.3g} photons a point, expected error {told}"

    def _look(self, left_us: int) -> None:
        """New maps of where points help, where there are any."""
        if self._state is not None:
            if time.monotonic() - self._looked_s >= AGAIN_S:
                self._looked_s = time.monotonic()
                self._wanted = self._read(read_state(self._state).get("wanted")) or self._wanted
            return
        spent = 1 - left_us / self._budget.total_us
        due = sum(spent >= share for share in PICTURES_AT)
        if self._budget.after_first:
            due = 1  # what the second pass is for
        elif left_us < LEAST_LEFT_S * 1e6:
            return
        if self._looks is None or due <= self._pictures:
            return
        self._pictures = due
        if (picture := self._looks.picture("advice")) is not None:
            self._wanted = wanted_on_wall(picture.reconstruction) or self._wanted

    def _read(self, found: object) -> Wanted | None:
        """What another process wrote; None where that is no map of this wall."""
        shape = self._plan.wall.rows, self._plan.wall.cols
        try:
            assert isinstance(found, dict)
            maps = {name: np.asarray(found[name], dtype=np.float32) for name in ("new", "again")}
        except (AssertionError, KeyError, TypeError, ValueError):
            return None
        fine = all(each.shape == shape and np.isfinite(each).all() and (each > 0).all() for each in maps.values())
        return Wanted(**maps) if fine else None
