"""What a Helios laser DAC brings with it. No shutter: its pin outlives a stop."""

from nlos.drivers.device_model import DeviceModel
from nlos.drivers.errors import DeviceError
from nlos.drivers.galvo.helios.mirror import Helios
from nlos.drivers.galvo.helios.settings import PRODUCT_ID, VENDOR_ID, HeliosSettings
from nlos.drivers.galvo.mirror import GalvoMirror
from nlos.drivers.link.usb_search import find_usb
from nlos.drivers.presence import Presence
from nlos.drivers.simulated.helios.faults import FAULTS
from nlos.drivers.simulated.helios.firmware import HeliosFirmware
from nlos.drivers.simulated.table import SimulatedTable
from nlos.drivers.simulated.usb.pipes import SimulatedPipes


def _look_for(settings: HeliosSettings) -> Presence:
    try:
        find_usb(settings.model, VENDOR_ID, PRODUCT_ID, None)
    except DeviceError as error:
        return Presence(False, error.what, error.remedy)
    return Presence(True, "a Helios laser DAC; `nlos doctor` asks who answers")


def _backend(settings: HeliosSettings, table: SimulatedTable) -> SimulatedPipes:
    return SimulatedPipes(HeliosFirmware(table.bench, settings), table.bench, table.simulation.usb_latency_ms * 1e-3)


HELIOS: DeviceModel[GalvoMirror] = DeviceModel(
    settings=HeliosSettings, open=Helios.open, firmware=_backend, look_for=_look_for, faults=FAULTS, pulled="H3"
)  # fmt: skip
