"""Photons of a T3 stream sorted into histograms of scan points, by time: what fell between points is skipped."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from nlos.drivers.tcspc.t3 import Pulses, T3Events


@dataclass(frozen=True)
class Windows:
    """When each point was exposed, in laser pulses: [start, stop), in time order and not overlapping.

    `unfinished_since`: a window has begun there whose end is not known yet.
    """

    point: npt.NDArray[np.int64]  # (n,)
    start: Pulses  # (n,)
    stop: Pulses  # (n,)
    unfinished_since: int | None = None


_SEQUENCE_STARTS = 0b100
_EARLY = 0.1
"""By so much of a dwell the next step may come too early: the controller polls its trigger input."""
_CHUNK = 1 << 16  # photons sorted at once: their keys stay in the processor's cache

FindWindows = Callable[[Pulses, npt.NDArray[np.uint8]], Windows]
"""Markers (pulses, bits) in time order -> windows that they complete. Keeps what they begin."""


def steps_by_times(times: Sequence[int], period: float) -> tuple[int, int]:
    """How many steps there are, and how many were due by their times; one more than there are where one came a period
    early and another made up for it."""
    gaps = np.round(np.diff(np.asarray(times, dtype=np.float64)) / period).astype(np.int64)
    seen, due = len(times), int(gaps.sum()) + (len(times) > 0)
    return seen, due if due != seen or (gaps == 1).all() else seen + 1


class StepMarkers:
    """Each edge on one of `step_bits` begins the next point: `blanking` pulses while the mirror settles, then its
    dwell. Photons in flight between dwells belong to nobody."""

    def __init__(self, dwells: Pulses, blanking: int, step_bits: int = 0b011) -> None:
        self._dwells, self._blanking, self._step_bits = dwells, blanking, step_bits
        self.seen = 0
        """Step markers so far."""
        self._pulses: list[int] = []
        self._bits: list[int] = []
        self._started: int | None = None

    def __call__(self, pulses: Pulses, bits: npt.NDArray[np.uint8]) -> Windows:
        if self._started is None and (bits & _SEQUENCE_STARTS).any():
            self._started = int(pulses[(bits & _SEQUENCE_STARTS) != 0][0])
        step = (bits & self._step_bits) != 0
        pulses, bits = pulses[step], bits[step] & self._step_bits
        point = np.arange(self.seen, self.seen + len(pulses))
        self.seen += len(pulses)
        self._pulses += pulses.tolist()
        self._bits += bits.tolist()
        known = point < len(self._dwells)
        point, start = point[known], pulses[known] + self._blanking
        return Windows(point, start, start + self._dwells[point])

    def against(self, period: float) -> tuple[int, int]:
        """Steps seen while the points were due, and how many there were by their times and turns.

        A clock steps every `period` pulses; markers 1 and 2 take turns, beginning with 1, and marker 3 comes with the
        first. A marker that was lost leaves a gap of two periods and the wrong turn, one too many comes too early.
        """
        pulses, bits = self._pulses, self._bits
        if not pulses:
            return 0, 0
        end = pulses[0] + (len(self._dwells) - 0.5) * period  # the clock runs for a moment after the last point
        count = sum(pulse < end for pulse in pulses)
        seen, due = steps_by_times(pulses[:count], period)
        in_turn = bits[:count] == [1 + index % 2 for index in range(count)]
        from_start = self._started is None or abs(pulses[0] - self._started) < 0.5 * period
        return seen, due if in_turn and from_start else max(due, seen + 1)


class PointHistograms:
    """Histograms of scan points from a stream, as far as it has come.

    Markers may be recorded later than photons of the same time, by up to `disorder` pulses; so photons are sorted
    only when the stream is that far past them. Windows of more points than there are leave their photons out.
    """

    def __init__(
        self,
        points: int,
        bins: int,
        find_windows: FindWindows,
        *,
        first_bin: int = 0,
        channel: int | None = None,
        disorder: int = 4096,
    ) -> None:
        self.counts: npt.NDArray[np.uint32] = np.zeros((points, bins), dtype=np.uint32)
        self.totals: npt.NDArray[np.int64] = np.zeros(points, dtype=np.int64)
        """Photons within each point's window, whatever their delay."""
        self.started: npt.NDArray[np.int64] = np.zeros(points, dtype=np.int64)
        """Pulse at which each point's window began."""
        self.lost: npt.NDArray[np.bool_] = np.zeros(points, dtype=np.bool_)
        """Points during which records were lost, or that the next step cut far too short."""
        self.exposed: npt.NDArray[np.float64] = np.ones(points)
        """How much of its window each point had: less than 1 where the next step came a little early."""
        self.complete = 0
        """Points before this one will not change any more."""
        self.between = 0
        """Photons that belong to no point."""
        self._find_windows, self._first_bin, self._channel, self._disorder = find_windows, first_bin, channel, disorder
        self._photons: list[tuple[npt.NDArray[np.uint32], npt.NDArray[np.int64]]] = []
        self._markers = (np.zeros(0, np.int64), np.zeros(0, np.uint8))
        self._windows = Windows(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0, np.int64))
        self._losses: list[tuple[int, int]] = []

    def add(self, events: T3Events) -> None:
        """Takes what the decoder gave."""
        photons, pulses = events.photons, events.photon_pulses
        if self._channel is not None:
            chosen = events.format.channels(photons) == self._channel
            photons, pulses = photons[chosen], pulses[chosen]
        delays = events.format.delays(photons)
        if (pulses[1:] < pulses[:-1]).any():  # detectors of one instrument may be a little out of order too
            order = np.argsort(pulses, kind="stable")
            delays, pulses = delays[order], pulses[order]
        self._photons.append((delays, pulses))
        self._markers = (
            np.concatenate((self._markers[0], events.marker_pulses)),
            np.concatenate((self._markers[1], events.marker_bits)),
        )
        self._sort_until(events.until_pulse - self._disorder)

    def mark_lost(self, since_pulse: int, until_pulse: int) -> None:
        """Records were lost in between (FIFO full): points exposed then are flagged."""
        self._losses.append((since_pulse, until_pulse))
        self._flag(self._windows)

    def finish(self) -> None:
        """The stream has ended: everything that waited is sorted."""
        self._sort_until(np.iinfo(np.int64).max, final=True)

    def _sort_until(self, horizon: int, final: bool = False) -> None:
        pulses, bits = self._markers
        ready = pulses < horizon
        if ready.any():
            order = np.argsort(pulses[ready], kind="stable")
            found = self._find_windows(pulses[ready][order], bits[ready][order])
            self._markers = (pulses[~ready], bits[~ready])
            known = found.point < len(self.counts)
            point, start, stop = found.point[known], found.start[known], found.stop[known]
            self.started[point] = start
            old = self._windows
            self._windows = Windows(
                np.concatenate((old.point, point)),
                np.concatenate((old.start, start)),
                np.concatenate((old.stop, stop)),
                found.unfinished_since,
            )
            self._flag(self._windows)
            self._cut_short()
        since = self._windows.unfinished_since
        if since is not None and not final:
            horizon = min(horizon, since)
        kept = []
        for delays, at in self._photons:
            cut = int(np.searchsorted(at, horizon))
            for first in range(0, cut, _CHUNK):
                last = min(first + _CHUNK, cut)
                self._count(delays[first:last], at[first:last])
            if cut < len(at):
                kept.append((delays[cut:], at[cut:]))
        self._photons = kept
        done = self._windows.stop <= horizon
        if done.any():
            self.complete = int(self._windows.point[done].max()) + 1
            left = ~done
            self._windows = Windows(
                self._windows.point[left], self._windows.start[left], self._windows.stop[left], since
            )

    def _count(self, delays: npt.NDArray[np.uint32], pulses: Pulses) -> None:
        windows = self._windows
        near = slice(
            int(np.searchsorted(windows.stop, pulses[0], side="right")),
            int(np.searchsorted(windows.start, pulses[-1], side="right")),
        )
        point, edges = windows.point[near], np.stack((windows.start[near], windows.stop[near]), axis=1).ravel()
        cuts = np.searchsorted(pulses, edges)
        inside = cuts[1::2] - cuts[::2]
        self.totals[point] += inside
        self.between += len(pulses) - int(inside.sum())
        if len(point) == 0:
            return
        bins = self.counts.shape[1]
        # Photons between windows count for row len(point), delays outside the histogram for column `bins`.
        rows = np.full(2 * len(point) + 1, len(point), dtype=np.int64)
        rows[1::2] = np.arange(len(point))
        keys = np.repeat(rows * (bins + 1), np.diff(cuts, prepend=0, append=len(pulses)))
        keys += np.minimum(delays - np.uint32(self._first_bin), np.uint32(bins))
        table = np.bincount(keys, minlength=(len(point) + 1) * (bins + 1)).reshape(len(point) + 1, bins + 1)
        self.counts[point] += table[:-1, :-1].astype(np.uint32)

    def _cut_short(self) -> None:
        """A step that came too early ended the dwell before it: by much, and that point is not what was asked for; by
        a little, as on continuous lines half of them do, and it was exposed for that much less."""
        windows = self._windows
        missing = windows.stop[:-1] - windows.start[1:]
        early = missing > 0
        if early.any():
            point, missing = windows.point[:-1][early], missing[early]
            share = missing / (windows.stop - windows.start)[:-1][early]
            self.exposed[point] = 1 - share
            self.lost[point[share > _EARLY]] = True
            windows.stop[:-1][early] -= missing

    def _flag(self, windows: Windows) -> None:
        for since, until in self._losses:
            self.lost[windows.point[(windows.start < until) & (windows.stop > since)]] = True
