"""A claimed USBTMC interface on pyusb: opened, and its pipes.

Every count that comes back is handed on or checked: pyusb's libusb1 backend returns a short count, not an error, when a
timeout has already moved some bytes.
"""

import array
import math
import struct
from collections.abc import Callable
from typing import Any

import usb.core
import usb.util

from nlos.drivers.errors import DeviceLost, DeviceNotFound, DeviceTimeout, ProtocolError
from nlos.drivers.link.usb_errors import PipeHalted, classify, closed_unless_opened
from nlos.drivers.link.usb_search import USBTMC_CLASS, USBTMC_SUBCLASS

WireLog = Callable[[str, str, bytes], None]
"""(device, ">" to it or "<" from it, the bytes)."""

_FROM_INTERFACE, _FROM_ENDPOINT = 0xA1, 0xA2
_TO_ENDPOINT, _CLEAR_FEATURE = 0x02, 0x01


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
            self._configuration(), bInterfaceClass=USBTMC_CLASS, bInterfaceSubClass=USBTMC_SUBCLASS
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
        """One Interrupt-IN notification, or None when none came in time. A pipe that is stalled is cleared once."""
        if self._interrupt is None:
            return None
        try:
            try:
                packet = self._notified(self._interrupt, timeout_s)
            except PipeHalted:
                self.clear_halt("interrupt")
                packet = self._notified(self._interrupt, timeout_s)
        except DeviceTimeout:
            return None
        if self._log:
            self._log(self.device, "<", packet)
        return packet

    def _notified(self, endpoint: int, timeout_s: float) -> bytes:
        try:
            return bytes(self._usb.read(endpoint, 64, _milliseconds(timeout_s)))
        except usb.core.USBError as error:
            raise classify(self.device, "waiting for a service request", error) from error

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
        endpoint = {"in": self._in, "out": self._out, "interrupt": self._interrupt}[pipe]
        assert endpoint is not None
        self._log_setup(_TO_ENDPOINT, _CLEAR_FEATURE, 0, endpoint, 0)
        try:
            self._usb.clear_halt(endpoint)
        except usb.core.USBError as error:
            raise classify(self.device, f"clearing a halt of its pipe {pipe}", error) from error

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
