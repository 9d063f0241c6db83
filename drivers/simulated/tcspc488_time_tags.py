"""T3 mode of a simulated `tcspc488`: photons, marker edges and wraps as generic T3 records, in a FIFO.

Each gate also leaves a record of its own: marker bit 8, at the laser pulse with which it opens.
"""

import numpy as np
import numpy.typing as npt

from drivers.simulated import spad
from drivers.simulated.bench import Exposure, Gate, SimulatedBench
from drivers.tcspc.t3 import GENERIC

FIFO_RECORDS = 2_000_000
GATE_MARKER = 8
_WRAP = GENERIC.wrap
_OVERFLOW = 1 << 31 | 63 << 25
_MARKER_SHIFT = 25
_SALT = 488

Pulses = npt.NDArray[np.int64]
Records = npt.NDArray[np.uint32]


class TimeTags:
    """The record stream since `INIT`. Faults U20 happen here."""

    def __init__(self, bench: SimulatedBench) -> None:
        self._bench = bench
        self._fifo: list[Records] = []
        self._waiting = 0
        self._markers: list[tuple[int, int]] = []
        self._started_s = self._sync_hz = 0.0
        self._wraps = 0
        self.lost = 0

    def start(self, now_s: float, sync_hz: float) -> None:
        self._fifo.clear()
        self._markers.clear()
        self._waiting = self._wraps = self.lost = 0
        self._started_s, self._sync_hz = now_s, sync_hz

    def pulse(self, when_s: float) -> int:
        return round((when_s - self._started_s) * self._sync_hz)

    def mark(self, bits: int, when_s: float) -> None:
        self._markers.append((self.pulse(when_s), bits))

    def expose(self, gate: Gate, exposure: Exposure, blanking_s: float) -> None:
        """Records one gate with its photons, and those that arrived while it was blanked before."""
        rng = np.random.default_rng((_SALT, gate.number or 0, round(gate.opened_s * 1e9)))
        pulses, delays = spad.arrivals(exposure, rng)
        opened = self.pulse(gate.opened_s)
        parts = [(pulses + opened, delays)]
        if blanking_s > 0:
            moving = Gate(gate.opened_s - blanking_s, blanking_s, gate.bins, gate.bin_width_s, gate.offset_s)
            pulses, delays = spad.arrivals(self._bench.expose(moving), rng)
            parts.append((pulses + self.pulse(moving.opened_s), delays))
        self._markers.append((opened, GATE_MARKER))
        at = np.concatenate([part for part, _ in parts])
        photons = (np.concatenate([part for _, part in parts]) << 10 | at % _WRAP).astype(np.uint32)
        self._record(at, photons, self.pulse(gate.opened_s + gate.dwell_s))

    def _record(self, at: Pulses, photons: Records, last: int) -> None:
        fault = self._bench.faults.strikes("U20", self._bench.clock.now(), "records")
        what = str(fault.parameters.get("what", "")) if fault else ""
        markers = np.array(self._markers, dtype=np.int64).reshape(-1, 2)
        self._markers.clear()
        edges = (1 << 31 | markers[:, 1] << _MARKER_SHIFT | markers[:, 0] % _WRAP).astype(np.uint32)
        place = markers[:, 0]
        if what == "marker_order":  # later than photons of the same time, within one wrap
            place = np.minimum(place + 300, place // _WRAP * _WRAP + _WRAP - 1)
        at, records = np.concatenate((place, at)), np.concatenate((edges, photons))
        order = np.argsort(at, kind="stable")
        if what == "fifo_full":
            self.lost += len(records)
            order = order[:0]
        self._push(*self._with_wraps(at[order], records[order], last, what))

    def _with_wraps(self, at: Pulses, records: Records, last: int, what: str = "") -> tuple[Records, int]:
        """The records with an overflow before each that lies in a later wrap, and up to pulse `last`."""
        wraps = np.diff(np.append(at, max(last, int(at[-1]) if len(at) else 0)) // _WRAP, prepend=self._wraps)
        self._wraps += int(wraps.sum())
        most = 1 if what in ("overflow_one", "overflow_zero") else _WRAP - 1
        repeats = -(-wraps // most)
        counts = np.full(int(repeats.sum()), 0 if what == "overflow_zero" else most, dtype=np.int64)
        ends = np.cumsum(repeats)[repeats > 0] - 1
        if most > 1:
            counts[ends] = wraps[repeats > 0] - (repeats[repeats > 0] - 1) * most
        overflows = (_OVERFLOW | counts).astype(np.uint32)
        return np.insert(records, np.repeat(np.arange(len(wraps)), repeats), overflows), len(records)

    def _push(self, records: Records, events: int) -> None:
        if self._waiting + len(records) > FIFO_RECORDS:
            self.lost += events
            records = records[records >= np.uint32(_OVERFLOW)]  # time goes on, photons are lost
        self._fifo.append(records)
        self._waiting += len(records)

    def take(self, most: int, known_until_s: float) -> bytes:
        """Up to `most` records as bytes; wraps are told up to the moment until which all photons are known."""
        self._push(*self._with_wraps(np.zeros(0, np.int64), np.zeros(0, np.uint32), self.pulse(known_until_s)))
        records = np.concatenate(self._fifo)
        self._fifo = [records[most:]]
        self._waiting = len(self._fifo[0])
        data = records[:most].astype("<u4").tobytes()
        if data and self._bench.faults.strikes("U20", known_until_s, "block"):
            data = data[:-2]
        return data
