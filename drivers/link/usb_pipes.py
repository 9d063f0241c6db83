"""A claimed vendor-class USB interface on pyusb: one pipe for data, and two for commands and answers."""

import contextlib
from typing import Any

import usb.core
import usb.util

from nlos.drivers.device_model import WireLog
from nlos.drivers.errors import DeviceTimeout, ProtocolError
from nlos.drivers.link.usb_errors import classify, closed_unless_opened
from nlos.drivers.link.usb_search import find_usb


class UsbPipes:
    """Bulk-OUT, Interrupt-OUT and Interrupt-IN of an interface's last alternate setting. Raises `DeviceError`s only."""

    def __init__(
        self, device: str, ids: tuple[int, int], serial: str | None, backend: Any, wire_log: WireLog | None
    ) -> None:
        self.device, self._log, self.closed = device, wire_log, False
        self._usb = find_usb(device, *ids, serial, backend)
        with closed_unless_opened(device, self.close):
            self._bulk, self._command, self._answer = self._claim()

    def _claim(self) -> tuple[int, int, int]:
        """Addresses of bulk out, interrupt out and interrupt in."""
        self._usb.set_configuration()
        with contextlib.suppress(NotImplementedError):
            if self._usb.is_kernel_driver_active(0):
                self._usb.detach_kernel_driver(0)
        usb.util.claim_interface(self._usb, 0)
        settings = [each for each in self._usb.get_active_configuration() if each.bInterfaceNumber == 0]
        interface = max(settings, key=lambda each: int(each.bAlternateSetting))
        if interface.bAlternateSetting:
            self._usb.set_interface_altsetting(0, interface.bAlternateSetting)
        pipes = {(each.bEndpointAddress & 0x80, each.bmAttributes & 3): each.bEndpointAddress for each in interface}
        try:
            return pipes[0, 2], pipes[0, 3], pipes[0x80, 3]
        except KeyError as error:
            raise ProtocolError(self.device, "its USB interface lacks a bulk or an interrupt endpoint.") from error

    @property
    def serial(self) -> str:
        """Empty where the device has none, or does not tell."""
        try:
            return str(self._usb.serial_number or "")
        except (usb.core.USBError, ValueError):
            return ""

    def send(self, data: bytes, timeout_s: float) -> None:
        """One bulk transfer, whole, or `DeviceTimeout`."""
        self._write(self._bulk, data, timeout_s, "sending to it")

    def command(self, data: bytes, timeout_s: float) -> None:
        """One interrupt transfer, whole, or `DeviceTimeout`."""
        self._write(self._command, data, timeout_s, "commanding it")

    def _write(self, pipe: int, data: bytes, timeout_s: float, doing: str) -> None:
        if self._log:
            self._log(self.device, ">", data)
        try:
            sent = self._usb.write(pipe, data, max(1, round(timeout_s * 1e3)))
        except usb.core.USBError as error:
            raise classify(self.device, doing, error) from error
        if sent != len(data):
            raise DeviceTimeout(self.device, f"it took only {sent} of {len(data)} bytes.")

    def answer(self, timeout_s: float) -> bytes:
        """One interrupt transfer from the device."""
        try:
            packet = bytes(self._usb.read(self._answer, 32, max(1, round(timeout_s * 1e3))))
        except usb.core.USBError as error:
            raise classify(self.device, "waiting for its answer", error) from error
        if self._log:
            self._log(self.device, "<", packet)
        return packet

    def close(self) -> None:
        """May be called twice, and after an unplug."""
        self.closed = True
        usb.util.dispose_resources(self._usb)
