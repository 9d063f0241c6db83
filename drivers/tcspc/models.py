"""Every photon counter that a bench file may name: one line per model."""

from collections.abc import Callable
from typing import Annotated, Any

from pydantic import Field

from nlos.drivers.clock import Clock
from nlos.drivers.link.usbtmc import WireLog
from nlos.drivers.tcspc.counter import HistogramCounter
from nlos.drivers.tcspc.picoquant.counter import open_picoquant
from nlos.drivers.tcspc.picoquant.families import PicoquantSettings
from nlos.drivers.tcspc.tcspc488.histogram import Tcspc488
from nlos.drivers.tcspc.tcspc488.settings import Tcspc488Settings

CounterSettings = Annotated[Tcspc488Settings | PicoquantSettings, Field(discriminator="model")]
_OPEN: dict[str, Callable[[Any, Clock, Any, WireLog | None], HistogramCounter]] = {
    "tcspc488": Tcspc488.open,
    "picoquant": open_picoquant,
}


def open_counter(
    settings: CounterSettings, clock: Clock, backend: Any = None, wire_log: WireLog | None = None
) -> HistogramCounter:
    """The counter that a bench file's `counter` block names, opened and configured. Raises `DeviceError`.

    `backend` replaces libusb or the vendor's library: the simulated bench's, or None for the real one.
    """
    return _OPEN[settings.model](settings, clock, backend, wire_log)
