"""What `Swabian.TimeTagger` offers, as far as a counter needs it: functions and classes by the vendor's names.

What they do is taken from the vendor's reference, not from the driver: measurements run from their creation, `startFor`
clears and stops by itself, reading a stream empties it, and unknown channels and closed instruments are refused.
"""

from nlos.drivers.simulated.bench import Gate
from nlos.drivers.simulated.table import SimulatedTable
from nlos.drivers.simulated.timetagger import flim, measurements
from nlos.drivers.simulated.timetagger.tags import FrontPanel
from nlos.drivers.tcspc.timetagger.settings import TimeTaggerSettings

SERIAL = "SIM2100001"
_INPUTS = 18
_HARDWARE_DELAY_PS = 2_500_000
_LEVELS_V = (-1.5, 1.5)


class TimeTaggerPackage:
    """The package with one Time Tagger X plugged in, wired as the bench file says."""

    CHANNEL_UNUSED = flim.CHANNEL_UNUSED

    def __init__(self, table: SimulatedTable, wiring: TimeTaggerSettings) -> None:
        self._panel = FrontPanel(table, wiring)
        self.held = False
        for kind in (measurements.Histogram, flim.Flim, measurements.TimeTagStream, measurements.Countrate,
                     measurements.Combiner, measurements.DelayedChannel):  # fmt: skip
            setattr(self, kind.__name__, kind)

    def scanTimeTagger(self, include_model_name: bool = False) -> list[str]:
        return [] if self.held else [SERIAL]

    def createTimeTagger(self, serial: str = "", resolution: int = 0) -> "Instrument":
        if self.held or serial not in ("", SERIAL):
            raise RuntimeError(f"Could not connect to a Time Tagger with serial {serial!r}")
        self.held = True
        return Instrument(self._panel)

    def freeTimeTagger(self, tagger: "Instrument") -> None:
        if tagger.open:
            tagger.panel.set_clock(0.0)
            tagger.panel.stop()
        tagger.open = self.held = False


class Instrument:
    """A `TimeTagger` of the vendor's."""

    def __init__(self, panel: FrontPanel) -> None:
        self.panel, self.open = panel, True
        self.hub = measurements.Hub(self)
        self._aux_hz: dict[int, float] = {}

    def clicks_a_second(self, channel: int) -> float:
        """What a rate meter says of a channel."""
        panel = self.panel
        if channel == panel.wiring.sync.channel:
            laser_hz = panel.laser_hz() if panel.laser_crosses() else 0.0
            passing = channel in panel.filtered  # the filter is the instrument's, not a measurement's
            return min(laser_hz, self.clicks_a_second(panel.wiring.detector.channel)) if passing else laser_hz
        if channel != panel.wiring.detector.channel or not panel.photons_cross():
            return 0.0
        seen = panel.bench.expose(Gate(panel.bench.clock.now(), 0.1, 1024, 4e-12, 0.0, kept=False))
        return seen.total_count / seen.live_s

    def check_channel(self, channel: int) -> None:
        """Raises `ValueError` where there is none, `RuntimeError` where the instrument is closed."""
        if not self.open:
            raise RuntimeError("The Time Tagger is not connected any more")
        if not (0 < abs(channel) <= _INPUTS or channel in self.hub.virtual):
            raise ValueError(f"Channel {channel} does not exist")

    def getModel(self) -> str:
        return "Time Tagger X"

    def getSerial(self) -> str:
        return SERIAL

    def getFirmwareVersion(self) -> str:
        return "2.22"

    def setTriggerLevel(self, channel: int, voltage: float) -> None:
        """A level beyond its range becomes the last one within; nothing but a line in the log says so."""
        self.check_channel(channel)
        self.panel.level_v[channel] = min(max(voltage, _LEVELS_V[0]), _LEVELS_V[1])

    def getTriggerLevel(self, channel: int) -> float:
        self.check_channel(channel)
        return self.panel.level_v[channel]

    def setInputDelay(self, channel: int, delay: int) -> None:
        """Before the filter where the instrument can."""
        self.check_channel(channel)
        in_hardware = abs(delay) <= _HARDWARE_DELAY_PS
        self.panel.hardware_ps[channel], self.panel.software_ps[channel] = (delay, 0) if in_hardware else (0, delay)

    def setDelaySoftware(self, channel: int, delay: int) -> None:
        self.check_channel(channel)
        self.panel.software_ps[channel] = delay

    def getDelaySoftware(self, channel: int) -> int:
        self.check_channel(channel)
        return self.panel.software_ps.get(channel, 0)

    def setConditionalFilter(self, trigger: list[int], filtered: list[int]) -> None:
        for channel in (*trigger, *filtered):
            self.check_channel(channel)
        self.panel.filtered = frozenset(filtered)

    def clearConditionalFilter(self) -> None:
        self.panel.filtered = frozenset()

    def sync(self, timeout: int = -1) -> bool:
        """Everything until now has become tags."""
        self.check_channel(1)
        self.panel.fail("sync")
        self.hub.pull()
        return True

    def getOverflowsAndClear(self) -> int:
        self.check_channel(1)
        self.panel.fail("getOverflowsAndClear")
        return int(self.panel.bench.faults.strikes("T1", self.panel.bench.clock.now()) is not None)

    def xtra_setAuxOutSignal(self, channel: int, frequency: float) -> None:
        self._aux_hz[channel] = frequency

    def xtra_getAuxOutSignalFrequency(self, channel: int) -> float:
        return self._aux_hz.get(channel, 0.0)

    def xtra_setAuxOut(self, channel: int, enabled: bool) -> None:
        if self.open:
            self.hub.pull()
        self.panel.set_clock(self._aux_hz.get(channel, 0.0) if enabled else 0.0)
