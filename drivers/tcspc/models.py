"""Every photon counter that a bench file may name: one line per model."""

from collections.abc import Callable
from typing import Annotated, Any

from pydantic import Field

from drivers.clock import Clock
from drivers.link.usbtmc import WireLog
from drivers.tcspc.counter import HistogramCounter
from drivers.tcspc.picoquant import open_picoquant
from drivers.tcspc.picoquant_families import PicoquantSettings
from drivers.tcspc.tcspc488 import Tcspc488
from drivers.tcspc.tcspc488_settings import Tcspc488Settings

CounterSettings = Annotated[Tcspc488Settings | PicoquantSettings, Field(discriminator="model")]
_OPEN: dict[str, Callable[[Any, Clock, Any, WireLog | None], HistogramCounter]] = {
    "tcspc488": Tcspc488.open,
    "picoquant": open_picoquant,
}


def open_counter(
    settings: CounterSettings, clock: Clock, backend: Any = None, wire_log: WireLog | None = None
) -> HistogramCounter:
    """The counter that a bench file's `counter` block names, opened and configured. Raises `DeviceError`.

    `backend` is what stands in for libusb or the vendor's library: the simulated bench's, or None for the real one.
    """
    return _OPEN[settings.model](settings, clock, backend, wire_log)
