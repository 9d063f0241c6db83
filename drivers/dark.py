"""Closes a bench's laser shutter with nothing but the instrument that drives it."""

from nlos.drivers.bench_settings import BenchSettings
from nlos.drivers.clock import Clock, SystemClock
from nlos.drivers.errors import LimitError
from nlos.drivers.galvo.models import open_mirror
from nlos.drivers.tcspc.models import open_counter
from nlos.drivers.tcspc.tcspc488.histogram import Tcspc488
from nlos.drivers.tcspc.tcspc488.shutter import Tcspc488Shutter


def make_dark(settings: BenchSettings) -> None:
    """Raises `DeviceError` where the light is not confirmed off, `LimitError` where the bench has no shutter."""
    if settings.shutter.model == "none":
        raise LimitError("shutter", f"bench {settings.name} has none.", "Switch the laser off by hand.")
    if not settings.simulated:
        _close(settings, SystemClock(), None)
        return
    from nlos.drivers.simulated.instruments import plug_in

    with plug_in(settings) as plugged:
        _close(settings, plugged.bench.clock, plugged.backend)


def _close(settings: BenchSettings, clock: Clock, backend: object) -> None:
    if settings.shutter.model == "triggerscope_ttl":
        open_mirror(settings.mirror, clock).close()  # closes the shutter before anything else
        return
    counter = open_counter(settings.counter, clock, backend=backend)
    try:
        if isinstance(counter, Tcspc488):
            Tcspc488Shutter(counter).close()
    finally:
        counter.close()
