"""Why an instrument does not answer: owned by another program, another port, or another firmware, told apart."""

from contextlib import suppress

from nlos.drivers.bench_settings import BenchSettings
from nlos.drivers.clock import SystemClock
from nlos.drivers.device_settings import DeviceSettings
from nlos.drivers.errors import DeviceBusy, DeviceError, DeviceTimeout, ProtocolError, WrongDevice
from nlos.drivers.link.port_owner import held_by, owners_of, usb_nodes
from nlos.drivers.link.same_device import PortInfo, port_at
from nlos.drivers.link.serial_line import SerialLine, available_ports
from nlos.drivers.udev import vendor_of

_ASK = b"\r\n"
"""An empty line moves no mirror that we know, and makes most firmwares say something."""
_BAUD = 115200
_LISTEN_S = 0.5
_SILENT = (DeviceTimeout, ProtocolError, WrongDevice, DeviceBusy)


def device_of(settings: BenchSettings, error: DeviceError) -> DeviceSettings | None:
    """The block of the instrument whose error it is."""
    blocks: tuple[DeviceSettings, ...] = (settings.mirror, settings.counter)
    return next((block for block in blocks if error.device.startswith(block.model)), None)


def why_silent(block: DeviceSettings, error: DeviceError, ports: list[PortInfo] | None = None) -> str:
    """What stands behind an error of an instrument that could not be opened, in a sentence; empty where nothing more
    is known. Opens a serial port, asks with an empty line, and listens."""
    if block.simulated or not isinstance(error, _SILENT):
        return ""
    if block.cable == "usb":
        return _usb_owner(block)
    if block.cable != "serial":
        return ""
    port = block.address
    if owners := owners_of(port):
        return f"{port} is owned by another program, {', '.join(owners)}: end it, it takes the answers."
    if isinstance(error, DeviceBusy):
        return f"{port} is held by another user's program: `sudo fuser -v {port}` names it."
    if said := _wrong_port(block, available_ports() if ports is None else ports):
        return said
    heard = _heard(port)
    if heard is None:
        return ""
    if not heard:
        return (
            f"nothing at all comes from {port}: no power behind it, another port, or a controller whose firmware does "
            "not run."
        )
    return f"{port} answers {heard[:40]!r}, not as a {block.model} does: wrong firmware, or another device's port."


def _wrong_port(block: DeviceSettings, ports: list[PortInfo]) -> str:
    """By the USB vendor that the operating system sees behind the port."""
    expected, here = vendor_of(block.udev_rule), port_at(block.address, ports)
    if expected is None or here is None or here.vendor_id in (0, expected):
        return ""
    alike = [each.port for each in ports if each.vendor_id == expected]
    where = f"it may be {' or '.join(alike)}" if alike else "no port of this computer is one"
    return (
        f"wrong port: {here.port} is {here.description or 'another device'} (USB vendor {here.vendor_id:04x}), a "
        f"{block.model} has {expected:04x}; {where}."
    )


def _usb_owner(block: DeviceSettings) -> str:
    ids = (getattr(block, "vendor_id", 0), getattr(block, "product_id", 0))
    held = [said for node in usb_nodes(*ids) if (said := held_by(node))]
    return f"it is held{held[0]}: end that program." if held else ""


def _heard(port: str) -> bytes | None:
    """What comes back in half a second; None where it cannot be opened."""
    try:
        line = SerialLine.open("doctor", port, SystemClock(), baud=_BAUD, timeout_s=_LISTEN_S,
                               resynchronise=lambda line, stale: None)  # fmt: skip
    except DeviceError:
        return None
    try:
        heard = b""
        with suppress(DeviceError):
            line.write(_ASK)
            SystemClock().sleep(_LISTEN_S)
            heard = line.drain()
        return heard
    finally:
        line.close()
