"""What a TriggerScope brings with it."""

from nlos.drivers.device_model import DeviceModel, ShutterOutput
from nlos.drivers.galvo.mirror import GalvoMirror
from nlos.drivers.galvo.triggerscope.mirror import TriggerScope
from nlos.drivers.galvo.triggerscope.settings import TriggerScopeSettings
from nlos.drivers.presence import port_presence
from nlos.drivers.shutter import TtlShutter
from nlos.drivers.simulated.triggerscope.faults import FAULTS
from nlos.drivers.simulated.triggerscope.firmware import TriggerScopeFirmware

TRIGGERSCOPE: DeviceModel[GalvoMirror] = DeviceModel(
    settings=TriggerScopeSettings,
    open=lambda settings, clock, backend, wire_log: TriggerScope.open(settings, clock, wire_log),
    firmware=lambda settings, table: TriggerScopeFirmware.matching(
        table.bench, settings, table.simulation.misalignment
    ),
    faults=FAULTS,
    look_for=lambda settings: port_presence(settings.port, settings.udev_rule),
    shutters={"triggerscope_ttl": ShutterOutput(TtlShutter, needs="shutter_pin")},
)
