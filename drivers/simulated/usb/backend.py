"""A pyusb backend whose devices are simulated: descriptors, transfers, timeouts and unplugging as libusb shows them.

Time is the bench's: a question and its answer take `latency_s` plus their bytes at `bytes_per_s`, and a read that
waits moves the clock to the moment when there is something to read, or to its timeout.
"""

import array
import errno
from collections.abc import Sequence
from types import SimpleNamespace
from typing import NoReturn

import usb.backend
import usb.core

from nlos.drivers.clock import Clock
from nlos.drivers.simulated.faults import one_of
from nlos.drivers.simulated.usb.control_requests import Stall
from nlos.drivers.simulated.usb.descriptors import (
    configuration_descriptor,
    device_descriptor,
    endpoint_descriptor,
    interface_descriptor,
    string_descriptor,
)
from nlos.drivers.simulated.usb.ports import UsbHandle, UsbInstrument, UsbPort
from nlos.drivers.simulated.usb.usbtmc_device import UsbtmcDevice

_ERRORS = {  # libusb's code, errno and words, as on Linux
    "io": (-1, errno.EIO, "Input/Output Error"),
    "access": (-3, errno.EACCES, "Access denied (insufficient permissions)"),
    "gone": (-4, errno.ENODEV, "No such device (it may have been disconnected)"),
    "busy": (-6, errno.EBUSY, "Resource busy"),
    "overflow": (-8, errno.EOVERFLOW, "Overflow"),
    "stall": (-9, errno.EPIPE, "Pipe error"),
}


def _fail(kind: str) -> NoReturn:
    code, number, words = _ERRORS[kind]
    raise usb.core.USBError(words, code, number)


def _time_out() -> NoReturn:
    raise usb.core.USBTimeoutError("Operation timed out", -7, errno.ETIMEDOUT)


class SimulatedUsb(usb.backend.IBackend):  # type: ignore[misc]
    """All simulated USB instruments of one bench."""

    def __init__(
        self,
        devices: Sequence[UsbInstrument],
        clock: Clock,
        latency_s: float = 0.0,
        bytes_per_s: float = float("inf"),
    ) -> None:
        self._clock = clock
        self._latency_s = latency_s
        self._s_per_byte = 1.0 / bytes_per_s
        self._ports = [
            UsbPort(k + 1, UsbtmcDevice(each, each.faults, each.usb.packet_bytes), each.usb, each.faults, k + 2)
            for k, each in enumerate(devices)
        ]

    # What a person's hands do

    def unplug(self, serial: str) -> None:
        """Pulls the cable of the device with this serial number."""
        self._pull(self._port(serial))

    def replug(self, serial: str) -> None:
        """Plugs it in again: the same device under a new address."""
        self._plug(self._port(serial))

    def device(self, serial: str) -> UsbtmcDevice:
        """The far end of the cable, for whoever wants to do harm there."""
        return self._port(serial).device

    def _port(self, serial: str) -> UsbPort:
        return next(port for port in self._ports if port.usb.serial == serial)

    def _pull(self, port: UsbPort) -> None:
        port.plugged = False
        port.claimed_by = None
        port.device.reset()

    def _plug(self, port: UsbPort) -> None:
        port.plugged = True
        port.replug_s = None
        port.address += 1

    # Descriptors

    def enumerate_devices(self) -> list[UsbPort]:
        for port in self._ports:
            if port.replug_s is not None and self._clock.now() >= port.replug_s:
                self._plug(port)
        return [port for port in self._ports if port.plugged]

    def get_parent(self, dev: UsbPort) -> None:
        return None

    def get_device_descriptor(self, dev: UsbPort) -> SimpleNamespace:
        return device_descriptor(dev.usb, dev.address, dev.number)

    def get_configuration_descriptor(self, dev: UsbPort, config: int) -> SimpleNamespace:
        return configuration_descriptor(config)

    def get_interface_descriptor(self, dev: UsbPort, intf: int, alt: int, config: int) -> SimpleNamespace:
        return interface_descriptor(intf, alt)

    def get_endpoint_descriptor(self, dev: UsbPort, ep: int, intf: int, alt: int, config: int) -> SimpleNamespace:
        return endpoint_descriptor(dev.usb, ep)

    # Opening and claiming

    def open_device(self, dev: UsbPort) -> UsbHandle:
        if not dev.plugged:
            _fail("gone")
        fault = dev.faults.strikes("U17", self._clock.now())
        what = fault.parameters.get("what", "busy") if fault else ""
        if what == "access":
            _fail("access")
        if what == "busy":
            dev.claimed_by = "another program"
        if what == "kernel_driver":
            dev.kernel_driver = True
        return UsbHandle(dev, dev.address)

    def close_device(self, dev_handle: UsbHandle) -> None:
        if dev_handle.port.claimed_by is dev_handle:
            dev_handle.port.claimed_by = None

    def get_configuration(self, dev_handle: UsbHandle) -> int:
        self._port_of(dev_handle)
        return 1

    def set_configuration(self, dev_handle: UsbHandle, config_value: int) -> None:
        self._port_of(dev_handle)

    def claim_interface(self, dev_handle: UsbHandle, intf: int) -> None:
        port = self._port_of(dev_handle)
        if port.kernel_driver or port.claimed_by not in (None, dev_handle):
            _fail("busy")
        port.claimed_by = dev_handle

    def release_interface(self, dev_handle: UsbHandle, intf: int) -> None:
        self._port_of(dev_handle).claimed_by = None

    def is_kernel_driver_active(self, dev_handle: UsbHandle, intf: int) -> bool:
        return self._port_of(dev_handle).kernel_driver

    def detach_kernel_driver(self, dev_handle: UsbHandle, intf: int) -> None:
        self._port_of(dev_handle).kernel_driver = False

    def attach_kernel_driver(self, dev_handle: UsbHandle, intf: int) -> None:
        self._port_of(dev_handle).kernel_driver = True

    # Transfers

    def bulk_write(self, dev_handle: UsbHandle, ep: int, intf: int, data: "array.array[int]", timeout: int) -> int:
        port = self._port_of(dev_handle, "write")
        self._spend(len(data), 0.5 * self._latency_s)
        now_s = self._clock.now()
        port.device.instrument.advance(now_s)
        try:
            port.device.receive(data.tobytes(), now_s)
        except Stall:
            _fail("stall")
        return len(data)

    def bulk_read(self, dev_handle: UsbHandle, ep: int, intf: int, buff: "array.array[int]", timeout: int) -> int:
        port = self._port_of(dev_handle, "read")
        device, packet = port.device, port.usb.packet_bytes
        if "in" in device.halted:
            _fail("stall")
        deadline_s = self._clock.now() + timeout / 1000.0
        room, got = len(buff), 0
        view = memoryview(buff)
        while True:
            if not device.transfers or device.transfers[0].ready_s > deadline_s:
                self._wait_until(deadline_s)
                device.instrument.advance(self._clock.now())
                if got:
                    return got  # libusb: a short count, no error
                _time_out()
            transfer = device.transfers[0]
            self._wait_until(transfer.ready_s)
            rest = len(transfer.data) - transfer.position
            count = min(rest, room - got)
            if count < rest and (got + count) % packet:
                device.transfers.clear()
                _fail("overflow")
            view[got : got + count] = transfer.data[transfer.position : transfer.position + count]
            transfer.position += count
            got += count
            self._spend(count)
            ended = count == rest
            ends_with_short_packet = ended and (
                len(transfer.data) % packet != 0 or (transfer.ends_short and got < room)
            )
            if ended and (ends_with_short_packet or not transfer.ends_short):
                device.transfer_read()
            if ends_with_short_packet or got == room:
                return got

    def intr_read(self, dev_handle: UsbHandle, ep: int, intf: int, buff: "array.array[int]", timeout: int) -> int:
        port = self._port_of(dev_handle, "interrupt")
        device = port.device
        if port.faults.strikes("U3", self._clock.now(), "interrupt"):
            device.halted.add("interrupt")
        if "interrupt" in device.halted:
            _fail("stall")
        deadline_s = self._clock.now() + timeout / 1000.0
        while True:
            device.instrument.advance(self._clock.now())
            device.queue_service_request()
            if device.notifications:
                packet = device.notifications.popleft()
                memoryview(buff)[: len(packet)] = packet
                self._spend(len(packet))
                return len(packet)
            if self._clock.now() >= deadline_s:
                _time_out()
            self._wait_until(min(deadline_s, device.instrument.next_event_s()))

    def ctrl_transfer(
        self,
        dev_handle: UsbHandle,
        bmRequestType: int,
        bRequest: int,
        wValue: int,
        wIndex: int,
        data: "array.array[int]",
        timeout: int,
    ) -> int:
        port = self._port_of(dev_handle, "control")
        self._spend(len(data), self._latency_s)
        now_s = self._clock.now()
        if (bmRequestType, bRequest) == (0x80, 6):
            text = string_descriptor(port.usb, wValue)
            if text is None:
                _fail("stall")
            reply = text
        elif bmRequestType & 0x60 == 0x20:
            port.device.instrument.advance(now_s)
            try:
                reply = port.device.control(bmRequestType, bRequest, wValue, now_s)
            except Stall:
                _fail("stall")
        else:
            _fail("stall")
        count = min(len(reply), len(data))
        memoryview(data)[:count] = reply[:count]
        return count

    def clear_halt(self, dev_handle: UsbHandle, ep: int) -> None:
        self._port_of(dev_handle).device.clear_halt({0x01: "out", 0x82: "in", 0x83: "interrupt"}[ep])

    def reset_device(self, dev_handle: UsbHandle) -> None:
        port = self._port_of(dev_handle)
        port.device.reset()
        if port.faults.strikes("U4", self._clock.now()):
            self._pull(port)
            _fail("gone")

    def _port_of(self, handle: UsbHandle, doing: str = "") -> UsbPort:
        """The port behind an open handle, unless its cable is pulled; U11 pulls it."""
        port = handle.port
        if not port.plugged or port.address != handle.address:
            _fail("gone")
        if doing and (fault := port.faults.strikes("U11", self._clock.now(), doing)):
            self._pull(port)
            after_s = fault.parameters.get("replug_after_s")
            port.replug_s = None if after_s is None else self._clock.now() + float(after_s)
            _fail(one_of(fault.parameters, "error", "gone", _ERRORS))
        return port

    def _spend(self, count: int, latency_s: float = 0.0) -> None:
        self._clock.sleep(latency_s + count * self._s_per_byte)

    def _wait_until(self, when_s: float) -> None:
        self._clock.sleep(when_s - self._clock.now())
