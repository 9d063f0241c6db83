"""What an Optotune mirror brings with it."""

from nlos.drivers.device_model import DeviceModel
from nlos.drivers.galvo.mirror import GalvoMirror
from nlos.drivers.galvo.optotune.mirror import Optotune
from nlos.drivers.galvo.optotune.settings import OptotuneSettings
from nlos.drivers.presence import port_presence
from nlos.drivers.simulated.optotune.faults import FAULTS
from nlos.drivers.simulated.optotune.firmware import OptotuneFirmware

OPTOTUNE: DeviceModel[GalvoMirror] = DeviceModel(
    settings=OptotuneSettings,
    open=lambda settings, clock, backend, wire_log: Optotune.open(settings, clock, wire_log),
    firmware=lambda settings, table: OptotuneFirmware.matching(table.bench, settings),
    faults=FAULTS,
    look_for=lambda settings: port_presence(settings.port, settings.udev_rule),
)
