"""What of a bench has been opened so far, and the order in which it is closed: light, gate, mirror, links."""

import logging
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial

from nlos.drivers.clock import Clock
from nlos.drivers.errors import DeviceError, DeviceLost
from nlos.drivers.events import EventLog
from nlos.drivers.galvo.mirror import GalvoMirror
from nlos.drivers.safety import GuardedShutter
from nlos.drivers.tcspc.counter import HistogramCounter

_log = logging.getLogger(__name__)

_MORE_CLOSINGS = 4  # answers that are seconds late come within so many
_OPENINGS, _APART_S = 5, 1.0
"""How often, and how far apart, a cable that is gone is looked for: one that only slipped is back within seconds."""


class Closing:
    """Filled in as a bench is opened; `close` may be called at any time."""

    def __init__(self, events: EventLog, clock: Clock) -> None:
        self._clock = clock
        self.counter: HistogramCounter | None = None
        self.mirror: GalvoMirror | None = None
        self.shutter: GuardedShutter | None = None
        self.make_dark: Callable[[], None] | None = None
        """Opens what drives the shutter anew, shuts the light and lets go: for when its cable was lost."""
        self._events = events
        self._reason = ""
        self._error: BaseException | None = None
        self._dark = True

    @contextmanager
    def on_error(self) -> Iterator[None]:
        """Remembers why the bench is left, for the event log."""
        try:
            yield
        except BaseException as error:
            self._error = error
            self._reason = f"{type(error).__name__} {error}".strip()
            raise

    def may_be_lit(self) -> bool:
        """Whether the shutter may be open."""
        return self.shutter is not None and self.shutter.may_be_open

    def shut_light(self, why: str) -> None:
        """Within a signal handler: closes the shutter, and leaves what was reported to be written down later."""
        self._events.deferred = True
        try:
            self._events.report("signal", why)
            if self.shutter is not None:
                self.shutter.hold(why)
        except DeviceError:
            pass  # reported; the way out tries again
        finally:
            self._events.deferred = False

    def close(self) -> None:
        """Light, gate, mirror, links. A failure, of whatever kind, stops none of the later steps, nor that the light is
        tried again. The first is raised at the end, or noted on the exception that is already on its way."""
        failures: list[Exception] = []
        with ExitStack() as later:  # runs what it holds from last to first, come what may
            if self.shutter is not None:
                later.callback(self.shutter.no_longer_watched)
            later.callback(self._events.deliver)
            if self.counter is not None:
                later.callback(self._done, failures, self.counter.close)
            if self.mirror is not None:
                later.callback(self._done, failures, self.mirror.close)
                later.callback(self._park, failures, self.mirror)
            if self.counter is not None:
                later.callback(self._done, failures, self.counter.abort)
            if self.shutter is not None:
                self._dark = False
                self._dark = self._shut(failures, self.shutter)
        if failures and self._error is None:
            raise failures[0]
        if self._error is not None:
            for said in dict.fromkeys(map(str, failures)):  # a cable that is gone fails every step in the same words
                if said != str(self._error):
                    self._error.add_note(said)

    def _shut(self, failures: list[Exception], shutter: GuardedShutter) -> bool:
        """Whether it is dark. A cable that is lost, and a failure of who is told, take nothing back that was
        confirmed before."""
        if self._done(failures, partial(shutter.close_for_good, self._reason)):
            return True
        lost = isinstance(failures[-1], DeviceLost)
        if shutter.confirmed_closed and (lost or not isinstance(failures[-1], DeviceError)):
            return True
        _log.critical("THE LASER SHUTTER IS NOT CONFIRMED CLOSED (%s). Shut the laser off.", failures[-1])
        if lost:
            return shutter.outlast_watchdog(self._clock) or self._shut_anew()
        return any(self._done(failures, partial(shutter.close, self._reason)) for _ in range(_MORE_CLOSINGS))

    def _shut_anew(self) -> bool:
        """Whether it is dark because the cable came back, as one does that only slipped."""
        if self.make_dark is None or self.mirror is None:
            return False
        self.mirror.close()  # the name of its port is free again
        for attempt in range(_OPENINGS):
            if attempt:
                self._clock.sleep(_APART_S)
            with suppress(Exception):
                self.make_dark()
                _log.critical("The laser shutter is closed: its controller answers again.")
                self._events.report("shutter", "closed: its controller answers again")
                return True
        return False

    def _park(self, failures: list[Exception], mirror: GalvoMirror) -> None:
        if self._dark:
            self._done(failures, mirror.park)
        else:
            self._events.report("warning", "not parked: the shutter is not confirmed closed")

    def _done(self, failures: list[Exception], step: Callable[[], object]) -> bool:
        try:
            step()
        except Exception as error:  # memory that ran out, say: the light is a device's business all the same
            known = str(error) in map(str, failures)
            failures.append(error)
            with suppress(Exception):  # whoever is told of it may be what failed
                if not known:
                    self._events.report("device", str(error))
            return False
        return True
