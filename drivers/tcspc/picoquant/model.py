"""What a PicoQuant counter brings with it."""

from nlos.drivers.clock import SystemClock
from nlos.drivers.device_model import DeviceModel
from nlos.drivers.errors import DeviceError
from nlos.drivers.presence import Presence
from nlos.drivers.simulated.picoquant.faults import FAULTS
from nlos.drivers.simulated.picoquant.library import PicoquantLibrary
from nlos.drivers.simulated.table import SimulatedTable
from nlos.drivers.tcspc.counter import HistogramCounter
from nlos.drivers.tcspc.picoquant.counter import open_picoquant
from nlos.drivers.tcspc.picoquant.families import FAMILIES, PicoquantSettings
from nlos.drivers.tcspc.picoquant.library import VendorLibrary, load_library


def _look_for(settings: PicoquantSettings) -> Presence:
    """The instrument is behind its library: whether that loads, and is one that this adapter is written for, is all
    that can be seen without opening it."""
    family = FAMILIES[settings.device]
    try:
        functions = load_library(settings.model, family, settings.library)
        VendorLibrary(settings.model, family, functions, SystemClock())
    except DeviceError as error:
        return Presence(False, error.what, error.remedy)
    return Presence(True, f"the library of the {family.product} loads; `nlos doctor` asks who answers")


def _library(settings: PicoquantSettings, table: SimulatedTable) -> PicoquantLibrary:
    return PicoquantLibrary(table.bench, settings.device, table.repetition_hz, table.simulation.seed)


PICOQUANT: DeviceModel[HistogramCounter] = DeviceModel(
    settings=PicoquantSettings, open=open_picoquant, firmware=_library, look_for=_look_for, faults=FAULTS
)
