"""A pyusb backend over TinyUSB: every transfer goes packet by packet into the compiled stack, on a clock of its own."""

import array
import contextlib
import ctypes
import errno
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NoReturn, Protocol

import usb.backend
import usb.core

from nlos.drivers.clock import VirtualClock


class Instrument(Protocol):
    """What answers the messages: those of the simulated USB bus."""

    def execute(self, message: bytes, now_s: float) -> bytes: ...

    def trigger(self, now_s: float) -> None: ...

    def advance(self, now_s: float) -> None: ...

    def status_byte(self) -> int: ...

    def next_event_s(self) -> float: ...

    def take_service_request(self) -> bool: ...


_EXECUTE = ctypes.CFUNCTYPE(
    ctypes.c_int, ctypes.POINTER(ctypes.c_uint8), ctypes.c_int, ctypes.POINTER(ctypes.c_uint8), ctypes.c_int
)
_TRIGGER = ctypes.CFUNCTYPE(None)
_NAK, _STALLED = -1, -2
_PACKET_S = 1e-5


_DEVICE = """bLength bDescriptorType bcdUSB bDeviceClass bDeviceSubClass bDeviceProtocol bMaxPacketSize0 idVendor
idProduct bcdDevice iManufacturer iProduct iSerialNumber bNumConfigurations"""
_CONFIGURATION = """bLength bDescriptorType wTotalLength bNumInterfaces bConfigurationValue iConfiguration bmAttributes
bMaxPower"""
_INTERFACE = """bLength bDescriptorType bInterfaceNumber bAlternateSetting bNumEndpoints bInterfaceClass
bInterfaceSubClass bInterfaceProtocol iInterface"""
_ENDPOINT = "bLength bDescriptorType bEndpointAddress bmAttributes wMaxPacketSize bInterval"


def _fields(names: str, layout: str, data: bytes, **more: object) -> SimpleNamespace:
    """A descriptor with the names of USB 2.0 chapter 9."""
    return SimpleNamespace(**dict(zip(names.split(), struct.unpack(layout, data), strict=True)), **more)


def _stall() -> NoReturn:
    raise usb.core.USBError("Pipe error", -9, errno.EPIPE)


class TinyUsb(usb.backend.IBackend):  # type: ignore[misc]
    """One device. `silent_after[endpoint] = n`: from its n-th packet on, that endpoint answers NAK until removed."""

    def __init__(self, library: Path, instrument: Instrument, clock: VirtualClock) -> None:
        self.clock = clock
        self.device = ctypes.CDLL(str(library))
        self.device.instrument_service_request.restype = ctypes.c_bool
        self.silent_after: dict[int, int] = {}
        self.messages: list[bytes] = []
        self.failed: BaseException | None = None
        self._instrument = instrument
        self._calls = (_EXECUTE(self._execute), _TRIGGER(lambda: instrument.trigger(clock.now())))
        self.device.instrument_is(*self._calls)
        self.device.instrument_mute(False)
        self.plug_in()

    def _execute(self, message: Any, length: int, answer: Any, most: int) -> int:
        try:
            self.messages.append(ctypes.string_at(message, length))
            said = self._instrument.execute(self.messages[-1], self.clock.now())
        except Exception as error:  # C has no way to pass it on
            self.failed = error
            return 0
        ctypes.memmove(answer, said[:most], min(len(said), most))
        return len(said)

    def _advance(self) -> None:
        """Lets the instrument live until now; what it has to say goes to the interrupt pipe."""
        self._instrument.advance(self.clock.now())
        self.device.instrument_status(self._instrument.status_byte())
        if self._instrument.take_service_request():
            self.device.instrument_service_request()

    def plug_in(self) -> None:
        """Reset, and what a host asks a new device: its descriptors, an address, its configuration."""
        self.device.host_plug_in()
        self._device = self._control(0x80, 6, 0x0100, 0, 18)
        total = struct.unpack_from("<H", self._control(0x80, 6, 0x0200, 0, 9), 2)[0]
        self._control(0x00, 5, 1, 0, b"")
        self._configuration = self._control(0x80, 6, 0x0200, 0, total)
        self._control(0x00, 9, 1, 0, b"")
        self.packet_bytes = self.get_endpoint_descriptor(None, 0, 0, 0, 0).wMaxPacketSize

    # Packets

    def _out(self, address: int, packet: bytes) -> int:
        return self._packet(address, lambda: self.device.host_out(address, packet, len(packet)))

    def _in(self, address: int, room: Any) -> int:
        return self._packet(address, lambda: self.device.host_in(address, room))

    def _packet(self, address: int, hand_over: Callable[[], int]) -> int:
        if self.silent_after.get(address) == 0:
            return _NAK
        count = hand_over()
        if count >= 0:
            self.clock.sleep(_PACKET_S)
            if address in self.silent_after:
                self.silent_after[address] -= 1
        return count

    def _control(self, kind: int, request: int, value: int, index: int, data: bytes | int) -> bytes:
        """A whole control transfer: data out, or at most so many bytes in."""
        length = data if isinstance(data, int) else len(data)
        self.device.host_setup(struct.pack("<BBHHH", kind, request, value, index, length))
        answer, room = b"", (ctypes.c_uint8 * 64)()
        if kind & 0x80:
            while len(answer) < length:
                count = self._in(0x80, room)
                if count < 0:
                    _stall()
                answer += bytes(room[:count])
                if count < 64:
                    break
            if self._out(0x00, b"") < 0:
                _stall()
        elif self._in(0x80, room) < 0:
            _stall()
        return answer

    # Descriptors

    def _parts(self, kind: int) -> list[bytes]:
        parts, at = [], 0
        while at < len(self._configuration):
            size = self._configuration[at]
            if self._configuration[at + 1] == kind:
                parts.append(self._configuration[at : at + size])
            at += size
        return parts

    def enumerate_devices(self) -> list[str]:
        return ["tinyusb"]

    def get_parent(self, dev: object) -> None:
        return None

    def get_device_descriptor(self, dev: object) -> SimpleNamespace:
        place = {"address": 1, "bus": 1, "port_number": 1, "port_numbers": (1,), "speed": 3}
        return _fields(_DEVICE, "<BBHBBBBHHHBBBB", self._device, **place)

    def get_configuration_descriptor(self, dev: object, config: int) -> SimpleNamespace:
        return _fields(_CONFIGURATION, "<BBHBBBBB", self._parts(2)[config], extra_descriptors=[])

    def get_interface_descriptor(self, dev: object, intf: int, alt: int, config: int) -> SimpleNamespace:
        if alt:
            raise IndexError(alt)
        return _fields(_INTERFACE, "9B", self._parts(4)[intf], extra_descriptors=[])

    def get_endpoint_descriptor(self, dev: object, ep: int, intf: int, alt: int, config: int) -> SimpleNamespace:
        more = {"bRefresh": 0, "bSynchAddress": 0, "extra_descriptors": []}
        return _fields(_ENDPOINT, "<BBBBHB", self._parts(5)[ep], **more)

    # Handles

    def open_device(self, dev: object) -> str:
        return "handle"

    def close_device(self, dev_handle: object) -> None:
        pass

    def get_configuration(self, dev_handle: object) -> int:
        return 1

    def set_configuration(self, dev_handle: object, config_value: int) -> None:
        self._control(0x00, 9, config_value, 0, b"")

    def claim_interface(self, dev_handle: object, intf: int) -> None:
        pass

    release_interface = claim_interface

    def is_kernel_driver_active(self, dev_handle: object, intf: int) -> bool:
        return False

    def clear_halt(self, dev_handle: object, ep: int) -> None:
        self._control(0x02, 1, 0, ep, b"")

    def reset_device(self, dev_handle: object) -> None:
        self.plug_in()

    # Transfers, as libusb moves them

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
        self._advance()
        reply = self._control(bmRequestType, bRequest, wValue, wIndex, len(data))
        memoryview(data)[: len(reply)] = reply
        return len(reply)

    def bulk_write(self, dev_handle: object, ep: int, intf: int, data: "array.array[int]", timeout: int) -> int:
        self._advance()
        whole, sent = data.tobytes(), 0
        while sent < len(whole):
            packet = whole[sent : sent + self.packet_bytes]
            taken = self._out(ep, packet)
            if taken == _STALLED:
                _stall()
            if taken == _NAK:
                return self._timed_out(timeout, sent)
            sent += len(packet)
        return sent

    def bulk_read(self, dev_handle: object, ep: int, intf: int, buff: "array.array[int]", timeout: int) -> int:
        view, got, room = memoryview(buff), 0, (ctypes.c_uint8 * self.packet_bytes)()
        while got < len(buff):
            count = self._in(ep, room)
            if count == _STALLED:
                _stall()
            if count == _NAK:
                return self._timed_out(timeout, got)
            if count > len(buff) - got:
                raise usb.core.USBError("Overflow", -8, errno.EOVERFLOW)
            view[got : got + count] = bytes(room[:count])
            got += count
            if count < self.packet_bytes:
                break
        return got

    def intr_read(self, dev_handle: object, ep: int, intf: int, buff: "array.array[int]", timeout: int) -> int:
        room, deadline_s = (ctypes.c_uint8 * self.packet_bytes)(), self.clock.now() + timeout / 1000.0
        while True:
            self._advance()
            count = self._in(ep, room)
            if count >= 0:
                memoryview(buff)[:count] = bytes(room[:count])
                return count
            if self.clock.now() >= deadline_s:
                return self._timed_out(0, 0)
            self.clock.advance_to(min(deadline_s, self._instrument.next_event_s()))

    def _timed_out(self, timeout: int, moved: int) -> int:
        self.clock.sleep(timeout / 1000.0)
        if moved:
            return moved
        raise usb.core.USBTimeoutError("Operation timed out", -7, errno.ETIMEDOUT)


@contextlib.contextmanager
def silence(backend: TinyUsb, endpoint: int, after: int) -> Iterator[None]:
    """From the `after`-th packet on, the endpoint says nothing until the block is left."""
    backend.silent_after[endpoint] = after
    try:
        yield
    finally:
        backend.silent_after.pop(endpoint, None)
