"""Why a serial port cannot be opened, in the words of this house."""

from collections.abc import Sequence

from nlos.drivers.errors import DeviceBusy, DeviceError, DeviceNotFound
from nlos.drivers.link.port_owner import held_by


def cannot_open(device: str, url: str, error: Exception, ports: Sequence[str]) -> DeviceError:
    """`ports`: those of this computer."""
    number, text = getattr(error, "errno", None), str(error)
    if isinstance(error, NotImplementedError):  # pyserial's rfc2217:// could wait for ever in a write
        return DeviceNotFound(
            device,
            f"{url} cannot be used: pyserial has no deadline for such a port ({text}).",
            "Let the other computer offer the port as raw TCP at the device's baud rate and give socket://HOST:PORT.",
        )
    if isinstance(error, ValueError) or number == 2 or "FileNotFoundError" in text:
        return DeviceNotFound(
            device,
            f"there is no port {url} ({text}).",
            f"Ports of this computer: {', '.join(ports) or 'none'}. Plug the device in or correct `port` in the bench "
            "file.",
        )
    if number == 13:
        return DeviceBusy(
            device,
            f"this user may not open {url}.",
            "Join the group that owns the port (usually dialout) or add a udev rule, then log in again.",
        )
    if number in (11, 16, 35) or "PermissionError" in text:  # EAGAIN on Linux, EBUSY, EAGAIN on macOS, Windows
        owner = held_by(url).replace(" by", ":", 1)
        return DeviceBusy(device, f"another program holds {url}{owner} ({text}).", "Close it, then try again.")
    return DeviceNotFound(device, f"{url} could not be opened ({text}).", "Check cable, power and `port`.")
