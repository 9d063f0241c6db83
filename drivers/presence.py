"""Whether a device is plugged in, seen without opening it, and what to do where it is not."""

import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from nlos.drivers.errors import DeviceError
from nlos.drivers.link.same_device import port_at
from nlos.drivers.link.serial_line import available_ports
from nlos.drivers.link.usb_search import UsbInfo
from nlos.drivers.udev import RELOAD, RULES_FILE, vendor_of


@dataclass(frozen=True)
class Presence:
    """`remedy` is empty where it is there."""

    found: bool
    what: str
    remedy: str = ""


def port_presence(port: str, udev_rule: str) -> Presence:
    """Of a device on a serial port: the port tells no more than that it is there, and whose USB device it is."""
    path, ports = Path(port), available_ports()
    known = {info.port for info in ports}
    if not (path.exists() or port in known or "://" in port):
        return Presence(False, "no such port", f"Plug it in, or correct `port`: {_listed(known)}.")
    if path.exists() and not os.access(path, os.R_OK | os.W_OK):
        return Presence(
            False,
            "this user may not open it",
            f"Join the group that owns it (usually dialout), or put into {RULES_FILE}: {udev_rule} ({RELOAD}).",
        )
    here, usual = port_at(port, ports), vendor_of(udev_rule)
    if here is not None and usual is not None and here.vendor_id not in (0, usual):
        other = f"it is {here.description or 'a device'} of USB vendor {here.vendor_id:04x}, where {usual:04x} is usual"
        return Presence(True, f"the port is there, but {other}; `nlos doctor` asks who answers")
    return Presence(True, "the port is there; `nlos doctor` asks who answers")


def usb_presence(ids: tuple[int, int], wanted: str, udev_rule: str, plugged_in: Iterable[UsbInfo]) -> Presence:
    """Of a USB device with these vendor and product ids; `wanted` is "auto" or its serial number."""
    matching = [each for each in plugged_in if (each.vendor_id, each.product_id) == ids]
    serials = [each.serial_number for each in matching if each.readable]
    named = [each for each in matching if each.readable and each.serial_number == wanted]
    if len(named) > 1:
        return Presence(False, f"there are {len(named)} with serial number {wanted}", "Unplug those not meant.")
    if named:
        return Presence(True, f"{named[0].product} {wanted}")
    if any(not each.readable for each in matching):
        return Presence(False, "this user may not open it", f"Put into {RULES_FILE}: {udev_rule} ({RELOAD}).")
    if not matching:
        remedy = "Check cable and power; correct vendor_id and product_id if it has others."
        return Presence(False, f"no USB device {ids[0]:04x}:{ids[1]:04x}", remedy)
    if wanted == "auto" and len(serials) > 1:
        return Presence(False, "there are several", f"Name one: {_listed(set(serials))}.")
    if wanted != "auto":
        what = f"another one is plugged in: {_listed(set(serials))}"
        return Presence(False, what, "Plug in the one that is named, or correct `usb`.")
    return Presence(True, f"{matching[0].product} {serials[0]}")


def usb_not_searched(error: DeviceError) -> Presence:
    """Where the bus itself cannot be looked at."""
    return Presence(False, "USB cannot be searched", str(error))


def _listed(words: set[str]) -> str:
    return ", ".join(sorted(words)) or "there are none"
