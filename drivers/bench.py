"""Everything on the optical table: opened together, the light shut first whatever happens, and closed in order."""

import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from threading import Lock

from nlos.drivers.arming import Agree, Arming
from nlos.drivers.bench_settings import BenchSettings
from nlos.drivers.clock import Clock, SystemClock
from nlos.drivers.closing import Closing
from nlos.drivers.device_model import WireLog
from nlos.drivers.errors import BenchClosed
from nlos.drivers.events import EventLog, OnEvent
from nlos.drivers.exit_paths import ExitPaths, whole
from nlos.drivers.galvo.known_mirrors import MIRRORS, open_mirror
from nlos.drivers.galvo.mirror import GalvoMirror, MirrorAngles
from nlos.drivers.identity import DeviceIdentity
from nlos.drivers.safety import GuardedShutter
from nlos.drivers.shutter import LaserShutter, NoShutter
from nlos.drivers.silence import COROUTINES, Silence, heard_by, takes_turns
from nlos.drivers.simulated.bench import SimulatedBench
from nlos.drivers.simulated.recorded import RecordedScan
from nlos.drivers.tcspc.counter import HistogramCounter
from nlos.drivers.tcspc.known_counters import COUNTERS, open_counter
from nlos.drivers.trip_latch import TripLatch

__all__ = ["Bench", "BenchSettings", "WireLog", "open_bench"]
_log = logging.getLogger(__name__)


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
        self.scanning = Lock()
        """Held by the scan that a Python program runs."""
        self.while_waiting: Callable[[], None] = lambda: None
        """Called every 10 ms while points are waited for; what it raises ends the wait."""
        counter.meanwhile(self._look)

    def _look(self) -> None:
        self.shutter.heard()
        self.mirror.look()
        self.while_waiting()

    def check_open(self) -> None:
        """Raises `BenchClosed`: a scan outlives the `with` block of its bench, or comes after it."""
        if self.closed:
            raise BenchClosed("bench", f"{self.settings.name} was closed: the `with` block that opened it is over.")

    def announce(self, numbers: Sequence[int], places: Sequence[MirrorAngles] = ()) -> None:
        """Tells a simulated bench which points of a plan are armed next: their photons follow from their numbers, which
        few counters can stamp, and where they are, if a mirror may miss steps. A real bench is told nothing."""
        if self.simulated is not None:
            self.simulated.turns.announce(numbers, places)

    def scene_goes_on(self, since_lit_s: float) -> None:
        """Tells a simulated bench how long ago the first point of the scan was lit that is resumed now: what is in its
        scene has moved on. A real scene knows."""
        if self.simulated is not None:
            self.simulated.first_lit(self.clock.now() - since_lit_s)

    @property
    def identities(self) -> tuple[DeviceIdentity, ...]:
        """Who mirror and counter said they are when they were opened."""
        return (self.mirror.identity, self.counter.identity)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a person should know of this bench before a scan, and the recording keep."""
        own = []
        if self.settings.shutter.model == "none":
            own.append("this bench has no shutter: nothing here can shut off the light")
        elif not self.shutter.has_watchdog:
            own.append("no watchdog: if the computer freezes or kills this program, the shutter stays open")
        if self.settings.safety.dry_run:
            stays = "the shutter stays closed" if self.settings.shutter_on != "nothing" else (
                "there is no shutter that it could keep closed, switch the laser off by hand")  # fmt: skip
            own.append(f"dry run: {stays}")
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
    agree: Agree | None = None,
) -> Iterator[Bench]:
    """Opens counter and mirror, first the one that drives the shutter: it is closed, and read back, before anything
    moves.

    However the block is left - normally, by an exception, a signal, or the end of the interpreter - the shutter closes
    first, then the counter stops, the mirror parks and the links close. `scene` replaces a simulated bench's surfaces
    by a recorded scan. `latch`: where trips outlast this program. `agree` asks somebody where the bench file's `arm`
    wants it. Signals are caught where this is entered in the main thread. Raises `DeviceError`, with the shutter closed
    where what drives it answers.
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
        silence = None if settings.shutter_on == "nothing" else Silence(clock, settings.safety.watchdog_s)
        log = heard_by(silence, wire_log)
        closing = Closing(events, clock)
        paths = stack.enter_context(ExitPaths(closing.shut_light, closing.close, closing.may_be_lit))
        with closing.on_error():
            inner: LaserShutter = NoShutter()
            # What drives the shutter comes first and makes it dark: the other one may hang, crash or be cut short.
            if settings.shutter_on == "mirror":
                with whole(True):
                    mirror = closing.mirror = open_mirror(settings.mirror, clock, log, mirror_end)
                inner = MIRRORS[settings.mirror.model].shutters[settings.shutter.model].of(mirror)
                closing.make_dark = lambda: open_mirror(settings.mirror, clock, log, mirror_end).close()
            with whole(settings.shutter_on == "counter"):
                counter = closing.counter = open_counter(settings.counter, clock, counter_end, log)
                if settings.shutter_on == "counter":
                    inner = COUNTERS[settings.counter.model].shutters[settings.shutter.model].of(counter)
                    inner.close()
            if settings.shutter_on != "mirror":
                mirror = closing.mirror = open_mirror(settings.mirror, clock, log, mirror_end)
            arming = None if settings.arming is None else Arming(settings.arming, clock, events, agree)
            shutter = closing.shutter = GuardedShutter(inner, counter, settings.safety, events, latch, arming)
            shutter.before_light = partial(_tell_of_handlers, paths, events)
            shutter.listen(silence)
            shutter.close()
            bench = Bench(settings, mirror, counter, shutter, clock, events, simulated)
            stack.callback(setattr, bench, "closed", True)
            # Of coroutines the shutter itself tells who looks on, as light comes, on a bench in part as well.
            coroutines = [COROUTINES] if silence is not None and not shutter.has_watchdog and takes_turns() else []
            for warning in (*bench.warnings, *coroutines):
                events.report("warning", warning)
            yield bench


def _tell_of_handlers(paths: ExitPaths, events: EventLog) -> None:
    """Says which signals no longer shut the light, once each: a scan of another program's may be paused by them."""
    if names := paths.newly_taken_over():
        said = (
            f"{names} no longer shuts the light: this program has set another handler since the bench was opened. Open "
            "the bench after that handler is set."
        )
        _log.warning(said)
        events.report("warning", said)
