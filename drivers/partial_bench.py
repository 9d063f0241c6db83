"""The instruments of a bench that are there: aiming by hand is of use with one of them alone."""

from collections.abc import Callable, Iterator, Set
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from typing import Any, TypeVar

from nlos.drivers.arming import Agree, Arming
from nlos.drivers.bench_settings import BenchSettings
from nlos.drivers.clock import Clock, RealTimeClock, SystemClock
from nlos.drivers.closing import Closing
from nlos.drivers.device_model import WireLog
from nlos.drivers.errors import DeviceError, LimitError
from nlos.drivers.events import EventLog
from nlos.drivers.exit_paths import ExitPaths, whole
from nlos.drivers.galvo.known_mirrors import MIRRORS, open_mirror
from nlos.drivers.galvo.mirror import GalvoMirror
from nlos.drivers.safety import GuardedShutter
from nlos.drivers.shutter import LaserShutter, NoShutter
from nlos.drivers.silence import Silence, heard_by
from nlos.drivers.simulated.bench import SimulatedBench
from nlos.drivers.tcspc.counter import HistogramCounter
from nlos.drivers.tcspc.known_counters import COUNTERS, open_counter
from nlos.drivers.trip_latch import TripLatch

Device = TypeVar("Device")


@dataclass
class PartialBench:
    """What answered. `absent`: role -> why it is not here. Without `shutter` there is no light to be had."""

    settings: BenchSettings
    clock: Clock
    events: EventLog
    mirror: GalvoMirror | None = None
    counter: HistogramCounter | None = None
    shutter: GuardedShutter | None = None
    simulated: SimulatedBench | None = None
    absent: dict[str, DeviceError] = field(default_factory=dict)


@contextmanager
def open_partial_bench(
    settings: BenchSettings,
    wanted: Set[str],
    *,
    light_elsewhere: bool = False,
    wire_log: WireLog | None = None,
    latch: TripLatch | None = None,
    agree: Agree | None = None,
) -> Iterator[PartialBench]:
    """Opens what is `wanted` of mirror and counter, and what drives the shutter, each as far as it is there.

    As `open_bench`: the shutter is closed before anything moves, and first on every way out; a simulated bench keeps
    the computer's time. A mirror is not opened, which moves it, where nobody knows whether there is light: that is a
    `LimitError` unless `light_elsewhere`, a person's word. Raises the first `DeviceError` where nothing answers.
    """
    with ExitStack() as stack:
        events = EventLog()
        clock: Clock = SystemClock()
        simulated = counter_end = mirror_end = None
        if settings.simulated:
            from nlos.drivers.simulated.instruments import plug_in

            plugged = stack.enter_context(plug_in(settings, clock=RealTimeClock()))
            simulated, counter_end, mirror_end = plugged.bench, plugged.counter, plugged.mirror
            clock = simulated.clock
        silence = None if settings.shutter_on == "nothing" else Silence(clock, settings.safety.watchdog_s)
        log = heard_by(silence, wire_log)
        closing = Closing(events, clock)
        stack.enter_context(ExitPaths(closing.shut_light, closing.close, closing.may_be_lit))
        with closing.on_error():
            bench = PartialBench(settings, clock, events, simulated=simulated)
            inner: LaserShutter | None = NoShutter() if settings.shutter_on == "nothing" else None
            if inner is not None and not light_elsewhere and "mirror" in wanted:
                raise _light_unknown("this bench has no shutter")
            # What drives the shutter comes first and makes it dark: the other one may hang, crash or be cut short.
            if settings.shutter_on == "mirror":
                with whole(True):
                    inner = _open_mirror(bench, closing, mirror_end, log)
                if bench.mirror is not None:
                    closing.make_dark = lambda: open_mirror(settings.mirror, clock, log, mirror_end).close()
            if "counter" in wanted or settings.shutter_on == "counter":
                with whole(settings.shutter_on == "counter"):
                    inner = _open_counter(bench, closing, counter_end, log) or inner
            if "mirror" in wanted and settings.shutter_on == "counter" and inner is None and not light_elsewhere:
                raise _light_unknown(f"the counter that drives the shutter does not answer ({bench.absent['counter']})")
            if "mirror" in wanted and settings.shutter_on != "mirror":
                _open_mirror(bench, closing, mirror_end, log)
            if bench.mirror is None and bench.counter is None:
                raise next(iter(bench.absent.values()))
            if inner is not None:
                arming = None if settings.arming is None else Arming(settings.arming, clock, events, agree)
                guarded = GuardedShutter(inner, bench.counter, settings.safety, events, latch, arming)
                guarded.listen(silence)
                bench.shutter = closing.shutter = guarded
                guarded.close()
            yield bench


def _light_unknown(why: str) -> LimitError:
    return LimitError(
        "shutter",
        f"{why}, so nobody knows whether there is light while the mirror moves.",
        "Use --no-shutter if something else keeps it off, or safe.",
    )


def _opened(bench: PartialBench, role: str, open_device: Callable[[], Device]) -> Device | None:
    """The instrument, or a note of why it is absent."""
    try:
        return open_device()
    except DeviceError as error:
        bench.absent[role] = error
        return None


def _open_counter(bench: PartialBench, closing: Closing, backend: Any, log: WireLog | None) -> LaserShutter | None:
    """The counter, and the closed shutter that hangs on it."""
    block, word = bench.settings.counter, bench.settings.shutter.model
    bench.counter = closing.counter = _opened(bench, "counter", lambda: open_counter(block, bench.clock, backend, log))
    if bench.counter is None or bench.settings.shutter_on != "counter":
        return None
    shutter = COUNTERS[block.model].shutters[word].of(bench.counter)
    shutter.close()
    return shutter


def _open_mirror(bench: PartialBench, closing: Closing, backend: Any, log: WireLog | None) -> LaserShutter | None:
    """The mirror, whose controller closes the shutter first where that hangs on it."""
    block, word = bench.settings.mirror, bench.settings.shutter.model
    bench.mirror = closing.mirror = _opened(bench, "mirror", lambda: open_mirror(block, bench.clock, log, backend))
    if bench.mirror is None or bench.settings.shutter_on != "mirror":
        return None
    return MIRRORS[block.model].shutters[word].of(bench.mirror)
