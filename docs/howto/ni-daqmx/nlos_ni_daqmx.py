"""A galvo head on two analog outputs of a National Instruments card, stepped by the computer through NI-DAQmx."""

import importlib
import math
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from threading import Thread
from types import SimpleNamespace
from typing import Any, ClassVar, Literal, Self

from pydantic import Field, model_validator

from nlos.configs.settings import Settings
from nlos.drivers import errors
from nlos.drivers.clock import Clock
from nlos.drivers.device_model import DeviceModel, ShutterOutput, WireLog
from nlos.drivers.galvo.axis_codes import axis_codes
from nlos.drivers.galvo.block import MirrorBlock
from nlos.drivers.galvo.mirror import GalvoMirror, MirrorAngles
from nlos.drivers.galvo.timed_mirror import TimedMirror
from nlos.drivers.galvo.whereabouts import Whereabouts
from nlos.drivers.identity import DeviceIdentity
from nlos.drivers.presence import Presence
from nlos.drivers.shutter import TtlShutter
from nlos.drivers.simulated.servo import GalvoHead
from nlos.drivers.simulated.table import SimulatedTable

DEVICE = "ni_daqmx"
NAMES = "Correct the name in the bench file: NI MAX, or `nilsdev` on Linux, lists cards and their outputs."
RANGE = "Set `least_v` and `most_v` to a range of this card."
KINDS: tuple[tuple[type[errors.DeviceError], str, set[int]], ...] = (
    (errors.DeviceBusy, "Close what holds it: another nlos, LabVIEW, a test panel.", {-50103, -200022, -200587}),
    (errors.DeviceNotFound, NAMES, {-200220, -200170}),
    (errors.LimitError, RANGE, {-200077, -200561}),
    (errors.DeviceTimeout, "Shut the laser off, reset the card in NI MAX, then open the bench again.", {-200474}),
    (errors.DeviceLost, "Check cable and power, then open the bench again.", {-200045, -201003, -88705, -88709}),
)
"""What NI's error codes are here, and what to do next. Any other is a `DeviceFault` in NI's words."""


class Axis(Settings):
    """What the volts of one galvo axis mean."""

    volts_per_degree: float = Field(default=0.5, ge=-10, le=10)
    """Of the galvo driver, per mechanical degree; negative where the axis is mounted the other way round."""
    offset_v: float = Field(default=0.0, ge=-10, le=10)
    """Volts with the mirror at its centre."""


class NiDaqmxSettings(MirrorBlock):
    """The mirror block of a bench file."""

    cable: ClassVar = "library"
    incidental: ClassVar[frozenset[str]] = MirrorBlock.incidental | {"shutter_line"}
    model: Literal["ni_daqmx"]
    library: str = Field(default="vendor", pattern="^(vendor|simulated)$")
    """NI's Python package nidaqmx ("vendor"), or "simulated"."""
    x_output: str = Field(default="Dev1/ao0", pattern=r"^[^/,:]+/ao\d+$")
    """Analog output, as NI names it, of the axis that moves the beam sideways."""
    y_output: str = Field(default="Dev1/ao1", pattern=r"^[^/,:]+/ao\d+$")
    """Analog output of the axis that moves the beam up and down."""
    x: Axis = Axis()
    """The axis that moves the beam sideways."""
    y: Axis = Axis()
    """The axis that moves the beam up and down."""
    least_v: float = Field(default=-10.0, ge=-10, le=0)
    """Least volts of both outputs: of the card's range, or of what the galvo driver takes where that is less."""
    most_v: float = Field(default=10.0, gt=0, le=10)
    """Most volts of both outputs."""
    max_mechanical_deg: float = Field(default=20.0, gt=0, le=45)
    """How far the head may turn either way from its centre, mechanical; beyond it moves are refused."""
    shutter_line: str | None = Field(default=None, pattern=r"^[^/,:]+/port\d+/line\d+$")
    """Digital line that is wired to the laser shutter, which opens when it is high."""
    timeout_s: float = Field(default=0.5, ge=0.05, le=10)
    """How long a call of NI's library may take."""

    @model_validator(mode="after")
    def _two_axes(self) -> Self:
        cards = {output.partition("/")[0] for output in (self.x_output, self.y_output)}
        if self.x_output == self.y_output or len(cards) > 1:
            raise ValueError("x_output and y_output must be two outputs of one card")
        for axis in (self.x, self.y):
            if axis.volts_per_degree == 0 or not self.least_v <= axis.offset_v <= self.most_v:
                raise ValueError("volts_per_degree must not be 0, and offset_v must lie within least_v and most_v")
        return self


class NiDaqmxMirror(TimedMirror):
    """A `GalvoMirror` without a sequence of its own, and a shutter's line. It makes the line dark before all else."""

    max_sequence = 0
    _settings: NiDaqmxSettings

    def __init__(self, settings: NiDaqmxSettings, clock: Clock, package: Any, wire_log: WireLog | None) -> None:
        self._settings, self._clock, self._package, self._log = settings, clock, package, wire_log
        self._place = Whereabouts(DEVICE, "Close the shutter, look at the mirror, then open the bench again.")
        limit_rad = math.radians(2.0 * settings.max_mechanical_deg)
        self._anywhere = (MirrorAngles(-limit_rad, -limit_rad), MirrorAngles(limit_rad, limit_rad))
        self._region, self._target, self._settled_at_s = self._anywhere, None, 0.0
        self._calls: list[Thread] = []
        self._tasks: dict[str, Any] = {}
        self.warnings = [f"{DEVICE}: nothing reads back where this mirror points."]
        try:
            if settings.shutter_line is not None:
                self._make("line", lambda task: task.do_channels.add_do_chan(settings.shutter_line))
                self.set_shutter_line(False)
            self.identity = self._call("look at the card", self._identify)
            self._make("outputs", self._add_outputs)
            self.park()
        except BaseException:
            self.close()
            raise

    def _make(self, name: str, add: Callable[[Any], None]) -> None:
        """A started task holds its outputs: no other program can write to them."""
        task = self._tasks[name] = self._call(f"make a task for its {name}", self._package.Task)
        self._call(f"name its {name}", add, task)
        self._call(f"reserve its {name}", task.start)

    def _identify(self) -> DeviceIdentity:
        system, settings = self._package.system.System.local(), self._settings
        name = settings.x_output.partition("/")[0]
        card, ends = system.devices[name], list(system.devices[name].ao_voltage_rngs)
        ranges = list(zip(ends[::2], ends[1::2], strict=True))
        if not any(low <= settings.least_v and settings.most_v <= high for low, high in ranges):
            has = " or ".join(f"{low:g} to {high:g} V" for low, high in ranges) or "no voltage"
            what = f"{card.product_type} puts out {has}, not {settings.least_v:g} to {settings.most_v:g} V."
            raise errors.LimitError(DEVICE, what, RANGE)
        if card.is_simulated:
            self.warnings.append(f"{DEVICE}: {name} is a card that NI-DAQmx only simulates: nothing moves.")
        version = "NI-DAQmx " + ".".join(map(str, system.driver_version))
        return DeviceIdentity(DEVICE, "National Instruments", card.product_type, f"{card.serial_num:08X}", version)

    def _add_outputs(self, task: Any) -> None:
        for output in (self._settings.x_output, self._settings.y_output):  # NI's default is +-10 V on any card
            task.ao_channels.add_ao_voltage_chan(output, min_val=self._settings.least_v, max_val=self._settings.most_v)

    def begin_move(self, angles: MirrorAngles) -> None:
        self.check(angles)
        self._place.check_known()
        self._aim(angles)

    def park(self) -> None:
        self._region, self._target = self._anywhere, None
        self._aim(MirrorAngles(0.0, 0.0))
        self.wait_settled()

    def _aim(self, angles: MirrorAngles) -> None:
        with self._place.motion():
            self._write("outputs", [code * 1e-6 for code in self._codes(angles)])
            self._arrive(angles)

    def load(self, sequence: Sequence[MirrorAngles]) -> None:
        raise errors.LimitError(DEVICE, "this mirror cannot step by itself.", "Let the host step it.")

    def start(self) -> None:
        self.load(())

    def stop(self) -> None:
        """It never steps."""

    def look(self) -> None:
        """A card that is gone shows at the next write: with the next point."""

    def set_shutter_line(self, is_open: bool) -> None:
        """Closing goes past a call under way, and is confirmed only once that has ended, too."""
        if self._settings.shutter_line is None:
            raise errors.LimitError(DEVICE, "no shutter is wired to a line.", "Set `shutter_line` in the bench file.")
        if is_open:
            self._place.check_known()
        self._write("line", is_open, at_once=not is_open)

    def close(self) -> None:
        """Dark, then lets go of line and outputs, which stay as they are: `park` comes before."""
        with suppress(errors.DeviceError):
            if "line" in self._tasks:
                self.set_shutter_line(False)
        while self._tasks:
            with suppress(errors.DeviceError):
                self._call("clear a task", self._tasks.popitem()[1].close, at_once=True)

    def _codes(self, angles: MirrorAngles) -> tuple[int, int]:
        """In microvolts."""
        self._settings.check_allowed(angles)
        x, y = (partial(self._microvolts, axis) for axis in (self._settings.x, self._settings.y))
        return axis_codes(DEVICE, angles, self._settings.max_mechanical_deg, x, y)

    def _microvolts(self, axis: Axis, angle_rad: float) -> int:
        volts = axis.offset_v + axis.volts_per_degree * math.degrees(angle_rad) / 2.0
        if not self._settings.least_v <= volts <= self._settings.most_v:
            raise ValueError(f"is {volts:+.3f} V, outside {self._settings.least_v:g} to {self._settings.most_v:g} V")
        return round(volts * 1e6)

    def _write(self, name: str, value: list[float] | bool, at_once: bool = False) -> None:
        """One sample for each output of the task, which has no clock: it is out when NI-DAQmx returns."""
        if name not in self._tasks:
            raise errors.DeviceLost(DEVICE, "it was closed.", "Open the bench again.")
        write = partial(self._tasks[name].write, auto_start=False, timeout=self._settings.timeout_s)
        if (taken := self._call(f"write {value} to its {name}", write, value, at_once=at_once)) != 1:
            raise errors.DeviceFault(DEVICE, f"NI-DAQmx took {taken} samples of {value}, not 1.")

    def _call(self, what: str, function: Callable[..., Any], *given: Any, at_once: bool = False) -> Any:
        """What NI's library answers. Most of its functions have no deadline: a thread waits for each. One that is late
        may act yet, so that only what is `at_once` goes past it, and that is an error until the late one has ended."""
        ended: list[tuple[Any, Exception | None]] = []
        if not at_once:
            self._wait(what)
        thread = Thread(target=lambda: ended.append(_tried(function, *given)), name=what, daemon=True)
        self._calls = [*(each for each in self._calls if each.is_alive()), thread]
        if self._log:
            self._log(DEVICE, ">", what.encode())
        thread.start()
        self._wait(what)
        answer, error = ended[0]
        if error is not None:
            raise _named(what, error) from error
        return answer

    def _wait(self, what: str) -> None:
        until_s = time.monotonic() + self._settings.timeout_s  # a thread works by no simulated clock
        for each in self._calls:
            each.join(max(until_s - time.monotonic(), 0.0))
        if late := [each.name for each in self._calls if each.is_alive()]:
            why = f"{what}: NI-DAQmx did not return within {self._settings.timeout_s:g} s from: {', '.join(late)}."
            raise errors.DeviceTimeout(DEVICE, why, "Shut the laser off, check the card, then start the program again.")


def _tried(function: Callable[..., Any], *given: Any) -> tuple[Any, Exception | None]:
    try:
        return function(*given), None
    except Exception as error:  # told to whoever waits
        return None, error


def _named(what: str, error: Exception) -> errors.DeviceError:
    if isinstance(error, errors.DeviceError):
        return error
    said, code = f"{what}: {' '.join(str(error).split())}", getattr(error, "error_code", None)
    if isinstance(error, ImportError):
        return errors.DeviceNotFound(DEVICE, said, "pip install nidaqmx.")
    if type(error).__name__ in ("DaqNotFoundError", "DaqNotSupportedError", "DaqFunctionNotSupportedError"):
        return errors.DeviceNotFound(DEVICE, said, "Install NI-DAQmx from ni.com: nidaqmx is only its Python side.")
    kind, remedy = next((each[:2] for each in KINDS if code in each[2]), (errors.DeviceFault, ""))
    return kind(DEVICE, said, remedy)


def _cards() -> tuple[Any, list[str]]:
    """NI's package, and the cards that its driver knows; opens none. Raises `DeviceNotFound`."""
    try:
        names = list(importlib.import_module("nidaqmx.system").System.local().devices.device_names)
    except Exception as error:  # NI's own errors can only be named where its package is there
        raise _named("look for cards", error) from error
    return importlib.import_module("nidaqmx"), names


def _look_for(settings: NiDaqmxSettings) -> Presence:
    name = settings.x_output.partition("/")[0]
    try:
        names = _cards()[1]
    except errors.DeviceError as error:
        return Presence(False, error.what, error.remedy)
    if name not in names:
        return Presence(False, f"NI-DAQmx knows no {name}, but {', '.join(names) or 'no card at all'}", NAMES)
    return Presence(True, f"NI-DAQmx knows {name}; `nlos doctor` asks it")


class StandIn:
    """What replaces nidaqmx on a simulated bench: one card, a head behind its outputs, a shutter behind its line."""

    def __init__(self, settings: NiDaqmxSettings, table: SimulatedTable) -> None:
        self._axes, self._bench, self._head = (settings.x, settings.y), table.bench, GalvoHead(table.bench.servo)
        kind = {"product_type": "simulated card", "serial_num": 1, "is_simulated": False}
        card = SimpleNamespace(**kind, ao_voltage_rngs=[-10.0, 10.0])
        local = SimpleNamespace(devices={settings.x_output.partition("/")[0]: card}, driver_version=(0, 0, 0))
        self.system = SimpleNamespace(System=SimpleNamespace(local=lambda: local))
        adds = SimpleNamespace(add_ao_voltage_chan=lambda output, **ends: None, add_do_chan=lambda line: None)
        task = SimpleNamespace(ao_channels=adds, do_channels=adds, start=str, close=str, write=self._write)
        self.Task = lambda: task

    def _write(self, value: list[float] | bool, auto_start: bool, timeout: float) -> int:
        if isinstance(value, bool):
            self._bench.set_shutter(value)
            return 1
        turned = ((v - axis.offset_v) / axis.volts_per_degree for v, axis in zip(value, self._axes, strict=True))
        there, now_s = MirrorAngles(*(math.radians(2.0 * deg) for deg in turned)), self._bench.clock.now()
        self._head.steer(there, now_s)
        self._bench.follow_path(self._head.at, there, now_s)
        return 1


MIRROR: DeviceModel[GalvoMirror] = DeviceModel(
    settings=NiDaqmxSettings,
    open=lambda settings, clock, backend, wire_log: NiDaqmxMirror(settings, clock, backend or _cards()[0], wire_log),
    firmware=lambda settings, table: StandIn(settings, table),
    look_for=_look_for,
    shutters={"ni_daqmx_line": ShutterOutput(TtlShutter, needs="shutter_line")},
)
