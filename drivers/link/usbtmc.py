"""A claimed USBTMC interface on pyusb: found, opened, its pipes, and what their errors mean.

The only file that talks to pyusb. Every count that comes back is handed on or checked: pyusb's libusb1 backend returns
a short count, not an error, when a timeout has already moved some bytes.
"""

import array
import errno
import math
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import usb.backend
import usb.core
import usb.util

from nlos.drivers.errors import (
    DeviceBusy,
    DeviceError,
    DeviceLost,
    DeviceNotFound,
    DeviceTimeout,
    ProtocolError,
)

WireLog = Callable[[str, str, bytes], None]
"""(device, ">" to it or "<" from it, the bytes)."""

_CLASS, _SUBCLASS = 0xFE, 3
_FROM_INTERFACE, _FROM_ENDPOINT = 0xA1, 0xA2
_TO_ENDPOINT, _CLEAR_FEATURE = 0x02, 0x01

# libusb error codes, the same on every platform; errno differs between them.
_LIBUSB_ACCESS, _LIBUSB_NO_DEVICE, _LIBUSB_BUSY = -3, -4, -6
_LIBUSB_TIMEOUT, _LIBUSB_OVERFLOW, _LIBUSB_PIPE, _LIBUSB_IO = -7, -8, -9, -1
_CODE_OF_ERRNO = {
    errno.EACCES: _LIBUSB_ACCESS,
    errno.EPERM: _LIBUSB_ACCESS,
    errno.ENODEV: _LIBUSB_NO_DEVICE,
    errno.EBUSY: _LIBUSB_BUSY,
    errno.ETIMEDOUT: _LIBUSB_TIMEOUT,
    errno.EOVERFLOW: _LIBUSB_OVERFLOW,
    errno.EPIPE: _LIBUSB_PIPE,
    errno.EIO: _LIBUSB_IO,
}


class PipeHalted(ProtocolError):
    """The device stalled a pipe or a control request."""


class Overflow(ProtocolError):
    """The device sent more than was asked for; what it sent is lost."""


def classify(device: str, doing: str, error: usb.core.USBError) -> DeviceError:
    """The `DeviceError` that `error` means: by its type, then libusb's code, then errno."""
    code = error.backend_error_code
    if isinstance(error, usb.core.USBTimeoutError):
        code = _LIBUSB_TIMEOUT
    elif code is None:
        code = _CODE_OF_ERRNO.get(error.errno or 0)
    if code == _LIBUSB_TIMEOUT:
        return DeviceTimeout(device, f"no answer while {doing}.")
    if code == _LIBUSB_PIPE:
        return PipeHalted(device, f"the device refused (stall) while {doing}.")
    if code == _LIBUSB_OVERFLOW:
        return Overflow(device, f"the device sent more than was asked for while {doing}.")
    if code == _LIBUSB_ACCESS:
        return DeviceBusy(
            device,
            f"this user may not open the USB device (while {doing}).",
            "On Linux, add a udev rule for it (docs/instruments.md) and plug it in again.",
        )
    if code == _LIBUSB_BUSY:
        return DeviceBusy(device, f"another program holds the USB device (while {doing}).", "Close that program.")
    return DeviceLost(
        device, f"the USB device is gone ({error}) while {doing}.", "Check cable and power, then open it again."
    )


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
        raise DeviceNotFound(device, f"{len(found)} USB devices {ids}.", "Name one by its serial number.")
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
    match = {"bInterfaceClass": _CLASS, "bInterfaceSubClass": _SUBCLASS}
    return any(usb.util.find_descriptor(configuration, **match) is not None for configuration in found)


def _describe(found: Any) -> UsbInfo:
    try:
        product, serial = str(found.product or ""), str(found.serial_number or "")
    except (usb.core.USBError, ValueError):  # pyusb raises ValueError where it may not read the language ids
        return UsbInfo(found.idVendor, found.idProduct, "", "", False)
    return UsbInfo(found.idVendor, found.idProduct, product, serial, True)


@contextmanager
def closed_unless_opened(device: str, close: Callable[[], None]) -> Iterator[None]:
    """Claims pipes of a device that is closed again where that fails. Raises `DeviceError`s only."""
    try:
        yield
    except usb.core.USBError as error:
        close()
        raise classify(device, "opening it", error) from error
    except DeviceError:
        close()
        raise


class UsbtmcInterface:
    """The four pipes of one claimed USBTMC interface. Raises `DeviceError`s only."""

    def __init__(self, device: str, found: Any, wire_log: WireLog | None = None) -> None:
        self.device = device
        self._usb = found
        self._log = wire_log
        self._reattach = False
        self.number = self.packet_bytes = self._in = self._out = 0
        self._interrupt: int | None = None
        with closed_unless_opened(device, self.close):
            self._claim()

    def _claim(self) -> None:
        interface = usb.util.find_descriptor(
            self._configuration(), bInterfaceClass=_CLASS, bInterfaceSubClass=_SUBCLASS
        )
        if interface is None:
            raise DeviceNotFound(self.device, "the USB device has no USBTMC interface.")
        self.number = int(interface.bInterfaceNumber)
        pipes = {(each.bEndpointAddress & 0x80, each.bmAttributes & 3): each for each in interface}
        if (0, 2) not in pipes or (0x80, 2) not in pipes:
            raise ProtocolError(self.device, "the USBTMC interface lacks a bulk endpoint.")
        self._out, self._in = pipes[0, 2].bEndpointAddress, pipes[0x80, 2].bEndpointAddress
        self.packet_bytes = int(pipes[0x80, 2].wMaxPacketSize)
        self._interrupt = pipes[0x80, 3].bEndpointAddress if (0x80, 3) in pipes else None
        try:
            if self._usb.is_kernel_driver_active(self.number):
                self._usb.detach_kernel_driver(self.number)
                self._reattach = True
        except NotImplementedError:
            pass  # no such notion on this platform
        usb.util.claim_interface(self._usb, self.number)

    def _configuration(self) -> Any:
        try:
            return self._usb.get_active_configuration()
        except usb.core.USBError as error:
            if not isinstance(classify(self.device, "", error), DeviceLost) or error.errno is not None:
                raise
            self._usb.set_configuration()  # pyusb's own "Configuration not set" has no errno
            return self._usb.get_active_configuration()

    @property
    def has_interrupt(self) -> bool:
        """Whether it has the endpoint on which service requests come (USB488 3.4)."""
        return self._interrupt is not None

    def write(self, data: bytes, timeout_s: float) -> None:
        """One Bulk-OUT transfer, whole, or `DeviceTimeout`."""
        if self._log:
            self._log(self.device, ">", data)
        try:
            sent = self._usb.write(self._out, data, _milliseconds(timeout_s))
        except usb.core.USBError as error:
            raise classify(self.device, "sending to it", error) from error
        if sent != len(data):
            raise DeviceTimeout(self.device, f"it took only {sent} of {len(data)} bytes.")

    def read_into(self, buffer: "array.array[int]", timeout_s: float) -> int:
        """Fills `buffer` from Bulk-IN up to a short packet, its end or a timeout; how many bytes came."""
        try:
            count = int(self._usb.read(self._in, buffer, _milliseconds(timeout_s)))
        except usb.core.USBError as error:
            raise classify(self.device, "waiting for its answer", error) from error
        if self._log:
            self._log(self.device, "<", memoryview(buffer)[:count].tobytes())
        return count

    def read_interrupt(self, timeout_s: float) -> bytes | None:
        """One Interrupt-IN notification, or None when none came in time."""
        if self._interrupt is None:
            return None
        try:
            packet = self._usb.read(self._interrupt, 64, _milliseconds(timeout_s))
        except usb.core.USBError as error:
            failure = classify(self.device, "waiting for a service request", error)
            if isinstance(failure, DeviceTimeout):
                return None
            raise failure from error
        if self._log:
            self._log(self.device, "<", bytes(packet))
        return bytes(packet)

    def control(self, request: int, value: int, length: int, timeout_s: float, pipe: str = "") -> bytes:
        """A class request to the interface, or to the "in" or "out" bulk endpoint; its reply of at most `length`."""
        kind = _FROM_ENDPOINT if pipe else _FROM_INTERFACE
        index = {"in": self._in, "out": self._out, "": self.number}[pipe]
        self._log_setup(kind, request, value, index, length)
        try:
            reply = bytes(self._usb.ctrl_transfer(kind, request, value, index, length, _milliseconds(timeout_s)))
        except usb.core.USBError as error:
            raise classify(self.device, f"waiting for its reply to control request {request}", error) from error
        if self._log:
            self._log(self.device, "<", reply)
        return reply

    def clear_halt(self, pipe: str) -> None:
        """Clears a stalled endpoint (USB 2.0, 9.4.5)."""
        endpoint = self._in if pipe == "in" else self._out
        self._log_setup(_TO_ENDPOINT, _CLEAR_FEATURE, 0, endpoint, 0)
        try:
            self._usb.clear_halt(endpoint)
        except usb.core.USBError as error:
            raise classify(self.device, f"clearing a halt of bulk {pipe}", error) from error

    def _log_setup(self, kind: int, request: int, value: int, index: int, length: int) -> None:
        """A control request as the eight bytes that travel (USB 2.0 section 9.3)."""
        if self._log:
            self._log(self.device, ">", struct.pack("<BBHHH", kind, request, value, index, length))

    def reset(self) -> None:
        """Port reset, and the interface claimed again. Raises `DeviceLost` when the device does not come back."""
        try:
            self._usb.reset()
            self._claim()
        except usb.core.USBError as error:
            raise classify(self.device, "resetting it", error) from error

    def close(self) -> None:
        """Gives interface and handle back, and the kernel its driver. May be called twice, and after an unplug."""
        try:
            if self._reattach:
                self._reattach = False
                usb.util.release_interface(self._usb, self.number)
                self._usb.attach_kernel_driver(self.number)
        except (usb.core.USBError, NotImplementedError):
            pass  # an unplugged device has nothing to give back
        finally:
            usb.util.dispose_resources(self._usb)


def _milliseconds(seconds: float) -> int:
    """libusb's timeout; 0 would mean no timeout."""
    return max(1, math.ceil(seconds * 1000.0))
