"""What is left of a bench that cannot be opened as a whole: each instrument on its own, as far as that is safe."""

from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import ExitStack, closing
from typing import Any

from nlos.doctor.findings import Finding, failed, passed, skipped, warned
from nlos.doctor.instruments import counter_lines, dark_line, mirror_lines
from nlos.doctor.silence import device_of, why_silent
from nlos.drivers.bench_settings import BenchSettings
from nlos.drivers.clock import Clock, SystemClock
from nlos.drivers.errors import DeviceError
from nlos.drivers.galvo.known_mirrors import open_mirror
from nlos.drivers.light_out import make_dark
from nlos.drivers.tcspc.known_counters import open_counter


def role_of(settings: BenchSettings, error: DeviceError) -> str:
    """Whose error it is: mirror, counter, shutter, or the name that it gives itself."""
    if "shutter" in error.device:
        return "shutter"
    for role, model in (("mirror", settings.mirror.model), ("counter", settings.counter.model)):
        if error.device.startswith(model):
            return role
    return error.device


def failure(settings: BenchSettings, error: DeviceError, silent: bool = False) -> Finding:
    """The line of an instrument that failed, and where it is plugged in. `silent`: it did not even open; why is looked
    into."""
    block = device_of(settings, error)
    where = error.device if block is None else f"{error.device} at {block.address}"
    why = why_silent(block, error) if silent and block is not None else ""
    return failed(role_of(settings, error), f"{where}: {error.what}", f"{why} {error.remedy}".strip())


def apart(
    settings: BenchSettings, missing: Mapping[str, str], may_move: Callable[[str], bool] = lambda why: not why
) -> Iterator[Finding]:
    """Shutter, counter and mirror, but for the roles that are `missing`, with why. The light is off first; a mirror,
    which moves as it is opened, is opened only where `may_move`, who is told why nobody knows that it is dark."""
    dark = yield from _dark(settings)
    with ExitStack() as stack:
        clock: Clock = SystemClock()
        counter_end: Any = None
        mirror_end: Any = None
        if settings.simulated:
            from nlos.drivers.simulated.instruments import plug_in

            plugged = stack.enter_context(plug_in(settings))
            clock, counter_end, mirror_end = plugged.bench.clock, plugged.counter, plugged.mirror
        if "counter" in missing:
            yield from (skipped(what, missing["counter"]) for what in ("counter", "sync", "dark counts"))
        else:
            yield from _alone(settings, lambda: _counter(settings, clock, counter_end, dark))
        if "mirror" in missing:
            yield skipped("mirror", missing["mirror"])
        elif not may_move("" if dark else "The shutter is not confirmed closed: switch the laser off by hand first."):
            why = "nobody agreed to that" if dark else "the light is not confirmed off"
            yield skipped("mirror", f"it moves as it is opened, and {why}")
        else:
            yield from _alone(settings, lambda: _mirror(settings, clock, mirror_end))


def _dark(settings: BenchSettings) -> Generator[Finding, None, bool]:
    """Returns whether nothing forbids to move the mirror: without a shutter the light is a person's business."""
    if settings.shutter_on == "nothing":
        yield warned("shutter", "none: nothing here can shut off the light", "Wire one.")
        return True
    try:
        make_dark(settings)
    except DeviceError as error:
        what = f"not confirmed closed ({error.said})"
        yield failed("shutter", what, "Switch the laser off by hand. " + error.remedy)
        return False
    yield passed("shutter", "told to close, and confirmed")
    return True


def _alone(settings: BenchSettings, look: Callable[[], Iterator[Finding]]) -> Iterator[Finding]:
    try:
        yield from look()
    except DeviceError as error:
        yield failure(settings, error, silent=True)


def _counter(settings: BenchSettings, clock: Clock, backend: Any, dark: bool) -> Iterator[Finding]:
    with closing(open_counter(settings.counter, clock, backend=backend)) as counter:
        yield from counter_lines(counter, settings)
        if settings.shutter_on == "nothing":
            yield skipped("dark counts", "nothing here can make it dark")
            return
        yield (
            dark_line(counter.rates(), settings.with_own_first_light(counter.identity.name).first_light)
            if dark
            else skipped("dark counts", "the light is not confirmed off")
        )


def _mirror(settings: BenchSettings, clock: Clock, backend: Any) -> Iterator[Finding]:
    with closing(open_mirror(settings.mirror, clock, backend=backend)) as mirror:
        yield from mirror_lines(mirror, settings)
        mirror.park()
