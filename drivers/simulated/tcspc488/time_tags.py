"""T3 mode of a simulated `tcspc488`: photons, marker edges and wraps as generic T3 records, in a FIFO.

Each gate also leaves a record of its own: marker bit 8, at the laser pulse with which it opens.
"""

import zlib

import numpy as np
import numpy.typing as npt

from nlos.drivers.simulated import spad
from nlos.drivers.simulated.bench import Exposure, Gate, SimulatedBench
from nlos.drivers.tcspc.t3 import GENERIC

FIFO_RECORDS = 2_000_000
GATE_MARKER = 8
_WRAP = GENERIC.wrap
_OVERFLOW = 1 << 31 | 63 << 25
_MARKER_SHIFT = 25
_SALT = 488

Pulses = npt.NDArray[np.int64]
Records = npt.NDArray[np.uint32]
_NONE: Pulses = np.zeros(0, np.int64)


class TimeTags:
    """The record stream since `INIT`. Faults U20 happen here."""

    def __init__(self, bench: SimulatedBench) -> None:
        self._bench = bench
        self._fifo: list[Records] = []
        self._coming = _NONE, _NONE.astype(np.uint32)
        self._what = ""
        self._waiting = 0
        self._markers: list[tuple[int, int]] = []
        self._started_s = self._sync_hz = 0.0
        self._wraps = 0
        self.lost = 0
        self.checksum = 0
        """CRC-32 of what `take` gave last."""

    def start(self, now_s: float, sync_hz: float) -> None:
        self._fifo.clear()
        self._coming = _NONE, _NONE.astype(np.uint32)
        self._markers.clear()
        self._waiting = self._wraps = self.lost = 0
        self._started_s, self._sync_hz = now_s, sync_hz

    def pulse(self, when_s: float) -> int:
        """The laser pulse at a bench time, counted from `INIT`."""
        return round((when_s - self._started_s) * self._sync_hz)

    def mark(self, bits: int, when_s: float) -> None:
        """An edge on the marker inputs."""
        self._markers.append((self.pulse(when_s), bits))

    def expose(self, gate: Gate, exposure: Exposure, blanking_s: float) -> None:
        """One gate with its photons, and those that arrive while it is blanked before; they are told as time passes."""
        rng = np.random.default_rng((_SALT, gate.number or 0, round(gate.opened_s * 1e9)))
        pulses, delays = spad.arrivals(exposure, rng)
        opened = self.pulse(gate.opened_s)
        at, shown = [pulses + opened], [delays]
        if blanking_s > 0:
            moving = Gate(
                gate.opened_s - blanking_s, blanking_s, gate.bins, gate.bin_width_s, gate.offset_s, kept=False
            )
            pulses, delays = spad.arrivals(self._bench.expose(moving), rng)
            at.append(pulses + self.pulse(moving.opened_s))
            shown.append(delays)
        self._markers.append((opened, GATE_MARKER))
        times = np.concatenate(at)
        self._plan(times, (np.concatenate(shown) << 10 | times % _WRAP).astype(np.uint32))

    def _plan(self, at: Pulses, photons: Records) -> None:
        fault = self._bench.faults.strikes("U20", self._bench.clock.now(), "records")
        self._what = str(fault.parameters.get("what", "")) if fault else ""
        markers = np.array(self._markers, dtype=np.int64).reshape(-1, 2)
        self._markers.clear()
        edges = (1 << 31 | markers[:, 1] << _MARKER_SHIFT | markers[:, 0] % _WRAP).astype(np.uint32)
        place = markers[:, 0]
        if self._what == "marker_order":  # later than photons of the same time, within one wrap
            place = np.minimum(place + 300, place // _WRAP * _WRAP + _WRAP - 1)
        if self._what == "fifo_full":
            self.lost += len(photons) + len(edges)
            return
        at = np.concatenate((self._coming[0], place, at))
        records = np.concatenate((self._coming[1], edges, photons))
        order = np.argsort(at, kind="stable")
        self._coming = at[order], records[order]

    def stop(self, now_s: float) -> None:
        """The gate closes early: what it would have seen later is not told."""
        cut = int(np.searchsorted(self._coming[0], self.pulse(now_s), side="right"))
        self._coming = self._coming[0][:cut], self._coming[1][:cut]

    def _tell_until(self, last: int) -> None:
        at, records = self._coming
        cut = int(np.searchsorted(at, last, side="right"))
        self._coming = at[cut:], records[cut:]
        told = self._with_wraps(at[:cut], records[:cut], last)
        if self._waiting + len(told) > FIFO_RECORDS:
            self.lost += cut
            told = told[told >= np.uint32(_OVERFLOW)]  # time advances, photons are lost
        self._fifo.append(told)
        self._waiting += len(told)

    def _with_wraps(self, at: Pulses, records: Records, last: int) -> Records:
        """The records with an overflow before each that lies in a later wrap, and up to pulse `last`."""
        wraps = np.diff(np.append(at, last) // _WRAP, prepend=self._wraps)
        self._wraps += int(wraps.sum())
        most = 1 if self._what in ("overflow_one", "overflow_zero") else _WRAP - 1
        repeats = -(-wraps // most)
        counts = np.full(int(repeats.sum()), 0 if self._what == "overflow_zero" else most, dtype=np.int64)
        ends = np.cumsum(repeats)[repeats > 0] - 1
        if most > 1:
            counts[ends] = wraps[repeats > 0] - (repeats[repeats > 0] - 1) * most
        overflows = (_OVERFLOW | counts).astype(np.uint32)
        return np.insert(records, np.repeat(np.arange(len(wraps)), repeats), overflows)

    def take(self, most: int, now_s: float) -> bytes:
        """Up to `most` records as bytes."""
        self._tell_until(self.pulse(now_s))
        records = np.concatenate(self._fifo)
        self._fifo = [records[most:]]
        self._waiting = len(self._fifo[0])
        data = records[:most].astype("<u4").tobytes()
        self.checksum = zlib.crc32(data)
        if data and self._bench.faults.strikes("U20", now_s, "block"):
            data = data[:-2]
        return data
