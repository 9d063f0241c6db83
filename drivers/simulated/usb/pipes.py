"""A pyusb backend with one simulated vendor-class device: its pipes, timeouts and pulled cable as libusb has them."""

import array
import errno
from collections import deque
from types import SimpleNamespace
from typing import Protocol

import usb.backend
import usb.core

from nlos.drivers.simulated.bench import SimulatedBench
from nlos.drivers.simulated.usb.descriptors import (
    UsbDescription,
    configuration_descriptor,
    device_descriptor,
    string_descriptor,
)

BULK_OUT, INTERRUPT_OUT, INTERRUPT_IN = 0x02, 0x06, 0x83
_PIPES = ((BULK_OUT, 2, 64), (INTERRUPT_OUT, 3, 32), (INTERRUPT_IN, 3, 32))


class VendorDevice(Protocol):
    """What is at the other end of the pipes. Times are bench seconds."""

    usb: UsbDescription

    def bulk(self, data: bytes, now_s: float) -> bool:
        """One transfer; false where the device does not take it now."""
        ...

    def command(self, data: bytes, now_s: float) -> bytes | None:
        """Its answer on the interrupt pipe, if any."""
        ...

    def connected(self, is_connected: bool, now_s: float) -> None:
        """The host has chosen its interface, or is gone."""
        ...


class SimulatedPipes(usb.backend.IBackend):  # type: ignore[misc]
    """One device, whose interface has its endpoints in alternate setting 1."""

    def __init__(self, device: VendorDevice, bench: SimulatedBench, latency_s: float) -> None:
        self.device, self._bench, self._latency_s = device, bench, latency_s
        self._answers: deque[bytes] = deque()
        self._late: list[tuple[float, bytes]] = []
        self._plugged, self._claimed = True, False

    def unplug(self) -> None:
        """Pulls the cable."""
        self._plugged = False
        self.device.connected(False, self._bench.clock.now())

    @property
    def held(self) -> bool:
        """Whether a program has claimed it."""
        return self._claimed

    def enumerate_devices(self) -> list[object]:
        return [self] if self._plugged else []

    def get_parent(self, dev: object) -> None:
        return None

    def get_device_descriptor(self, dev: object) -> SimpleNamespace:
        return device_descriptor(self.device.usb, 2, 1)

    def get_configuration_descriptor(self, dev: object, config: int) -> SimpleNamespace:
        return configuration_descriptor(config, total_bytes=48, most_ma=500)

    def get_interface_descriptor(self, dev: object, intf: int, alt: int, config: int) -> SimpleNamespace:
        if intf != 0 or alt > 1:
            raise IndexError(f"no interface {intf}, {alt}")
        return SimpleNamespace(
            bLength=9, bDescriptorType=4, bInterfaceNumber=0, bAlternateSetting=alt, bNumEndpoints=3 * alt,
            bInterfaceClass=0xFF, bInterfaceSubClass=0xFF, bInterfaceProtocol=0xFF, iInterface=0, extra_descriptors=[],
        )  # fmt: skip

    def get_endpoint_descriptor(self, dev: object, ep: int, intf: int, alt: int, config: int) -> SimpleNamespace:
        if alt == 0:
            raise IndexError("no endpoints")
        address, kind, packet = _PIPES[ep]
        return SimpleNamespace(
            bLength=7, bDescriptorType=5, bEndpointAddress=address, bmAttributes=kind, wMaxPacketSize=packet,
            bInterval=1, bRefresh=0, bSynchAddress=0, extra_descriptors=[],
        )  # fmt: skip

    def open_device(self, dev: object) -> object:
        return object()

    def close_device(self, dev_handle: object) -> None:
        if self._claimed and self._plugged:
            self.device.connected(False, self._bench.clock.now())
        self._claimed = False

    def get_configuration(self, dev_handle: object) -> int:
        return 1

    def set_configuration(self, dev_handle: object, config_value: int) -> None:
        self._check()

    def set_interface_altsetting(self, dev_handle: object, intf: int, altsetting: int) -> None:
        self._check()
        self.device.connected(altsetting == 1, self._bench.clock.now())

    def claim_interface(self, dev_handle: object, intf: int) -> None:
        self._check()
        if self._claimed:
            raise usb.core.USBError("Resource busy", -6, errno.EBUSY)
        self._claimed = True

    def release_interface(self, dev_handle: object, intf: int) -> None:
        self._claimed = False

    def is_kernel_driver_active(self, dev_handle: object, intf: int) -> bool:
        return False

    def bulk_write(self, dev_handle: object, ep: int, intf: int, data: "array.array[int]", timeout: int) -> int:
        now_s = self._pass("frame")
        if len(data) % 64 == 0:  # no zero-length packet follows: the device waits for the end of the transfer
            return len(data)
        if not self.device.bulk(data.tobytes(), now_s):
            self._bench.clock.sleep(timeout * 1e-3)
            raise usb.core.USBTimeoutError("Operation timed out", -7, errno.ETIMEDOUT)
        return len(data)

    def intr_write(self, dev_handle: object, ep: int, intf: int, data: "array.array[int]", timeout: int) -> int:
        now_s = self._pass("command")
        answer = self.device.command(data.tobytes(), now_s)
        if answer is None:
            return len(data)
        if (fault := self._bench.faults.strikes("H4", now_s)) is None:
            self._answers.append(answer)
        elif delay_s := float(fault.parameters.get("delay_s", 0.0)):
            self._late.append((now_s + delay_s, answer))
        return len(data)

    def intr_read(self, dev_handle: object, ep: int, intf: int, buff: "array.array[int]", timeout: int) -> int:
        by_s = self._pass("answer") + timeout * 1e-3
        due = [each for each in self._late if each[0] <= by_s]
        if due and not self._answers:
            self._bench.clock.advance_to(due[0][0])
        self._answers.extend(answer for _, answer in due)
        self._late = [each for each in self._late if each not in due]
        if not self._answers:
            self._bench.clock.advance_to(by_s)
            raise usb.core.USBTimeoutError("Operation timed out", -7, errno.ETIMEDOUT)
        packet = self._answers.popleft()
        memoryview(buff)[: len(packet)] = packet
        return len(packet)

    def ctrl_transfer(
        self,
        dev_handle: object,
        bmRequestType: int,
        bRequest: int,
        wValue: int,
        wIndex: int,
        data: "array.array[int]",
        timeout: int,
    ) -> int:
        self._pass("")
        text = string_descriptor(self.device.usb, wValue) if (bmRequestType, bRequest) == (0x80, 6) else None
        if text is None:
            raise usb.core.USBError("Pipe error", -9, errno.EPIPE)
        count = min(len(text), len(data))
        memoryview(data)[:count] = text[:count]
        return count

    def _pass(self, place: str) -> float:
        """One way along the cable; when that is done."""
        if self._plugged and self._bench.faults.strikes("H3", self._bench.clock.now(), place):
            self.unplug()
        self._check()
        self._bench.clock.sleep(0.5 * self._latency_s)
        return self._bench.clock.now()

    def _check(self) -> None:
        if not self._plugged:
            raise usb.core.USBError("No such device (it may have been disconnected)", -4, errno.ENODEV)
