"""A pyusb backend whose devices are simulated: descriptors, transfers, timeouts and unplugging as libusb shows them.

Time is the bench's: a question and its answer take `latency_s` plus their bytes at `bytes_per_s`, and a read that
waits moves the clock to the moment when there is something to read, or to its timeout.
"""

import array
import errno
from collections.abc import Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import NoReturn, Protocol

import usb.backend
import usb.core

from drivers.clock import Clock
from drivers.simulated.faults import FaultPlan
from drivers.simulated.usbtmc_device import Instrument, Stall, UsbtmcDevice

_OUT, _IN, _INTERRUPT = 0x01, 0x82, 0x83
_ERRORS = {  # libusb's code, errno and words, as on Linux
    "io": (-1, errno.EIO, "Input/Output Error"),
    "access": (-3, errno.EACCES, "Access denied (insufficient permissions)"),
    "gone": (-4, errno.ENODEV, "No such device (it may have been disconnected)"),
    "busy": (-6, errno.EBUSY, "Resource busy"),
    "overflow": (-8, errno.EOVERFLOW, "Overflow"),
    "stall": (-9, errno.EPIPE, "Pipe error"),
}


@dataclass(frozen=True)
class UsbDescription:
    """What the descriptors of a simulated USBTMC-USB488 device say."""

    vendor_id: int
    product_id: int
    manufacturer: str
    product: str
    serial: str
    packet_bytes: int = 512


class UsbInstrument(Instrument, Protocol):
    """A firmware that can be plugged in."""

    @property
    def usb(self) -> UsbDescription: ...

    @property
    def faults(self) -> FaultPlan: ...


@dataclass(eq=False)
class _Port:
    number: int
    device: UsbtmcDevice
    usb: UsbDescription
    faults: FaultPlan
    address: int
    plugged: bool = True
    claimed_by: object | None = None
    kernel_driver: bool = False
    replug_s: float | None = None


@dataclass(eq=False)
class _Handle:
    port: _Port
    address: int


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
            _Port(k + 1, UsbtmcDevice(each, each.faults, each.usb.packet_bytes), each.usb, each.faults, k + 2)
            for k, each in enumerate(devices)
        ]

    # What a person's hands do

    def unplug(self, serial: str) -> None:
        """Pulls the cable of the device with this serial number."""
        self._pull(self._port(serial))

    def replug(self, serial: str) -> None:
        """Plugs it in again: the same device under a new address."""
        self._plug(self._port(serial))

    def _port(self, serial: str) -> _Port:
        return next(port for port in self._ports if port.usb.serial == serial)

    def _pull(self, port: _Port) -> None:
        port.plugged = False
        port.claimed_by = None
        port.device.reset()

    def _plug(self, port: _Port) -> None:
        port.plugged = True
        port.replug_s = None
        port.address += 1

    # Descriptors

    def enumerate_devices(self) -> list[_Port]:
        for port in self._ports:
            if port.replug_s is not None and self._clock.now() >= port.replug_s:
                self._plug(port)
        return [port for port in self._ports if port.plugged]

    def get_parent(self, dev: _Port) -> None:
        return None

    def get_device_descriptor(self, dev: _Port) -> SimpleNamespace:
        return SimpleNamespace(
            bLength=18, bDescriptorType=1, bcdUSB=0x0200, bDeviceClass=0, bDeviceSubClass=0, bDeviceProtocol=0,
            bMaxPacketSize0=64, idVendor=dev.usb.vendor_id, idProduct=dev.usb.product_id, bcdDevice=0x0100,
            iManufacturer=1, iProduct=2, iSerialNumber=3, bNumConfigurations=1,
            address=dev.address, bus=1, port_number=dev.number, port_numbers=(dev.number,), speed=3,
        )  # fmt: skip

    def get_configuration_descriptor(self, dev: _Port, config: int) -> SimpleNamespace:
        if config != 0:
            raise IndexError(f"no configuration {config}")
        return SimpleNamespace(
            bLength=9, bDescriptorType=2, wTotalLength=39, bNumInterfaces=1, bConfigurationValue=1,
            iConfiguration=0, bmAttributes=0x80, bMaxPower=50, extra_descriptors=[],
        )  # fmt: skip

    def get_interface_descriptor(self, dev: _Port, intf: int, alt: int, config: int) -> SimpleNamespace:
        if intf != 0 or alt != 0:
            raise IndexError(f"no interface {intf}, {alt}")
        return SimpleNamespace(
            bLength=9, bDescriptorType=4, bInterfaceNumber=0, bAlternateSetting=0, bNumEndpoints=3,
            bInterfaceClass=0xFE, bInterfaceSubClass=3, bInterfaceProtocol=1, iInterface=0, extra_descriptors=[],
        )  # fmt: skip

    def get_endpoint_descriptor(self, dev: _Port, ep: int, intf: int, alt: int, config: int) -> SimpleNamespace:
        packet = dev.usb.packet_bytes
        address, kind, packet = [(_OUT, 2, packet), (_IN, 2, packet), (_INTERRUPT, 3, 8)][ep]
        return SimpleNamespace(
            bLength=7, bDescriptorType=5, bEndpointAddress=address, bmAttributes=kind, wMaxPacketSize=packet,
            bInterval=1, bRefresh=0, bSynchAddress=0, extra_descriptors=[],
        )  # fmt: skip

    # Opening and claiming

    def open_device(self, dev: _Port) -> _Handle:
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
        return _Handle(dev, dev.address)

    def close_device(self, dev_handle: _Handle) -> None:
        if dev_handle.port.claimed_by is dev_handle:
            dev_handle.port.claimed_by = None

    def get_configuration(self, dev_handle: _Handle) -> int:
        self._port_of(dev_handle)
        return 1

    def set_configuration(self, dev_handle: _Handle, config_value: int) -> None:
        self._port_of(dev_handle)

    def set_interface_altsetting(self, dev_handle: _Handle, intf: int, altsetting: int) -> None:
        self._port_of(dev_handle)

    def claim_interface(self, dev_handle: _Handle, intf: int) -> None:
        port = self._port_of(dev_handle)
        if port.kernel_driver or port.claimed_by not in (None, dev_handle):
            _fail("busy")
        port.claimed_by = dev_handle

    def release_interface(self, dev_handle: _Handle, intf: int) -> None:
        self._port_of(dev_handle).claimed_by = None

    def is_kernel_driver_active(self, dev_handle: _Handle, intf: int) -> bool:
        return self._port_of(dev_handle).kernel_driver

    def detach_kernel_driver(self, dev_handle: _Handle, intf: int) -> None:
        self._port_of(dev_handle).kernel_driver = False

    def attach_kernel_driver(self, dev_handle: _Handle, intf: int) -> None:
        self._port_of(dev_handle).kernel_driver = True

    # Transfers

    def bulk_write(self, dev_handle: _Handle, ep: int, intf: int, data: "array.array[int]", timeout: int) -> int:
        port = self._port_of(dev_handle, "write")
        self._spend(len(data), 0.5 * self._latency_s)
        now_s = self._clock.now()
        port.device.instrument.advance(now_s)
        try:
            port.device.receive(data.tobytes(), now_s)
        except Stall:
            _fail("stall")
        return len(data)

    def bulk_read(self, dev_handle: _Handle, ep: int, intf: int, buff: "array.array[int]", timeout: int) -> int:
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
                device.transfers.popleft()
            if ends_with_short_packet or got == room:
                return got

    def intr_read(self, dev_handle: _Handle, ep: int, intf: int, buff: "array.array[int]", timeout: int) -> int:
        device = self._port_of(dev_handle).device
        deadline_s = self._clock.now() + timeout / 1000.0
        while True:
            device.instrument.advance(self._clock.now())
            if device.instrument.take_service_request():
                device.notifications.append(bytes([0x81, device.instrument.status_byte()]))
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
        dev_handle: _Handle,
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
            reply = _string_descriptor(port.usb, wValue)
        elif bmRequestType & 0x60 == 0x20:
            port.device.instrument.advance(now_s)
            try:
                reply = port.device.control(bmRequestType, bRequest, wValue, len(data), now_s)
            except Stall:
                _fail("stall")
        else:
            _fail("stall")
        count = min(len(reply), len(data))
        memoryview(data)[:count] = reply[:count]
        return count

    def clear_halt(self, dev_handle: _Handle, ep: int) -> None:
        self._port_of(dev_handle).device.clear_halt("in" if ep & 0x80 else "out")

    def reset_device(self, dev_handle: _Handle) -> None:
        port = self._port_of(dev_handle)
        port.device.reset()
        if port.faults.strikes("U4", self._clock.now()):
            self._pull(port)
            _fail("gone")

    def _port_of(self, handle: _Handle, doing: str = "") -> _Port:
        """The port behind an open handle, unless its cable is pulled; U11 pulls it."""
        port = handle.port
        if not port.plugged or port.address != handle.address:
            _fail("gone")
        if doing and (fault := port.faults.strikes("U11", self._clock.now(), doing)):
            self._pull(port)
            after_s = fault.parameters.get("replug_after_s")
            port.replug_s = None if after_s is None else self._clock.now() + float(after_s)
            _fail(str(fault.parameters.get("error", "gone")))
        return port

    def _spend(self, count: int, latency_s: float = 0.0) -> None:
        self._clock.sleep(latency_s + count * self._s_per_byte)

    def _wait_until(self, when_s: float) -> None:
        self._clock.sleep(when_s - self._clock.now())


def _string_descriptor(description: UsbDescription, value: int) -> bytes:
    if value >> 8 != 3:
        _fail("stall")
    index = value & 0xFF
    if index == 0:
        return bytes([4, 3, 0x09, 0x04])
    texts = {1: description.manufacturer, 2: description.product, 3: description.serial}
    if index not in texts:
        _fail("stall")
    text = texts[index].encode("utf-16-le")
    return bytes([2 + len(text), 3]) + text
