"""Optotune MR-E-2 and MR-E-3: a fast steering mirror with its own controller, which tells when it is still."""

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from nlos.drivers.clock import Clock
from nlos.drivers.errors import (
    CommandRejected,
    DeviceError,
    DeviceFault,
    DeviceReset,
    DeviceTimeout,
    LimitError,
    ProtocolError,
    SettleTimeout,
    WrongDevice,
)
from nlos.drivers.galvo.mirror import MirrorAngles, reaches_corners
from nlos.drivers.galvo.optotune import wire
from nlos.drivers.galvo.optotune.controller import DEVICE, REOPEN, Controller
from nlos.drivers.galvo.optotune.settings import OptotuneSettings
from nlos.drivers.galvo.optotune.wire import Status
from nlos.drivers.galvo.whereabouts import Whereabouts
from nlos.drivers.identity import DeviceIdentity
from nlos.drivers.link.serial_line import WireLog

__all__ = ["Optotune", "OptotuneSettings"]

_PARKINGS = 6  # replies that are seconds late come within so many attempts


class Optotune:
    """A `GalvoMirror` that cannot step by itself. There is no command that stops it: an emergency stop acts on the
    shutter. `warnings` holds what a person should know and the recording should keep."""

    def __init__(self, settings: OptotuneSettings, clock: Clock, controller: Controller, name: DeviceIdentity) -> None:
        self.warnings: list[str] = []
        self._settings = settings
        self._clock = clock
        self._controller = controller
        self._identity = name
        self._target = MirrorAngles(0.0, 0.0)
        self._looked_deg = np.full(2, settings.max_error_deg)
        """How far out (mechanical) each axis has been compared with what the mirror's sensor sees."""
        self._look_s = 0.0
        self._is_off = False
        self._place = Whereabouts(DEVICE, REOPEN)

    @classmethod
    def open(cls, settings: OptotuneSettings, clock: Clock, wire_log: WireLog | None = None) -> "Optotune":
        """Opens the port, makes sure who answers, and centres the mirror where no fault forbids it.

        Raises `DeviceNotFound`, `DeviceBusy`, `WrongDevice` and whatever a move may raise.
        """
        controller = Controller.open(settings.port, clock, timeout_s=settings.timeout_s, wire_log=wire_log)
        try:
            if settings.controller not in ("auto", controller.model):
                raise WrongDevice(
                    DEVICE,
                    f"it is an {controller.model}; the bench file names an {settings.controller}.",
                    "Correct `controller` in the bench file.",
                )
            mirror = cls(settings, clock, controller, controller.identity())
            mirror._set_up()
        except BaseException:
            controller.close()
            raise
        return mirror

    @property
    def identity(self) -> DeviceIdentity:
        """From GETID, GETSN and GETVERSION."""
        return self._identity

    @property
    def max_sequence(self) -> int:
        return 0

    def check(self, angles: MirrorAngles) -> None:
        """Raises `LimitError` off the disc that the mirror reaches. The controller would trim silently."""
        self._coordinates(angles)

    def settle_s(self, start: MirrorAngles, end: MirrorAngles) -> float:
        if start == end:
            return 0.0
        return self._settings.settle.settle_s(start, end) + self._settings.stable_s

    def reaches_all(self, x_rad: npt.NDArray[np.float64], y_rad: npt.NDArray[np.float64]) -> bool:
        """Both coordinates on the disc grow with either angle."""
        return reaches_corners(self.check, x_rad, y_rad)

    def settles_s(self, x_rad: npt.NDArray[np.float64], y_rad: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """By the settle table, and as long as the mirror has to say that it is still; 0 where it stays."""
        moves = (np.diff(x_rad) != 0) | (np.diff(y_rad) != 0)
        return np.where(moves, self._settings.settle.settles_s(x_rad, y_rad) + self._settings.stable_s, 0.0)

    def looks_s(self, x_rad: npt.NDArray[np.float64], y_rad: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """What it took at the centre, wherever positions will be compared."""
        return np.where(self._looks(x_rad, y_rad), self._look_s, 0.0)

    def begin_move(self, angles: MirrorAngles) -> None:
        """Sends both coordinates in one command."""
        x, y = self._coordinates(angles)
        self._place.check_known()
        with self._place.motion():
            self._send(x, y)
            self._target = angles

    def _send(self, x: float, y: float) -> None:
        if not self._controller.set_position(x, y):
            raise CommandRejected(DEVICE, f"a place was trimmed, the mirror points elsewhere. {self._where()}", REOPEN)

    def wait_settled(self) -> None:
        """Polls the status until it says stable twice in a row, `stable_ms` apart, then compares positions where
        `readback` asks for it, and wherever an axis is twice as far out as it was ever compared: other programs leave a
        gain for the input, and the centre is where it is with any.

        Raises `SettleTimeout`, and `DeviceFault` for any fault bit, present or latched. The mirror is not moved again.
        """
        self._place.check_known()
        with self._place.motion():
            self._wait_stable()
            x_rad, y_rad = (np.array([each]) for each in (self._target.x_rad, self._target.y_rad))
            if self._looks(x_rad, y_rad)[0]:
                self._looked_deg = np.maximum(self._looked_deg, _out_deg(x_rad, y_rad)[:, 0])
                self.measured()

    def _looks(self, x_rad: npt.NDArray[np.float64], y_rad: npt.NDArray[np.float64]) -> npt.NDArray[np.bool_]:
        """At which of these places (n,), taken in turn, positions are compared."""
        looks = np.full(len(x_rad), self._settings.readback)
        out_deg, looked_deg, at = _out_deg(x_rad, y_rad), self._looked_deg, 0
        while (far_out := (out_deg[:, at:] > 2 * looked_deg[:, None]).any(axis=0)).any():
            at += int(far_out.argmax())
            looks[at] = True
            looked_deg, at = np.maximum(looked_deg, out_deg[:, at]), at + 1
        return looks

    def move_to(self, angles: MirrorAngles) -> None:
        self.begin_move(angles)
        self.wait_settled()

    def measured(self) -> MirrorAngles:
        """Where the controller's sensor sees the mirror (repeatable to 40 urad, accurate to 0.15 deg). A distance from
        the commanded position beyond `warn_error_deg` is a warning, beyond `max_error_deg` a `DeviceFault`."""
        with self._place.motion():
            measured = wire.angles_at(*self._controller.measured_position())
            error_deg = math.degrees(
                math.hypot(measured.x_rad - self._target.x_rad, measured.y_rad - self._target.y_rad) / 2.0
            )
            what = f"the mirror was sent to {_shown(self._target)} and is at {_shown(measured)}"
            if error_deg > self._settings.max_error_deg:
                raise DeviceFault(DEVICE, f"{what}.", REOPEN)
            was_off, self._is_off = self._is_off, error_deg > self._settings.warn_error_deg
            if self._is_off and not was_off:  # one that stays off is told of once
                self.warnings.append(f"{DEVICE}: {what}.")
        return measured

    def load(self, sequence: Sequence[MirrorAngles]) -> None:
        raise LimitError(DEVICE, "this mirror cannot step by itself.", "Use a scheme in which the host steps it.")

    def start(self) -> None:
        raise CommandRejected(DEVICE, "this mirror cannot step by itself.", "Use a scheme in which the host steps it.")

    def stop(self) -> None:
        """Nothing to end: this mirror never steps by itself."""

    def look(self) -> None:
        with self._place.motion():
            self._controller.look()

    def park(self) -> None:
        """Centre. Refused after a settle timeout or a fault: what does not settle is not sent elsewhere.

        Replies that are seconds late are waited for; where none comes, the command is sent all the same before the
        error is raised.
        """
        for left in reversed(range(_PARKINGS)):
            if isinstance(self._place.lost_by, SettleTimeout | DeviceFault):
                self._place.check_known()
            try:
                self._park()
                return
            except SettleTimeout:
                raise
            except (DeviceTimeout, ProtocolError, DeviceReset, CommandRejected):
                if not left:
                    self._controller.centre_unheard()
                    raise

    def acknowledge(self) -> None:
        """Clears latched faults, which is a person's decision; then open the bench again. Raises `DeviceFault` where
        one is still present."""
        self._controller.acknowledge()
        if faults := self._controller.status().faults:
            raise DeviceFault(DEVICE, f"still reports {_names(faults)}.", "Let it cool, check its cable and power.")

    def close(self) -> None:
        self._controller.close()

    def _set_up(self) -> None:
        if faults := self._controller.status().faults:
            self._place.lost_by = _fault(faults)
            self.warnings.append(str(self._place.lost_by))
            return
        self._park()
        began_s = self._clock.now()
        self.measured()
        self._look_s = self._clock.now() - began_s

    def _park(self) -> None:
        with self._place.motion():
            if self._place.lost_by is not None:
                self._controller.recover()
            self._send(0.0, 0.0)
            self._target = MirrorAngles(0.0, 0.0)
            self._wait_stable()

    def _coordinates(self, angles: MirrorAngles) -> tuple[float, float]:
        self._settings.check_allowed(angles)
        limit_deg = 2.0 * self._settings.max_mechanical_deg
        if max(abs(angles.x_rad), abs(angles.y_rad)) < math.pi / 2:
            x, y = wire.coordinates(angles)
            if math.hypot(x, y) <= min(1.0, math.tan(math.radians(limit_deg)) / wire.FULL_SCALE + 1e-9):
                return x, y
        raise LimitError(
            DEVICE,
            f"mirror {_shown(angles)} is outside the circle of {limit_deg:.2f} deg optical.",
            "Shrink the wall in the plan, aim nearer to its middle, or move the scanner back.",
        )

    def _wait_stable(self) -> None:
        deadline_s = self._clock.now() + self._settings.settle_timeout_s
        stable = 0
        while True:
            status = self._controller.status()
            if status.faults:
                raise _fault(status.faults)
            stable = 0 if status & Status.NOT_STABLE else stable + 1
            if stable == 2:
                return
            if self._clock.now() >= deadline_s:
                raise SettleTimeout(
                    DEVICE,
                    f"not stable after {self._settings.settle_timeout_s:g} s: STATUS 0x{status:08x}, {self._board()}.",
                    REOPEN,
                )
            self._clock.sleep(max(self._settings.stable_s if stable else 0.0, self._settings.polled_every_s))

    def _board(self) -> str:
        try:
            return f"board faults (0x1007) 0x{self._controller.board_faults():08x}"
        except DeviceError as error:
            return f"board faults (0x1007) not readable ({error.what})"

    def _where(self) -> str:
        try:
            return f"It is at {_shown(wire.angles_at(*self._controller.measured_position()))}."
        except DeviceError as error:
            return f"Where, it does not say ({error.what})."


def _out_deg(x_rad: npt.NDArray[np.float64], y_rad: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """How far each axis is turned (mechanical), (2, n)."""
    return np.degrees(np.abs(np.stack((x_rad, y_rad)))) / 2.0


def _fault(faults: Status) -> DeviceFault:
    return DeviceFault(DEVICE, f"reports {_names(faults)}.", "Close the shutter, find the cause, then acknowledge it.")


def _names(faults: Status) -> str:
    named = ", ".join('"' + (flag.name or "").lower().replace("_", " ") + '"' for flag in faults)
    return f"{named} (STATUS 0x{faults:08x})"


def _shown(angles: MirrorAngles) -> str:
    return f"x = {math.degrees(angles.x_rad):+.2f} deg, y = {math.degrees(angles.y_rad):+.2f} deg optical"
