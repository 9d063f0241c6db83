"""PicoHarp 300, HydraHarp 400 and MultiHarp 150 by the vendor's library, in the mode that the bench file names."""

from typing import Any

from nlos.drivers.clock import Clock
from nlos.drivers.tcspc.picoquant.families import FAMILIES, PicoquantSettings
from nlos.drivers.tcspc.picoquant.histogram import Picoquant
from nlos.drivers.tcspc.picoquant.library import VendorLibrary, WireLog, load_library, open_instrument
from nlos.drivers.tcspc.picoquant.t3 import PicoquantT3


def open_picoquant(
    settings: PicoquantSettings, clock: Clock, backend: Any = None, wire_log: WireLog | None = None
) -> Picoquant:
    """Loads the library, finds the instrument and sets it up; `backend` replaces the library.

    Raises `DeviceNotFound`, `DeviceBusy`, `WrongDevice`, or what the library reports.
    """
    family = FAMILIES[settings.device]
    functions = load_library(settings.model, family, settings.library) if backend is None else backend
    library = VendorLibrary(settings.model, family, functions, clock, wire_log)
    serial = open_instrument(library, settings.serial)
    try:
        return (PicoquantT3 if settings.mode == "t3" else Picoquant)(settings, clock, library, serial)
    except BaseException:
        library.attempt("CloseDevice", library.index)
        raise
