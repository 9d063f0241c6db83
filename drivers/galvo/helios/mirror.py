"""A Helios laser DAC before ILDA galvos: one point held at a time, and nothing read back."""

import contextlib
import math
from collections.abc import Iterator, Sequence
from typing import Any

from nlos.drivers.clock import Clock
from nlos.drivers.device_model import WireLog
from nlos.drivers.errors import (
    CommandRejected,
    DeviceError,
    DeviceFault,
    DeviceReset,
    DeviceTimeout,
    LimitError,
    WrongDevice,
)
from nlos.drivers.galvo.helios import wire
from nlos.drivers.galvo.helios.settings import PRODUCT_ID, VENDOR_ID, HeliosSettings
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.identity import DeviceIdentity
from nlos.drivers.link.usb_pipes import UsbPipes

DEVICE = "helios"
REOPEN = "Close the shutter, look at the mirror, then open the bench again."
_RATE = 10_000
_STOPPED_S = 0.12  # frames within 100 ms of a stop are skipped in silence
_STEPS = "Use a scheme in which the host steps it."
_STALE = 8


class Helios:
    """A `GalvoMirror` stepped by the host. Its own clock takes no trigger and could not be told from a counter's."""

    max_sequence = 0

    def __init__(self, settings: HeliosSettings, clock: Clock, pipes: UsbPipes) -> None:
        self.warnings = [f"{DEVICE}: nothing reads back where this mirror points."]
        self._settings, self._clock, self._pipes = settings, clock, pipes
        self._unknown: BaseException | None = None
        self._at = MirrorAngles(0.0, 0.0)
        self._settled_at_s = 0.0
        self._drain()
        versions = [self._ask(wire.FIRMWARE)[1:5] for _ in range(2)]
        if versions[0] != versions[1] or len(versions[0]) < 4:
            raise WrongDevice(DEVICE, "it does not say twice which firmware it has.", "Replug it.")
        name = self._ask(wire.NAME)[1:].split(b"\0")[0].decode("ascii", "replace")
        firmware = str(int.from_bytes(versions[0], "little"))
        self.identity = DeviceIdentity(DEVICE, "Bitlasers", "Helios laser DAC", name, firmware)
        self.park()

    @classmethod
    def open(cls, settings: HeliosSettings, clock: Clock, backend: Any, wire_log: WireLog | None) -> "Helios":
        """Claims the DAC, makes sure who answers, drives its shutter pin low and centres the mirror.

        Raises `DeviceNotFound`, `DeviceBusy`, `WrongDevice` and whatever a move may raise.
        """
        pipes = UsbPipes(DEVICE, (VENDOR_ID, PRODUCT_ID), None, backend, wire_log)
        try:
            return cls(settings, clock, pipes)
        except BaseException:
            pipes.close()
            raise

    def check(self, angles: MirrorAngles) -> None:
        """Raises `LimitError` when `angles` is beyond the head or the DAC."""
        self._codes(angles)

    def settle_s(self, start: MirrorAngles, end: MirrorAngles) -> float:
        return self._settings.settle.settle_s(start, end)

    def begin_move(self, angles: MirrorAngles) -> None:
        """Both axes in one frame of one point, which is repeated until the next."""
        codes = self._codes(angles)
        if self._unknown is not None:
            cause = getattr(self._unknown, "what", self._unknown)
            raise DeviceFault(DEVICE, f"where the mirror points is not known any more: {cause}", REOPEN)
        with self._motion():
            self._hold(codes)
            self._arrive(angles)

    def wait_settled(self) -> None:
        self._clock.sleep(self._settled_at_s - self._clock.now())

    def move_to(self, angles: MirrorAngles) -> None:
        self.begin_move(angles)
        self.wait_settled()

    def load(self, sequence: Sequence[MirrorAngles]) -> None:
        raise LimitError(DEVICE, "this mirror cannot step by itself to a trigger.", _STEPS)

    def start(self) -> None:
        raise CommandRejected(DEVICE, "this mirror cannot step by itself to a trigger.", _STEPS)

    def stop(self) -> None:
        """Nothing to end: this mirror never steps by itself."""

    def look(self) -> None:
        """Reads what nobody asked for: of a DAC that answers only when asked, a restart or somebody else's answer."""
        with self._motion():
            try:
                unasked = self._pipes.answer(0.001)
            except DeviceTimeout:
                return
            raise DeviceReset(DEVICE, f"said {unasked.hex()} unasked.", REOPEN)

    def park(self) -> None:
        """Stopped, dark, shutter pin low, then centred and held. After an error, this does not make it usable again."""
        with self._motion():
            self._pipes.command(wire.encode_command(wire.STOP), self._settings.timeout_s)
            self._pipes.command(wire.encode_command(wire.SHUTTER), self._settings.timeout_s)
            self._clock.sleep(_STOPPED_S)
            self._hold((wire.CENTRE, wire.CENTRE))
            self._arrive(MirrorAngles(0.0, 0.0))
        self.wait_settled()

    def close(self) -> None:
        """The DAC goes on holding its last point: stopped, it centres itself."""
        if self._pipes.closed:
            return
        with contextlib.suppress(DeviceError):
            self._pipes.command(wire.encode_command(wire.STOP), self._settings.timeout_s)
            self._pipes.command(wire.encode_command(wire.SHUTTER), self._settings.timeout_s)
        self._pipes.close()

    def _hold(self, codes: tuple[int, int]) -> None:
        if self._ask(wire.STATUS)[1:2] != b"\x01":
            raise DeviceFault(DEVICE, "it still has a frame that it was not sent.", "Close other programs that use it.")
        self._pipes.send(wire.encode_frame([codes], _RATE, wire.START_AT_ONCE), self._settings.timeout_s)

    def _arrive(self, angles: MirrorAngles) -> None:
        self._settled_at_s = self._clock.now() + 1 / _RATE + self.settle_s(self._at, angles)
        self._at = angles

    def _ask(self, code: int) -> bytes:
        """The answer, which begins with the command's code and its top bit; older answers are let go."""
        self._pipes.command(wire.encode_command(code), self._settings.timeout_s)
        for _ in range(_STALE):
            answer = self._pipes.answer(self._settings.timeout_s)
            if answer[:1] == bytes([0x80 | code]):
                return answer
        raise WrongDevice(DEVICE, f"answers command {code} with {answer.hex()}.", "Replug it.")

    def _drain(self) -> None:
        """What another program left unread."""
        with contextlib.suppress(DeviceTimeout):
            for _ in range(_STALE):
                self._pipes.answer(0.005)

    def _codes(self, angles: MirrorAngles) -> tuple[int, int]:
        settings, codes = self._settings, []
        limit_deg = 2.0 * settings.max_mechanical_deg
        remedy = "Shrink the wall in the plan or move the scanner back."
        for name, inverted, angle_rad in (
            ("x", settings.invert_x, angles.x_rad),
            ("y", settings.invert_y, angles.y_rad),
        ):
            what = f"mirror {name} = {math.degrees(angle_rad):+.2f} deg optical"
            if not abs(math.degrees(angle_rad)) <= limit_deg:
                raise LimitError(DEVICE, f"{what} is outside +-{limit_deg:.2f} deg optical.", remedy)
            try:
                codes.append(wire.code_for(-angle_rad if inverted else angle_rad, settings.optical_deg_at_full_scale))
            except ValueError as error:
                raise LimitError(DEVICE, f"{what} {error}.", remedy) from error
        return codes[0], codes[1]

    @contextlib.contextmanager
    def _motion(self) -> Iterator[None]:
        """Whatever cuts this short, an interrupt too, leaves the mirror where nobody knows."""
        try:
            yield
        except BaseException as error:
            self._unknown = self._unknown or error
            raise
