"""Opens a `tcspc488` in the mode that the bench file says: histograms made by the instrument, or list mode."""

from typing import Any

from nlos.drivers.clock import Clock
from nlos.drivers.errors import LimitError
from nlos.drivers.link.usbtmc import WireLog
from nlos.drivers.tcspc.tcspc488.histogram import Tcspc488
from nlos.drivers.tcspc.tcspc488.instrument import Instrument
from nlos.drivers.tcspc.tcspc488.settings import Tcspc488Settings
from nlos.drivers.tcspc.tcspc488.t3 import Tcspc488T3


def open_tcspc488(
    settings: Tcspc488Settings, clock: Clock, backend: Any = None, wire_log: WireLog | None = None
) -> Tcspc488:
    """Finds, opens, clears and configures the instrument; nothing is armed, its shutter output is
    told to close first of all.

    Raises `DeviceNotFound`, `DeviceBusy`, `WrongDevice` or what the link meets.
    """
    if settings.simulated and backend is None:
        raise LimitError(settings.model, "usb: simulated needs the simulated bench.", "Open it by its bench file.")
    kind = Tcspc488T3 if settings.mode == "t3" else Tcspc488
    return kind(settings, Instrument(settings, clock, backend, wire_log))
