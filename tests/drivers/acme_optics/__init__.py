"""A package of its own, as a lab or a maker would write one: a mirror with a shutter output, and a counter."""

from collections.abc import Sequence
from typing import Any, ClassVar, Literal

from nlos.drivers.clock import Clock
from nlos.drivers.device_model import DeviceModel, ShutterOutput
from nlos.drivers.errors import DeviceFault, LimitError
from nlos.drivers.galvo.block import MirrorBlock
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.identity import DeviceIdentity
from nlos.drivers.link.serial_line import SerialLine
from nlos.drivers.presence import port_presence
from nlos.drivers.shutter import TtlShutter
from nlos.drivers.simulated.fault_row import ALL, FaultRow
from nlos.drivers.simulated.table import SimulatedTable
from nlos.drivers.tcspc.picoquant.families import PicoquantSettings
from nlos.drivers.tcspc.picoquant.model import PICOQUANT
from nlos.drivers.udev import tty_rule


class AcmeSettings(MirrorBlock):
    """The mirror block of a bench file."""

    cable: ClassVar = "serial"

    model: Literal["acme_galvo"]
    port: str
    """The serial port."""
    max_rad: float = 0.5
    """How far the beam may be deflected either way."""

    @property
    def udev_rule(self) -> str:
        return tty_rule(0xACE0, self.model)


class AcmeMirror:
    """A `GalvoMirror`: `x y` in microradians, answered by `ok`."""

    max_sequence = 0

    def __init__(self, settings: AcmeSettings, clock: Clock, wire_log: Any = None) -> None:
        self._settings, self._clock, self._settled_at_s = settings, clock, 0.0
        self._line = SerialLine.open(
            settings.model,
            settings.port,
            clock,
            baud=9600,
            timeout_s=0.5,
            resynchronise=lambda line, probe: None,
            wire_log=wire_log,
        )
        self._at = MirrorAngles(0.0, 0.0)
        self.set_shutter_line(False)
        self.identity = DeviceIdentity("acme_galvo", "ACME", "Galvo One", "7", self._ask(b"who"))
        self.park()

    def _ask(self, command: bytes) -> str:
        return self._line.exchange(command + b"\n").decode().strip()

    def check(self, angles: MirrorAngles) -> None:
        if not max(abs(angles.x_rad), abs(angles.y_rad)) <= self._settings.max_rad:
            raise LimitError("acme_galvo", f"{angles} is out of reach.", "Shrink the wall.")

    def settle_s(self, start: MirrorAngles, end: MirrorAngles) -> float:
        return self._settings.settle.settle_s(start, end)

    def begin_move(self, angles: MirrorAngles) -> None:
        self.check(angles)
        if self._ask(f"{angles.x_rad * 1e6:.0f} {angles.y_rad * 1e6:.0f}".encode()) != "ok":
            raise DeviceFault("acme_galvo", "did not move.")
        self._settled_at_s = self._clock.now() + self.settle_s(self._at, angles)
        self._at = angles

    def wait_settled(self) -> None:
        self._clock.sleep(self._settled_at_s - self._clock.now())

    def move_to(self, angles: MirrorAngles) -> None:
        self.begin_move(angles)
        self.wait_settled()

    def load(self, sequence: Sequence[MirrorAngles]) -> None:
        raise LimitError("acme_galvo", "this mirror cannot step by itself.")

    def start(self) -> None:
        raise LimitError("acme_galvo", "this mirror cannot step by itself.")

    def stop(self) -> None:
        pass

    def look(self) -> None:
        pass

    def park(self) -> None:
        self.move_to(MirrorAngles(0.0, 0.0))

    def close(self) -> None:
        self._line.close()

    def set_shutter_line(self, is_open: bool) -> None:
        self._ask(b"open" if is_open else b"shut")


class AcmeFirmware:
    """The other end of its cable."""

    def __init__(self, table: SimulatedTable, settings: AcmeSettings) -> None:
        self._bench, self._settle_s = table.bench, settings.settle.settle_s

    def opened(self) -> bytes:
        return b""

    reboot = opened

    def receive(self, data: bytes, when_s: float) -> bytes:
        words = data.decode().split()
        if words == ["who"]:
            return b"1.0\r\n"
        if words in (["open"], ["shut"]):
            self._bench.set_shutter(words == ["open"])
        else:
            if self._bench.faults.strikes("ACME1", when_s):
                return b"no\r\n"
            there = MirrorAngles(*(int(word) * 1e-6 for word in words))
            self._bench.steer(there, when_s, self._settle_s(self._bench.beam_at(when_s), there))
        return b"ok\r\n"


MIRROR: DeviceModel[Any] = DeviceModel(
    settings=AcmeSettings,
    open=lambda settings, clock, backend, wire_log: AcmeMirror(settings, clock, wire_log),
    firmware=lambda settings, table: AcmeFirmware(table, settings),
    look_for=lambda settings: port_presence(settings.port, settings.udev_rule),
    faults=[FaultRow("ACME1", "it says no", "`DeviceFault`, shutter closed", ALL)],
    shutters={"acme_shutter": ShutterOutput(TtlShutter)},
)


class AcmeCounterSettings(PicoquantSettings):
    """A counter sold under another name."""

    model: Literal["acme_counter"]  # type: ignore[assignment]


COUNTER: DeviceModel[Any] = DeviceModel(
    settings=AcmeCounterSettings, open=PICOQUANT.open, firmware=PICOQUANT.firmware, look_for=PICOQUANT.look_for
)
