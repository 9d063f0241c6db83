"""What is plugged in that could be a bench's mirror controller or counter: the answers that questions begin with."""

import re
from dataclasses import dataclass
from pathlib import Path

from pydantic import ValidationError

from nlos.drivers.device_settings import DeviceSettings
from nlos.drivers.galvo.known_mirrors import MIRRORS
from nlos.drivers.link.same_device import PortInfo
from nlos.drivers.link.serial_line import available_ports
from nlos.drivers.tcspc.known_counters import COUNTERS

_SERIAL = Path("/dev/serial")


@dataclass(frozen=True)
class Detected:
    """Models that are there, by word, and serial ports by the name that stays the same from day to day."""

    mirrors: tuple[str, ...]
    counters: tuple[str, ...]
    ports: tuple[str, ...]


def detect() -> Detected:
    """Looks without opening anything: a serial port says that it is there, not who is behind it."""
    ports = tuple(sorted((_lasting(each) for each in available_ports()), key=_built_in))
    mirrors = [word for word, model in MIRRORS.items() if model.settings.cable != "serial" and _there(model.settings)]
    counters = [word for word, model in COUNTERS.items() if _there(model.settings)]
    return Detected(tuple(mirrors), tuple(counters), ports)


def _lasting(port: PortInfo) -> str:
    """The same port by a name that does not depend on the order of plugging in, where the system has one: by the
    adapter's serial number, or of one that has none by its socket, for others of its kind have its name by-id, too."""
    folder = _SERIAL / ("by-id" if port.serial_number else "by-path")
    if folder.is_dir():
        for link in sorted(folder.iterdir()):
            if link.resolve() == Path(port.port).resolve():
                return str(link)
    return port.port


def _built_in(port: str) -> bool:
    """Whether it is one of the computer's own serial ports, which are always there: a controller comes by USB."""
    return re.fullmatch(r"/dev/ttyS\d+|COM[12]", port) is not None


def _there(settings: type[DeviceSettings]) -> bool:
    """Whether a device of this model is found with its own defaults."""
    word = settings.model_fields["model"].annotation.__args__[0]  # type: ignore[union-attr]
    for more in [{"device": each} for each in devices_of(settings)] or [{}]:
        try:
            block = settings.model_validate({"model": word, **more})
        except ValidationError:  # it has keys that only a person knows
            return False
        if (MIRRORS | COUNTERS)[word].look_for(block).found:
            return True
    return False


def devices_of(settings: type[DeviceSettings]) -> tuple[str, ...]:
    """The kinds of instrument that one driver knows apart; empty where there is one."""
    field = settings.model_fields.get("device")
    return () if field is None else tuple(field.annotation.__args__)  # type: ignore[union-attr]
