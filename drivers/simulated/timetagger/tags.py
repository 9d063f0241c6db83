"""Time tags of a simulated bench: photons, laser pulses behind the filter, and marker edges, in ps.

The T3 instrument draws what arrives and when; here it becomes edges on the channels of a front panel.
"""

import math

import numpy as np
import numpy.typing as npt

from nlos.drivers.simulated.t3_instrument import T3Instrument
from nlos.drivers.simulated.table import SimulatedTable
from nlos.drivers.tcspc.t3 import GENERIC, T3Decoder
from nlos.drivers.tcspc.timetagger.settings import TimeTaggerSettings

PS = 1e-12
_TTL_MV = 2000
"""Height of the pulses of laser and detector; the mirror's markers are 5 V."""
_MARKER_MV = 5000
_FOREVER_S = 1e6
_RECORDS = 1 << 24
_SLOW_HZ = 5e6
"""A faster laser's pulses are told only next to photons, where the filter is off: to tell them all takes too long."""

Tags = tuple[npt.NDArray[np.int64], npt.NDArray[np.int32]]
"""Times in ps since power-up and channels, in time order, both (n,)."""


class FrontPanel:
    """Which cable is where, what was set of each channel, and the tags since the last look."""

    def __init__(self, table: SimulatedTable, wiring: TimeTaggerSettings) -> None:
        self.bench, self.wiring = table.bench, wiring
        self.period_ps = round(1 / (table.repetition_hz * PS))
        self.sync_hz = table.repetition_hz
        self._width_ps = max(4, -(-self.period_ps // 32_000))
        self._instrument = T3Instrument(table.bench, GENERIC, table.repetition_hz, table.simulation.seed)
        self._decoder = T3Decoder(GENERIC)
        self._started_s = 0.0
        self._pulled_ps = 0
        self.level_v: dict[int, float] = {}
        self.hardware_ps: dict[int, int] = {}
        """Delays by channel that come before the conditional filter."""
        self.software_ps: dict[int, int] = {}
        """Those that come after it."""
        self.filtered: frozenset[int] = frozenset()
        self._changed_s = math.inf
        self._later_ps = self.period_ps
        """The laser's period from `_changed_s` on."""

    def laser_hz(self) -> float:
        """The laser's rate as it is now."""
        self._drift()
        return self.sync_hz if self._changed_s == math.inf else 1 / (self._later_ps * PS)

    def _drift(self) -> None:
        now_s = self.bench.clock.now()
        if (fault := self.bench.faults.strikes("T4", now_s)) is not None:
            self._changed_s = now_s
            self._later_ps = round(self.period_ps / float(fault.parameters.get("times_hz", 0.99)))

    def _pulse_before(self, at_ps: npt.NDArray[np.int64]) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
        """The last laser pulse at or before each time since the measurement began, and the one after it."""
        before = at_ps // self.period_ps * self.period_ps
        after = before + self.period_ps
        if self._changed_s < math.inf:
            since_ps = max(0, round((self._changed_s - self._started_s) / PS)) // self.period_ps * self.period_ps
            late = since_ps + (at_ps - since_ps) // self._later_ps * self._later_ps
            changed = at_ps >= since_ps
            before, after = np.where(changed, late, before), np.where(changed, late + self._later_ps, after)
        return before, after

    def crossed(self, channel: int, height_mv: int) -> bool:
        """Whether positive pulses of this height make edges there."""
        return 0 < self.level_v.get(channel, 0.5) * 1e3 < height_mv

    def photons_cross(self) -> bool:
        """Whether the detector's pulses make edges."""
        return self.crossed(self.wiring.detector.channel, _TTL_MV)

    def laser_crosses(self) -> bool:
        """Whether the laser's pulses make edges."""
        return self.crossed(self.wiring.sync.channel, _TTL_MV)

    def begin(self, until_s: float | None) -> None:
        """What comes before is of no measurement."""
        self._started_s, self._pulled_ps = self.bench.clock.now(), 0
        self._decoder = T3Decoder(GENERIC)
        self._instrument.start(self._started_s, until_s or self._started_s + _FOREVER_S, self._width_ps * PS)

    def fail(self, call: str) -> None:
        """Raises what the vendor's package raises where a call fails."""
        if (fault := self.bench.faults.strikes("T2", self.bench.clock.now(), call)) is not None:
            lost = bool(fault.parameters.get("lost", False))
            raise RuntimeError("The Time Tagger is not connected any more" if lost else "USB transfer failed")

    def told_ps(self) -> int:
        """Until when everything has become tags."""
        return round(self._instrument.told_s / PS)

    def stop(self) -> None:
        self._instrument.stop()

    def set_clock(self, hertz: float) -> None:
        """AUX OUT ticks at once, then every period; 0 turns it off."""
        self._instrument.set_clock(1e7 / hertz if hertz else 0, self.bench.clock.now())  # type: ignore[arg-type]

    def pull(self) -> Tags:
        """Tags of the time since the last look."""
        self.fail("getData")
        self._instrument.advance(self.bench.clock.now())
        events = self._decoder.feed(self._instrument.read(_RECORDS))
        since_ps = round(self._started_s / PS)
        pulses, sync, detector = events.photon_pulses, self.wiring.sync.channel, self.wiring.detector.channel
        self._drift()
        late_ps = events.format.delays(events.photons).astype(np.int64) * self._width_ps + self._width_ps // 2
        clicks = self._pulse_before(pulses * self.period_ps)[0] + late_ps + self.hardware_ps.get(detector, 0)
        told_ps = self.told_ps() - round(self._started_s / PS)
        # The filter lets the pulse after a photon through, once where several photons came before it.
        last, following = self._pulse_before(clicks - self.hardware_ps.get(sync, 0))
        # With counts, NumPy sorts what is nearly sorted; without, it puts every time into a hash table first.
        lasers, _ = np.unique(following if sync in self.filtered else last, return_counts=True)
        if sync not in self.filtered and self.sync_hz <= _SLOW_HZ and self._changed_s == math.inf:
            lasers = np.arange(-(-self._pulled_ps // self.period_ps), -(-told_ps // self.period_ps)) * self.period_ps
        self._pulled_ps = told_ps
        lasers = lasers + self.hardware_ps.get(sync, 0)
        clicks, lasers = (
            since_ps + each + self.software_ps.get(channel, 0) for each, channel in ((clicks, detector), (lasers, sync))
        )
        if not self.photons_cross():
            clicks = clicks[:0]
        if not self.laser_crosses():
            lasers = lasers[:0]
        times, channels = [clicks, lasers], [np.full(len(clicks), detector), np.full(len(lasers), sync)]
        for k, channel in enumerate(self.wiring.markers):
            seen = events.marker_pulses[(events.marker_bits & (1 << k)) > 0]
            if self.crossed(channel, _MARKER_MV):
                times.append(since_ps + seen * self.period_ps)
                channels.append(np.full(len(seen), channel))
        time = np.concatenate(times)
        order = np.argsort(time, kind="stable")
        return time[order], np.concatenate(channels).astype(np.int32)[order]
