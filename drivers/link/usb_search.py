"""USB devices of this computer: the one that is meant, and all that are instruments."""

from dataclasses import dataclass
from typing import Any

import usb.core
import usb.util

from nlos.drivers.errors import DeviceBusy, DeviceNotFound
from nlos.drivers.link.usb_errors import classify

USBTMC_CLASS, USBTMC_SUBCLASS = 0xFE, 3


def find_usb(device: str, vendor_id: int, product_id: int, serial: str | None, backend: Any = None) -> Any:
    """The one pyusb device with these ids and, where given, this serial number.

    Raises `DeviceNotFound` when there is none, when several match, or where libusb is missing.
    """
    try:
        found = list(usb.core.find(find_all=True, backend=backend, idVendor=vendor_id, idProduct=product_id))
        serials = [_serial_of(each) for each in found] if serial is not None else []
    except usb.core.NoBackendError as error:
        raise DeviceNotFound(device, "libusb is not installed.", "Install libusb-1.0 and try again.") from error
    except usb.core.USBError as error:
        raise classify(device, "looking for it", error) from error
    ids = f"{vendor_id:04x}:{product_id:04x}"
    if serial is not None:
        named = [each for each, its in zip(found, serials, strict=True) if its == serial]
        if not named and None in serials:
            raise DeviceBusy(device, f"the serial number of a USB device {ids} cannot be read.", "Check the udev rule.")
        if not named:
            others = ", ".join(sorted(str(each) for each in serials)) or "none"
            raise DeviceNotFound(
                device, f"no USB device {ids} with serial number {serial} (found: {others}).", "Plug it in."
            )
        if len(named) > 1:
            raise DeviceNotFound(
                device, f"{len(named)} USB devices {ids} with serial number {serial}.", "Unplug those not meant."
            )
        return named[0]
    if not found:
        raise DeviceNotFound(device, f"no USB device {ids} is plugged in.", "Check cable and power.")
    if len(found) > 1:
        numbers = ", ".join(sorted(str(_serial_of(each) or "not readable") for each in found))
        raise DeviceNotFound(
            device, f"{len(found)} USB devices {ids} ({numbers}).", "Name one by its serial number as `usb`."
        )
    return found[0]


def _serial_of(found: Any) -> str | None:
    """None where this user may not read it, or another device of the kind is just leaving: that one is not meant."""
    try:
        return str(found.serial_number)
    except (usb.core.USBError, ValueError):  # pyusb raises ValueError where it may not read the language ids
        return None


@dataclass(frozen=True)
class UsbInfo:
    """A USB instrument of this computer. Texts are empty where this user may not read them."""

    vendor_id: int
    product_id: int
    product: str
    serial_number: str
    readable: bool


def available_instruments(backend: Any = None) -> list[UsbInfo]:
    """Every USB device with a USBTMC interface. Raises `DeviceNotFound` where libusb is missing."""
    try:
        found = list(usb.core.find(find_all=True, backend=backend, custom_match=_has_usbtmc))
    except usb.core.NoBackendError as error:
        raise DeviceNotFound("usb", "libusb is not installed.", "Install libusb-1.0 and try again.") from error
    return [_describe(each) for each in found]


def _has_usbtmc(found: Any) -> bool:
    match = {"bInterfaceClass": USBTMC_CLASS, "bInterfaceSubClass": USBTMC_SUBCLASS}
    return any(usb.util.find_descriptor(configuration, **match) is not None for configuration in found)


def _describe(found: Any) -> UsbInfo:
    try:
        product, serial = str(found.product or ""), str(found.serial_number or "")
    except (usb.core.USBError, ValueError):  # pyusb raises ValueError where it may not read the language ids
        return UsbInfo(found.idVendor, found.idProduct, "", "", False)
    return UsbInfo(found.idVendor, found.idProduct, product, serial, True)
