"""Closes a bench's laser shutter with nothing but the instrument that drives it."""

from nlos.drivers.bench_settings import BenchSettings, LightSettings
from nlos.drivers.clock import Clock, SystemClock
from nlos.drivers.device_model import WireLog
from nlos.drivers.errors import DeviceError, LimitError
from nlos.drivers.galvo.known_mirrors import open_mirror
from nlos.drivers.tcspc.known_counters import COUNTERS, open_counter


def make_dark(settings: BenchSettings | LightSettings, wire_log: WireLog | None = None) -> None:
    """Of a bench file that is not valid its `LightSettings` do, for real instruments.

    Raises `DeviceError` where the light is not confirmed off, `LimitError` where the bench has no shutter."""
    if settings.shutter_on == "nothing":
        raise LimitError("shutter", "this bench has none.", "Switch the laser off by hand.")
    try:
        if isinstance(settings, LightSettings) or not settings.simulated:
            _close(settings, SystemClock(), None, None, wire_log)
            return
        from nlos.drivers.simulated.instruments import plug_in

        with plug_in(settings) as plugged:
            _close(settings, plugged.bench.clock, plugged.counter, plugged.mirror, wire_log)
    except DeviceError as error:
        error.say(
            f"the laser shutter is NOT CONFIRMED CLOSED: {error.what}", f"Switch the laser off by hand. {error.remedy}"
        )
        raise


def _close(
    settings: BenchSettings | LightSettings,
    clock: Clock,
    counter_end: object,
    mirror_end: object,
    wire_log: WireLog | None,
) -> None:
    if settings.shutter_on == "mirror":
        open_mirror(settings.mirror, clock, wire_log, mirror_end).close()  # closes the shutter before anything else
        return
    counter = open_counter(settings.counter, clock, counter_end, wire_log)
    try:
        COUNTERS[settings.counter.model].shutters[settings.shutter.model].of(counter).close()
    finally:
        counter.close()
