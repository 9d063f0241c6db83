"""A Helios laser DAC before ILDA galvos: holds a point, or plays a sequence by its own clock; nothing is read back."""

import contextlib
from collections.abc import Sequence
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
from nlos.drivers.galvo.axis_codes import axis_codes
from nlos.drivers.galvo.helios import wire
from nlos.drivers.galvo.helios.sequence import marked, most_steps, own_steps, pace
from nlos.drivers.galvo.helios.settings import PRODUCT_ID, VENDOR_ID, HeliosSettings
from nlos.drivers.galvo.mirror import MirrorAngles, OwnSteps
from nlos.drivers.galvo.timed_mirror import TimedMirror
from nlos.drivers.galvo.whereabouts import Whereabouts
from nlos.drivers.identity import DeviceIdentity
from nlos.drivers.link.usb_pipes import UsbPipes

DEVICE = "helios"
REOPEN = "Close the shutter, look at the mirror, then open the bench again."
_RATE = 10_000
_STOPPED_S = 0.12  # frames within 100 ms of a stop are skipped in silence
_STEPS = "Use a scheme in which the host steps it."
_STALE = 8


class Helios(TimedMirror):
    """A `GalvoMirror` that takes no trigger: stepped by the host or, as an `OwnClock`, by itself."""

    max_sequence = 0
    _settings: HeliosSettings

    def __init__(self, settings: HeliosSettings, clock: Clock, pipes: UsbPipes) -> None:
        self.warnings = [f"{DEVICE}: nothing reads back where this mirror points."]
        self._settings, self._clock, self._pipes = settings, clock, pipes
        self._place = Whereabouts(DEVICE, REOPEN)
        self._region, self._target = (MirrorAngles(0.0, 0.0),), None
        self._settled_at_s = 0.0
        self._sequence: tuple[MirrorAngles, ...] = ()
        self._frame, self._step_s = b"", 0.0
        self._played_s: float | None = None
        self._drain()
        versions = [self._ask(wire.FIRMWARE)[1:5] for _ in range(2)]
        if versions[0] != versions[1] or len(versions[0]) < 4:
            raise WrongDevice(DEVICE, "it gave two different answers for its firmware version.", "Replug it.")
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

    def begin_move(self, angles: MirrorAngles) -> None:
        """Both axes in one frame of one point, which is repeated until the next."""
        codes = self._codes(angles)
        self._place.check_known()
        with self._place.motion():
            self._hold(codes)
            self._arrive(angles, 1 / _RATE)

    def load(self, sequence: Sequence[MirrorAngles]) -> None:
        raise LimitError(DEVICE, "this mirror cannot step by itself to a trigger.", _STEPS)

    @property
    def has_own_clock(self) -> bool:
        """Whether the bench file says that the colour outputs are marks."""
        return self._settings.markers == "colours"

    def most_steps(self, dwell_s: float) -> int:
        """As many points as a frame of the DAC holds."""
        return most_steps(dwell_s)

    def own_steps(self, dwell_s: float, settling_s: float) -> OwnSteps:
        """The DAC's clock has whole samples a second, at least 7. Raises `LimitError` below."""
        try:
            return own_steps(dwell_s, settling_s)
        except ValueError as error:
            raise LimitError(DEVICE, f"{error}.", "Choose a shorter dwell, or settling times that are true.") from error

    def load_steps(self, sequence: Sequence[MirrorAngles], steps: OwnSteps) -> None:
        """Makes the frame; nothing is sent before `play`. Raises `LimitError`."""
        if not self.has_own_clock:
            raise LimitError(DEVICE, "its colour outputs mark nothing.", "Wire them, then set markers: colours.")
        most = self.most_steps(steps.dwell_s)
        if not 1 <= len(sequence) <= most:
            raise LimitError(DEVICE, f"a sequence of {len(sequence)} positions.", f"Load 1 to {most} at a time.")
        self._sequence, self._frame = (), b""
        codes = [self._codes(angles) for angles in sequence]
        self._place.check_known()
        self._step_s = steps.step_s
        this = pace(steps.dwell_s, steps.settling_s)
        high = round(self._settings.marker_output_v / wire.COLOUR_FULL_V * 255)
        frame = marked(codes, this.samples, high)
        self._frame = wire.encode_frame(frame, this.rate, wire.START_AT_ONCE | wire.ONCE)
        self._sequence = tuple(sequence)

    def start(self) -> None:
        """Goes to the first position of what `load_steps` took and waits until the mirror is still."""
        if not self.has_own_clock:
            raise CommandRejected(DEVICE, "this mirror cannot step by itself to a trigger.", _STEPS)
        if not self._sequence:
            raise CommandRejected(DEVICE, "no sequence is loaded.", "Call load_steps() before each start().")
        self.move_to(self._sequence[0])

    def play(self) -> None:
        """Sends the frame: a sample later the first mark rises. After the last sample the mirror stays."""
        if not self._frame:
            raise CommandRejected(DEVICE, "no sequence is loaded.", "Call load_steps() before each start().")
        self._place.check_known()
        with self._place.motion():
            self._send(self._frame)
        self._played_s, self._frame = self._clock.now(), b""

    def stop(self) -> None:
        """Ends a sequence where it is by now; the sequence is forgotten."""
        sequence, played_s = self._sequence, self._played_s
        self._sequence, self._frame, self._played_s = (), b"", None
        if played_s is None or not sequence:
            return
        done = (self._clock.now() - played_s) / self._step_s
        if done > len(sequence) + 1:
            self._region, self._target = sequence[-1:], None
            return
        here = sequence[min(int(done), len(sequence) - 1)]
        self._region, self._target = sequence, None
        with self._place.motion():
            self._hold(self._codes(here))
            self._arrive(here, 1 / _RATE)

    def look(self) -> None:
        """Reads what nobody asked for: of a DAC that answers only when asked, a restart or somebody else's answer."""
        with self._place.motion():
            try:
                unasked = self._pipes.answer(0.001)
            except DeviceTimeout:
                return
            raise DeviceReset(DEVICE, f"sent {unasked.hex()} without being asked.", REOPEN)

    def park(self) -> None:
        """Stopped, dark, shutter pin low, then centred and held. After an error, this does not make it usable again."""
        self._sequence, self._frame, self._played_s = (), b"", None
        with self._place.motion():
            self._pipes.command(wire.encode_command(wire.STOP), self._settings.timeout_s)
            self._pipes.command(wire.encode_command(wire.SHUTTER), self._settings.timeout_s)
            self._clock.sleep(_STOPPED_S)
            self._hold((wire.CENTRE, wire.CENTRE))
            self._arrive(MirrorAngles(0.0, 0.0), 1 / _RATE)
        self.wait_settled()

    def close(self) -> None:
        """The DAC keeps holding its last point: stopped, it centres itself."""
        if self._pipes.closed:
            return
        with contextlib.suppress(DeviceError):
            self._pipes.command(wire.encode_command(wire.STOP), self._settings.timeout_s)
            self._pipes.command(wire.encode_command(wire.SHUTTER), self._settings.timeout_s)
        self._pipes.close()

    def _hold(self, codes: tuple[int, int]) -> None:
        """Stays at one point, dark."""
        self._send(wire.encode_frame([wire.Codes(*codes)], _RATE, wire.START_AT_ONCE))

    def _send(self, frame: bytes) -> None:
        if self._ask(wire.STATUS)[1:2] != b"\x01":
            raise DeviceFault(
                DEVICE,
                "it is still playing a frame that this program did not send.",
                "Close other programs that use it.",
            )
        self._pipes.send(frame, self._settings.timeout_s)

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
        settings, full_scale = self._settings, self._settings.optical_deg_at_full_scale
        settings.check_allowed(angles)
        x_sign, y_sign = (-1 if inverted else 1 for inverted in (settings.invert_x, settings.invert_y))
        return axis_codes(
            DEVICE,
            angles,
            settings.max_mechanical_deg,
            lambda rad: wire.code_for(x_sign * rad, full_scale),
            lambda rad: wire.code_for(y_sign * rad, full_scale),
        )
