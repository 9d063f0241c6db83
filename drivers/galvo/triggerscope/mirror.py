"""TriggerScope-MM: a serial DAC and sequencer in front of an analogue galvo head (Thorlabs GVS012 class)."""

import contextlib
import math
from collections.abc import Iterator, Sequence
from functools import partial

from nlos.drivers.clock import Clock
from nlos.drivers.errors import (
    CommandRejected,
    DeviceFault,
    DeviceReset,
    DeviceTimeout,
    LimitError,
    MirrorDisturbed,
    ProtocolError,
)
from nlos.drivers.galvo.axis_codes import axis_codes
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.galvo.timed_mirror import TimedMirror
from nlos.drivers.galvo.triggerscope import wire
from nlos.drivers.galvo.triggerscope.controller import DEVICE, REOPEN, Controller
from nlos.drivers.galvo.triggerscope.set_up import centre, dark, disarm, ranges, set_up
from nlos.drivers.galvo.triggerscope.settings import TriggerScopeSettings
from nlos.drivers.galvo.whereabouts import Whereabouts
from nlos.drivers.identity import DeviceIdentity
from nlos.drivers.link.repeats import repeated
from nlos.drivers.link.serial_line import WireLog

__all__ = ["TriggerScope", "TriggerScopeSettings"]

_PARKINGS = 6  # replies that are seconds late come within so many attempts
# Or what an old answer is taken for.
_LATE = (DeviceTimeout, ProtocolError, DeviceReset, CommandRejected, MirrorDisturbed)


class TriggerScope(TimedMirror):
    """A `GalvoMirror`. `warnings` holds what a person should know and the recording should keep."""

    _settings: TriggerScopeSettings

    def __init__(self, settings: TriggerScopeSettings, clock: Clock, controller: Controller) -> None:
        self.warnings: list[str] = []
        self._settings = settings
        self._clock = clock
        self._controller = controller
        self._axes = (settings.x, settings.y)
        self._dacs = (settings.x.dac, settings.y.dac)
        self._ranges_set = True
        self._place = Whereabouts(DEVICE, REOPEN)
        limit_rad = math.radians(2.0 * settings.max_mechanical_deg)
        self._anywhere = (MirrorAngles(-limit_rad, -limit_rad), MirrorAngles(limit_rad, limit_rad))
        self._region, self._target = self._anywhere, None
        self._settled_at_s = 0.0
        self._sequence: tuple[MirrorAngles, ...] = ()
        self._armed = False
        self._seen_to_move = settings.allow_unverified_dac

    @classmethod
    def open(cls, settings: TriggerScopeSettings, clock: Clock, wire_log: WireLog | None = None) -> "TriggerScope":
        """Opens the port, makes sure who answers, closes the shutter output and centres the mirror.

        Raises `DeviceNotFound`, `DeviceBusy`, `WrongDevice` and whatever a command may raise.
        """
        controller = Controller.open(
            settings.port,
            clock,
            timeout_s=settings.timeout_s,
            banner_timeout_s=settings.banner_timeout_s,
            wire_log=wire_log,
            last_words=[] if settings.shutter_pin is None else dark(_group_of(settings.shutter_pin)),
        )
        mirror = cls(settings, clock, controller)
        if not controller.gave_banner and settings.allow_unverified_dac:
            mirror.warnings.append(f"{DEVICE}: no start-up banner; that the mirror moves is not verified.")
        try:
            try:
                mirror._set_up()
            except MirrorDisturbed as error:
                mirror.warnings.append(f"{DEVICE}: {error.what} Its settings were sent again.")
                mirror.restore()
        except BaseException:
            mirror.close()
            raise
        return mirror

    @property
    def identity(self) -> DeviceIdentity:
        """From its start-up banner or `*`."""
        return self._controller.identity

    @property
    def max_sequence(self) -> int:
        return wire.STATES

    def begin_move(self, angles: MirrorAngles) -> None:
        """Sets one axis after the other: the beam's way is L-shaped."""
        codes = self._codes(angles)
        self._check_usable()
        with self._motion():
            self._send([wire.set_code(dac, code) for dac, code in zip(self._dacs, codes, strict=True)])
            self._arrive(angles)

    def load(self, sequence: Sequence[MirrorAngles]) -> None:
        """Uploads positions and the TTL masks that mark them. Where the controller kept other counts than were sent,
        everything is cleared and sent once more."""
        if not 1 <= len(sequence) <= wire.STATES:
            raise LimitError(DEVICE, f"a sequence of {len(sequence)} positions.", f"Load 1 to {wire.STATES} at a time.")
        codes = [self._codes(angles) for angles in sequence]
        self._check_usable()
        self._sequence = ()
        lines = [
            *wire.load_states(self._settings.x.dac, [x for x, _ in codes]),
            *wire.load_states(self._settings.y.dac, [y for _, y in codes]),
            *wire.load_masks(0, wire.marker_masks(len(codes))),
        ]
        with self._motion():
            self._upload(lines)
        self._sequence = tuple(sequence)

    def start(self) -> None:
        """Goes to the first position, waits until still, and arms: the first edge applies that position again, each
        further one the next. Until `stop` nothing else is sent."""
        if not self._sequence:
            raise CommandRejected(DEVICE, "no sequence is loaded.", "Call load() before each start().")
        self.move_to(self._sequence[0])
        with self._motion():
            stepping = [wire.step_states(dac, True) for dac in self._dacs]
            self._send([wire.set_mask(0, 0), *stepping, wire.step_masks(0, True)])
        self._armed = True

    def stop(self) -> None:
        """Ends stepping. The sequence is forgotten: how far it went is known to the counter, not here."""
        if not self._armed:
            return
        with self._motion():
            self._disarm()
        xs = [angles.x_rad for angles in self._sequence]
        ys = [angles.y_rad for angles in self._sequence]
        self._region = (MirrorAngles(min(xs), min(ys)), MirrorAngles(max(xs), max(ys)))
        self._target = None
        self._sequence = ()

    def look(self) -> None:
        with self._motion():
            self._controller.look()

    def park(self) -> None:
        """Centre, from any state, and still. After an error, another than `MirrorDisturbed`, this does not make the
        mirror usable again. Ranges are set again only where they are gone: setting one swings the other axis out.

        Replies that are seconds late are waited for; where none comes, the commands are sent all the same before the
        error is raised.
        """
        for left in reversed(range(_PARKINGS)):
            try:
                self._park()
                break
            except _LATE:
                if not left:
                    anew = [] if self._ranges_set else ranges(self._dacs)
                    self._controller.command_unheard([*disarm(self._dacs), *anew, *centre(self._dacs)])
                    raise
        self._sequence = ()
        self.wait_settled()

    def restore(self) -> None:
        """Also where the start-up banner was lost, or never comes: without its SD card the controller gives none."""
        with self._motion():
            if not self._controller.recover():
                self.warnings.append(f"{DEVICE} restarted, or its ranges were changed; its settings were sent again")
            self._set_up()
        self._sequence = ()
        self.wait_settled()

    def set_shutter_line(self, is_open: bool) -> None:
        """Drives the TTL output that is wired to the shutter and returns when the controller confirms. Closing goes
        past a command in flight and may be called from a signal handler. Raises `LimitError` where none is wired."""
        pin = self._settings.shutter_pin
        if pin is None:
            raise LimitError(DEVICE, "no shutter is wired to a TTL output.", "Set `shutter_pin` in the bench file.")
        group, bit = divmod(pin - 1, 8)
        with self._noticing():
            if is_open:
                self._check_known()
                self._controller.command(wire.set_mask(group, 1 << bit))
            else:
                self._controller.interject(wire.set_mask(group, 0))

    def close(self) -> None:
        self._controller.close()

    def _set_up(self) -> None:
        pin = self._settings.shutter_pin
        waves = wire.plays_waves(self.identity.firmware)
        self._send(set_up(self._dacs, None if pin is None else _group_of(pin), waves))
        self._armed, self._ranges_set = False, True
        self._arrive_at_centre()

    def _park(self) -> None:
        with self._motion():
            self._ranges_set &= self._controller.recover()
            if not self._ranges_set:
                self._set_up()
                if isinstance(self._place.lost_by, MirrorDisturbed):
                    self._place.lost_by = None
                return
            self._disarm()
            self._send(centre(self._dacs))
            self._arrive_at_centre()

    def _arrive_at_centre(self) -> None:
        x_rad, y_rad = (wire.angle_for(wire.CENTRE, axis.volts_per_degree, axis.offset_v) for axis in self._axes)
        self._region, self._target = self._anywhere, None
        self._arrive(MirrorAngles(x_rad, y_rad))

    def _disarm(self) -> None:
        self._send(disarm(self._dacs))
        self._armed = False

    def _send(self, commands: Sequence[bytes]) -> None:
        for command in commands:
            self._controller.command(command)

    def _upload(self, lines: Sequence[tuple[bytes, bytes]]) -> None:
        for _ in range(2):
            self._send([*(wire.clear_states(dac) for dac in self._dacs), wire.clear_masks(0)])
            if self._controller.upload(lines):
                return
            repeated(DEVICE, "it kept another part of a sequence than was sent")
        raise ProtocolError(DEVICE, "twice it kept another part of the sequence than was sent.", REOPEN)

    def _codes(self, angles: MirrorAngles) -> tuple[int, int]:
        self._settings.check_allowed(angles)
        x_code, y_code = (
            partial(wire.code_for, volts_per_degree=a.volts_per_degree, offset_v=a.offset_v) for a in self._axes
        )
        return axis_codes(DEVICE, angles, self._settings.max_mechanical_deg, x_code, y_code)

    def _check_known(self) -> None:
        self._place.check_known()
        self.check_trusted()

    @property
    def shows_that_it_moves(self) -> bool:
        """Whether its banner came, which a board without SD card does not give."""
        return self._controller.gave_banner

    def trust(self) -> None:
        """Somebody has seen it move."""
        self._seen_to_move = True

    @contextlib.contextmanager
    def trusted_for_trial(self) -> Iterator[None]:
        """Trusted within this block, for the small moves that show it."""
        before, self._seen_to_move = self._seen_to_move, True
        try:
            yield
        finally:
            self._seen_to_move = before

    def check_trusted(self) -> None:
        """Raises `DeviceFault` where nothing shows that it moves."""
        if not self._controller.gave_banner and not self._seen_to_move:
            raise DeviceFault(
                DEVICE,
                "it gave no start-up banner: without its SD card it confirms every move and makes none.",
                "Check the SD card and switch the controller off and on; or see it move with `nlos jog`, whose first "
                "moves are small, then set `allow_unverified_dac: true`.",
            )

    def _check_usable(self) -> None:
        self._check_known()
        if self._armed:
            raise CommandRejected(DEVICE, "the mirror is armed for stepping by trigger.", "Call stop() first.")

    @contextlib.contextmanager
    def _motion(self) -> Iterator[None]:
        """A motion of the mirror."""
        with self._noticing(), self._place.motion():
            yield

    @contextlib.contextmanager
    def _noticing(self) -> Iterator[None]:
        """A controller that was restarted or disturbed may have other ranges, and points elsewhere."""
        try:
            yield
        except (DeviceReset, MirrorDisturbed) as error:
            self._ranges_set = False
            self._place.lost_by = self._place.lost_by or error
            raise


def _group_of(pin: int) -> int:
    """Eight TTL outputs are set at a time."""
    return (pin - 1) // 8
