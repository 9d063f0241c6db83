"""Everything on the optical table: opened together, the light shut first whatever happens, and closed in order."""

import logging
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial

from nlos.drivers.bench_settings import BenchSettings
from nlos.drivers.clock import Clock, SystemClock
from nlos.drivers.device_model import WireLog
from nlos.drivers.errors import BenchClosed, DeviceError, DeviceLost
from nlos.drivers.events import EventLog, OnEvent
from nlos.drivers.exit_paths import ExitPaths
from nlos.drivers.galvo.mirror import GalvoMirror
from nlos.drivers.galvo.models import MIRRORS, open_mirror
from nlos.drivers.identity import DeviceIdentity
from nlos.drivers.safety import GuardedShutter
from nlos.drivers.shutter import LaserShutter, NoShutter
from nlos.drivers.simulated.bench import SimulatedBench
from nlos.drivers.simulated.recorded import RecordedScan
from nlos.drivers.tcspc.counter import HistogramCounter
from nlos.drivers.tcspc.models import COUNTERS, open_counter
from nlos.drivers.trip_latch import TripLatch

__all__ = ["Bench", "BenchSettings", "WireLog", "open_bench"]

_log = logging.getLogger(__name__)

_MORE_CLOSINGS = 4  # answers that are seconds late come within so many


class Bench:
    """The open bench. `warnings`: what a person should know and a recording should keep."""

    def __init__(
        self,
        settings: BenchSettings,
        mirror: GalvoMirror,
        counter: HistogramCounter,
        shutter: GuardedShutter,
        clock: Clock,
        events: EventLog,
        simulated: SimulatedBench | None = None,
    ) -> None:
        self.settings = settings
        self.mirror = mirror
        self.counter = counter
        self.shutter = shutter
        self.clock = clock
        self.simulated = simulated
        self._events = events
        self.closed = False
        self.while_waiting: Callable[[], None] = lambda: None
        """Called every 10 ms while points are waited for; what it raises ends the wait."""
        counter.meanwhile(self._look)

    def _look(self) -> None:
        self.mirror.look()
        self.while_waiting()

    def check_open(self) -> None:
        """Raises `BenchClosed`: a scan outlives the `with` block of its bench."""
        if self.closed:
            raise BenchClosed("bench", f"{self.settings.name} was closed; this scan cannot go on.")

    @property
    def identities(self) -> tuple[DeviceIdentity, ...]:
        return (self.mirror.identity, self.counter.identity)

    @property
    def warnings(self) -> tuple[str, ...]:
        own = []
        if self.settings.shutter.model == "none":
            own.append("this bench has no shutter: nothing here can shut off the light")
        elif not self.shutter.has_watchdog:
            own.append("no watchdog: if this computer hangs, the shutter stays as it is")
        if self.settings.safety.dry_run:
            own.append("dry run: the shutter stays closed")
        return (*own, *(text for device in (self.mirror, self.counter) for text in getattr(device, "warnings", ())))

    @property
    def on_event(self) -> OnEvent | None:
        """Who is told of every shutter change, trip, override and warning. What happened before waits until set."""
        return self._events.listener

    @on_event.setter
    def on_event(self, listener: OnEvent | None) -> None:
        self._events.listener = listener

    def report(self, kind: str, text: str) -> None:
        """Tells `on_event`."""
        self._events.report(kind, text)


@contextmanager
def open_bench(
    settings: BenchSettings,
    *,
    scene: RecordedScan | None = None,
    wire_log: WireLog | None = None,
    latch: TripLatch | None = None,
) -> Iterator[Bench]:
    """Opens counter, shutter and mirror, in this order: the shutter is closed, and read back, before anything moves.

    However the block is left - normally, by an exception, a signal, or the end of the interpreter - the shutter closes
    first, then the counter stops, the mirror parks and the links close. `scene` replaces a simulated bench's surfaces
    by a recorded scan. `latch`: where trips outlast this program. Signals are caught where this is entered in the main
    thread. Raises `DeviceError`, with the shutter closed where what drives it answers.
    """
    with ExitStack() as stack:
        events = EventLog()
        clock: Clock = SystemClock()
        simulated = counter_end = mirror_end = None
        if settings.simulated:
            from nlos.drivers.simulated.instruments import plug_in

            plugged = stack.enter_context(plug_in(settings, scene))
            simulated, counter_end, mirror_end = plugged.bench, plugged.counter, plugged.mirror
            clock = simulated.clock
        elif scene is not None:
            raise ValueError(f"bench {settings.name} is real; a recorded scan can only replace simulated light")
        closing = _Closing(events, clock)
        stack.enter_context(ExitPaths(closing.shut_light, closing.close))
        with closing.on_error():
            try:
                counter = closing.counter = open_counter(settings.counter, clock, counter_end, wire_log)
            except DeviceError:
                if settings.shutter_on == "mirror":  # the mirror's controller can still make it dark
                    with suppress(DeviceError):
                        open_mirror(settings.mirror, clock, wire_log, mirror_end).close()
                raise
            inner: LaserShutter = NoShutter()
            if settings.shutter_on == "counter":
                inner = COUNTERS[settings.counter.model].shutters[settings.shutter.model].of(counter)
                inner.close()
            # A mirror controller that drives the shutter closes it before it does anything else.
            mirror = closing.mirror = open_mirror(settings.mirror, clock, wire_log, mirror_end)
            if settings.shutter_on == "mirror":
                inner = MIRRORS[settings.mirror.model].shutters[settings.shutter.model].of(mirror)
            shutter = closing.shutter = GuardedShutter(inner, counter, settings.safety, events, latch)
            shutter.close()
            bench = Bench(settings, mirror, counter, shutter, clock, events, simulated)
            stack.callback(setattr, bench, "closed", True)
            for warning in bench.warnings:
                events.report("warning", warning)
            yield bench


class _Closing:
    """What has been opened so far, and the order in which it is closed."""

    def __init__(self, events: EventLog, clock: Clock) -> None:
        self._clock = clock
        self.counter: HistogramCounter | None = None
        self.mirror: GalvoMirror | None = None
        self.shutter: GuardedShutter | None = None
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
        """Light, gate, mirror, links. A failure, of whatever kind, stops none of the later steps. The first that a
        device reports is raised at the end, or noted on the exception that is already on its way."""
        failures: list[DeviceError] = []
        with ExitStack() as later:  # runs what it holds from last to first, come what may
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
        for failure in failures:
            if self._error is not None:
                self._error.add_note(str(failure))

    def _shut(self, failures: list[DeviceError], shutter: GuardedShutter) -> bool:
        """Whether it is dark. A cable that is lost takes nothing back that was confirmed before."""
        if self._done(failures, partial(shutter.close, self._reason)):
            return True
        lost = isinstance(failures[-1], DeviceLost)
        if lost and shutter.confirmed_closed:
            return True
        _log.critical("THE LASER SHUTTER IS NOT CONFIRMED CLOSED (%s). Shut the laser off.", failures[-1])
        if lost:
            return shutter.outlast_watchdog(self._clock)
        return any(self._done(failures, partial(shutter.close, self._reason)) for _ in range(_MORE_CLOSINGS))

    def _park(self, failures: list[DeviceError], mirror: GalvoMirror) -> None:
        if self._dark:
            self._done(failures, mirror.park)
        else:
            self._events.report("warning", "not parked: the shutter is not confirmed closed")

    def _done(self, failures: list[DeviceError], step: Callable[[], object]) -> bool:
        try:
            step()
        except DeviceError as error:
            self._events.report("device", str(error))
            failures.append(error)
            return False
        return True
