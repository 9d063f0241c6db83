"""The `tcspc488` in T3 mode: a record of every photon, sorted here into the histograms of the points (scheme S3).

The instrument marks each gate in the stream, so photons belong to a point by their time; those that arrived while the
mirror moved belong to none. The stream is told once: what the link loses of it, the points under way have lost.
"""

import numpy as np

from nlos.drivers.errors import CommandRejected, DeviceLost, DeviceTimeout, LimitError, ProtocolError, SyncLost
from nlos.drivers.tcspc.counter import (
    CounterStatus,
    Histogram,
    HistogramAxis,
    HistogramFlag,
    PointGates,
    StopAtCounts,
    Trigger,
)
from nlos.drivers.tcspc.t3 import GENERIC, T3Decoder
from nlos.drivers.tcspc.t3_points import PointHistograms
from nlos.drivers.tcspc.tcspc488.gates import Gates
from nlos.drivers.tcspc.tcspc488.histogram import POLL_S, Tcspc488
from nlos.drivers.tcspc.tcspc488.instrument import Instrument
from nlos.drivers.tcspc.tcspc488.messages import Status
from nlos.drivers.tcspc.tcspc488.settings import Tcspc488Settings

_MOST_RECORDS = 65_000
"""Per question: 260 kB, so that the link is soon free again."""


class Tcspc488T3(Tcspc488):
    """A `HistogramCounter` that makes its histograms itself."""

    list_mode = True

    def __init__(self, settings: Tcspc488Settings, instrument: Instrument) -> None:
        super().__init__(settings, instrument)
        self._disorder_s = settings.marker_disorder_us * 1e-6
        self._sync_hz = 0.0
        self._decoder = T3Decoder(GENERIC)
        self._gates = Gates(np.zeros(0, np.int64), False)
        self._points = PointHistograms(0, 1, self._gates)
        self._broken = False

    def check(self, axis: HistogramAxis, dwell_s: float, stop: StopAtCounts | None = None) -> None:
        super().check(axis, dwell_s, stop)
        self._check_records(axis, stop is not None)

    def _check_records(self, axis: HistogramAxis, stops: bool) -> None:
        """Raises `LimitError` for what a stream of records cannot do."""
        if stops:
            raise LimitError(
                self._device, "stopping at a number of counts needs histogram mode.", "Set mode: histogram."
            )
        if axis.bins > 1 << GENERIC.delay_bits:
            raise LimitError(self._device, f"a T3 record counts {1 << GENERIC.delay_bits} bins, not {axis.bins}.")

    def arm(self, gates: PointGates) -> None:
        """As `Tcspc488.arm`; the laser's rate is measured, which turns dwells into laser pulses."""
        if self._axis is not None:
            self._check_records(self._axis, self._stops)
        self._sync_hz = self.rates().sync_hz
        if self._sync_hz <= 0:
            raise SyncLost(self._device, "sees no sync signal.", "Check laser, sync cable and its level.")
        super().arm(gates)
        assert self._axis is not None
        self._decoder = T3Decoder(GENERIC)
        dwells = np.round(np.asarray(gates.dwells_s) * self._sync_hz).astype(np.int64)
        self._gates = Gates(dwells, self.counts_markers and gates.trigger is not Trigger.HOST)
        self._points = PointHistograms(
            len(gates.dwells_s), self._axis.bins, self._gates, disorder=round(self._disorder_s * self._sync_hz)
        )
        self._broken = False

    def wait_points(self, count: int, timeout_s: float) -> CounterStatus:
        deadline_s = self.clock.now() + timeout_s
        due_s = self._due(count) + self._disorder_s + GENERIC.wrap / self._sync_hz  # time is told in wraps
        again_s = 0.0005
        while True:
            self._pause(min(due_s, deadline_s))
            status = self._drain(deadline_s)
            done = len(self._numbers) if self._broken else self._points.complete
            if done >= count or self._gates.disagreement is not None:
                lost = int(self._points.lost.sum())
                markers, due = self._gates.disagreement or (status.markers, self._steps_due(status))
                return CounterStatus(status.running, done, lost, markers, due)
            now_s = self.clock.now()
            if now_s >= deadline_s:
                raise DeviceTimeout(self._device, f"{done} of {count} points complete after {timeout_s:g} s.")
            if now_s >= due_s:
                due_s, again_s = now_s + again_s, min(2 * again_s, POLL_S)

    def _look(self) -> Status:
        return self._drain(self.clock.now() + POLL_S)

    def _drain(self, until_s: float) -> Status:
        """Takes all records that wait, of a stream that fills up as fast those until then."""
        while not self._broken:
            try:
                status, data = self.instrument.take_records(_MOST_RECORDS)
            except DeviceLost:
                raise
            except (DeviceTimeout, ProtocolError):
                self._lose_the_rest()
                break
            self._running_or_done(status)
            if status.lost:  # the FIFO was full: a gate's mark may be among the lost, and each one names the next point
                self._lose_the_rest()
                break
            self._points.add(self._decoder.feed(np.frombuffer(data, "<u4", len(data) // 4)))
            if len(data) % 4:  # cut short
                self._lose_the_rest()
                break
            if len(data) < 4 * _MOST_RECORDS or self.clock.now() >= until_s:
                return status
        return self.instrument.look()[0]

    def _lose_the_rest(self) -> None:
        """Without the lost records time cannot be told any more: points not complete yet are lost."""
        self._points.lost[self._points.complete :] = True
        self._broken = True
        self.abort()

    def read(self, first: int, count: int) -> list[Histogram]:
        points, axis = self._points, self._axis
        assert axis is not None
        if not self._broken and first + count > points.complete:
            raise CommandRejected(self._device, f"point {first + count - 1} is not complete ({points.complete} are).")
        histograms = []
        for k in range(first, first + count):
            lost = bool(points.lost[k])
            live_s = 0.0 if lost else self._dwells_s[k] * float(points.exposed[k])
            histograms.append(
                Histogram(
                    np.zeros_like(points.counts[k]) if lost else points.counts[k].copy(),
                    axis.bin_width_s,
                    axis.offset_s,
                    live_s,
                    round(live_s * self._sync_hz),
                    0 if lost else int(points.totals[k]),
                    HistogramFlag.DATA_LOST if lost else HistogramFlag.NONE,
                    points.started[k] / self._sync_hz,
                )
            )
        return histograms
