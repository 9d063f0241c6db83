"""What a `tcspc488` brings with it."""

from nlos.drivers.device_model import DeviceModel, ShutterOutput
from nlos.drivers.errors import DeviceError
from nlos.drivers.link.usb_search import available_instruments
from nlos.drivers.presence import Presence, usb_not_searched, usb_presence
from nlos.drivers.simulated.tcspc488.faults import FAULTS
from nlos.drivers.simulated.tcspc488.firmware import Tcspc488Firmware
from nlos.drivers.tcspc.counter import HistogramCounter
from nlos.drivers.tcspc.tcspc488.counter import open_tcspc488
from nlos.drivers.tcspc.tcspc488.settings import Tcspc488Settings
from nlos.drivers.tcspc.tcspc488.shutter import Tcspc488Shutter


def _look_for(settings: Tcspc488Settings) -> Presence:
    try:
        found = available_instruments()
    except DeviceError as error:
        return usb_not_searched(error)
    return usb_presence((settings.vendor_id, settings.product_id), settings.usb, settings.udev_rule, found)


TCSPC488: DeviceModel[HistogramCounter] = DeviceModel(
    settings=Tcspc488Settings,
    open=open_tcspc488,
    firmware=lambda settings, table: Tcspc488Firmware(table.bench),
    faults=FAULTS,
    look_for=_look_for,
    shutters={"tcspc488": ShutterOutput(Tcspc488Shutter)},
)
