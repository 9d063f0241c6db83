"""What a Swabian Time Tagger brings with it."""

from nlos.drivers.device_model import DeviceModel
from nlos.drivers.errors import DeviceNotFound
from nlos.drivers.presence import Presence
from nlos.drivers.simulated.timetagger.faults import FAULTS
from nlos.drivers.simulated.timetagger.package import TimeTaggerPackage
from nlos.drivers.tcspc.counter import HistogramCounter
from nlos.drivers.tcspc.timetagger.counter import TimeTagger
from nlos.drivers.tcspc.timetagger.settings import TimeTaggerSettings
from nlos.drivers.tcspc.timetagger.tagger import load_package


def _look_for(settings: TimeTaggerSettings) -> Presence:
    """The package sees instruments that no program holds, without opening them."""
    try:
        serials = list(load_package(settings.model).scanTimeTagger())
    except DeviceNotFound as error:
        return Presence(False, error.what, error.remedy)
    if not serials:
        return Presence(False, "no Time Tagger is plugged in", "Check cable and power; close programs that use it.")
    if settings.serial == "auto" and len(serials) > 1:
        return Presence(False, "there are several", f"Name one as `serial`: {', '.join(serials)}.")
    if settings.serial not in ("auto", *serials):
        return Presence(False, f"another one is plugged in: {', '.join(serials)}", "Correct `serial`.")
    return Presence(True, f"Time Tagger {settings.serial if settings.serial != 'auto' else serials[0]}")


TIMETAGGER: DeviceModel[HistogramCounter] = DeviceModel(
    settings=TimeTaggerSettings,
    open=TimeTagger.open,
    firmware=lambda settings, table: TimeTaggerPackage(table, settings),
    faults=FAULTS,
    look_for=_look_for,
)
