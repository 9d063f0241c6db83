"""What happens before the first light of a command: is this terminal at the bench, does somebody agree, a warning."""

import getpass
import logging
from collections.abc import Callable

from nlos.drivers.arm_settings import ArmSettings
from nlos.drivers.clock import Clock
from nlos.drivers.errors import LimitError
from nlos.drivers.events import EventLog
from nlos.drivers.terminal_place import remote_terminal

_log = logging.getLogger(__name__)

Agree = Callable[[str], bool]
"""A question to somebody at the terminal -> whether they typed the word."""


class Arming:
    """`arm` is called before light; it does everything once, then nothing."""

    def __init__(self, settings: ArmSettings, clock: Clock, events: EventLog, agree: Agree | None = None) -> None:
        self._settings, self._clock, self._events, self._agree = settings, clock, events, agree
        self.armed = False

    def arm(self) -> None:
        """Raises `LimitError` where this terminal is not at the bench and the bench file does not allow that, and where
        nobody agrees. Returns after the warning time."""
        if self.armed:
            return
        where = remote_terminal()
        if where is not None and not self._settings.remote:
            raise LimitError(
                "shutter",
                f"stays closed: this terminal is not at the bench ({where}).",
                "Start it at the bench, or set `arm: {remote: true}` in the bench file if the room may have light "
                "that nobody in it asked for.",
            )
        if self._settings.confirm and not (self._agree and self._agree("The laser's light comes on.")):
            raise LimitError("shutter", "stays closed: no one agreed to light.", "Say so at a terminal when asked.")
        if self._settings.delay_s:
            _log.warning("light in %g s", self._settings.delay_s)
            self._events.report("shutter", f"light in {self._settings.delay_s:g} s")
            self._clock.sleep(self._settings.delay_s)
        self.armed = True
        self._events.report("shutter", f"armed by {_user()}, {where or 'at the bench'}")


def _user() -> str:
    try:
        return getpass.getuser()
    except (OSError, KeyError, ImportError):  # a user without a name
        return "an unnamed user"
