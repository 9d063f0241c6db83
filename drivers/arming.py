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

_LOOK_S, _SLEPT_S = 0.1, 1.0
"""Where a look takes so long the program was stopped meanwhile, or the computer slept: the warning is given anew."""

Agree = Callable[[str], bool]
"""A question to somebody at the terminal -> whether they typed the word."""


class Arming:
    """`agree` as soon as light is known to be wanted, `warn` right before it; each does all it does once."""

    def __init__(self, settings: ArmSettings, clock: Clock, events: EventLog, agree: Agree | None = None) -> None:
        self._settings, self._clock, self._events, self._agree = settings, clock, events, agree
        self._agreed, self._warned = False, not settings.delay_s

    @property
    def armed(self) -> bool:
        """Whether nothing is left to do."""
        return self._agreed and self._warned

    def agree(self) -> None:
        """Raises `LimitError` where this terminal is not at the bench and the bench file does not allow that, and where
        nobody agrees."""
        if self._agreed:
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
        self._agreed = True
        self._events.report("shutter", f"armed by {_user()}, {where or 'at the bench'}")

    def warn(self, broken_off: Callable[[], object]) -> None:
        """Announces light and returns when it is time for it; earlier, and with nothing settled, once `broken_off`."""
        if self._warned or broken_off():
            return
        until_s = self._announced()
        while (left_s := until_s - (now_s := self._clock.now())) > 0:
            if broken_off():
                self._events.report("shutter", "no light: its warning time was broken off")
                return
            self._clock.sleep(min(left_s, _LOOK_S))
            if self._clock.now() - now_s > _SLEPT_S:  # nobody could heed it
                until_s = self._announced()
        self._warned = True

    def _announced(self) -> float:
        """When it is time for light, which is said."""
        _log.warning("light in %g s", self._settings.delay_s)
        self._events.report("shutter", f"light in {self._settings.delay_s:g} s")
        return self._clock.now() + self._settings.delay_s


def _user() -> str:
    try:
        return getpass.getuser()
    except (OSError, KeyError, ImportError):  # a user without a name
        return "an unnamed user"
