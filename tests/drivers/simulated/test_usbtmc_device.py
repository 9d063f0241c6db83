"""The simulated device ends transfers as USBTMC 1.0 has it (4.2.1): what is in the FIFO cannot be called back."""

import array
import struct
from types import SimpleNamespace

import pytest
import usb.core

from nlos.drivers.clock import VirtualClock
from nlos.drivers.simulated.faults import FaultPlan
from nlos.drivers.simulated.usb.backend import SimulatedUsb
from nlos.drivers.simulated.usb.descriptors import UsbDescription

PACKET = 64
ENDPOINT, INTERFACE = 0xA2, 0xA1


class Rig:
    """One device that answers every message with 200 bytes, and a host that speaks in raw transfers."""

    def __init__(self) -> None:
        self.messages: list[bytes] = []
        self.requested = 0
        self.said: list[int] = []
        instrument = SimpleNamespace(
            usb=UsbDescription(0x1209, 1, "NLOS", "raw", "R1", PACKET),
            faults=FaultPlan(),
            execute=lambda message, now_s: self.messages.append(message) or bytes(200),
            status_byte=lambda: 0x40,
            message_exchange_error=self.said.append,
            advance=lambda now_s: None,
            next_event_s=lambda: float("inf"),
            take_service_request=self._take_request,
        )
        backend = SimulatedUsb([instrument], VirtualClock())
        self.device = usb.core.find(backend=backend)
        self.device.set_configuration()

    def _take_request(self) -> bool:
        self.requested, asked = max(0, self.requested - 1), self.requested > 0
        return asked

    def send(self, tag: int, data: bytes, announced: int | None = None) -> None:
        size = len(data) if announced is None else announced
        self.device.write(1, struct.pack("<BBBBIBBH", 1, tag, tag ^ 0xFF, 0, size, 1, 0, 0) + data)

    def request(self, tag: int) -> None:
        self.device.write(1, struct.pack("<BBBBIBBH", 2, tag, tag ^ 0xFF, 0, 4096, 0, 0, 0))

    def read(self, most: int = 4096) -> int:
        return int(self.device.read(0x82, array.array("B", bytes(most)), 100))

    def control(self, kind: int, request: int, value: int, length: int) -> bytes:
        index = {1: 1, 2: 1, 3: 0x82, 4: 0x82}.get(request, 0)
        return bytes(self.device.ctrl_transfer(kind, request, value, index, length))


def sent(reply: bytes) -> int:
    return int.from_bytes(reply[4:8], "little")


def test_an_answer_read_whole_leaves_nothing_to_abort() -> None:
    rig = Rig()
    rig.send(1, b"?")
    rig.request(2)
    assert rig.control(ENDPOINT, 3, 3, 2) == b"\x81\x02"  # under way, but not that one
    assert rig.read() == 212
    assert rig.control(ENDPOINT, 3, 2, 2)[:1] == b"\x80"


@pytest.mark.parametrize("taken", [0, 1, 2])
def test_an_aborted_answer_ends_after_the_packet_in_the_fifo(taken: int) -> None:
    rig = Rig()
    rig.send(1, b"?")
    rig.request(2)
    assert rig.read(taken * PACKET) == taken * PACKET if taken else True
    assert rig.control(ENDPOINT, 3, 2, 2) == b"\x01\x02"
    assert rig.control(ENDPOINT, 4, 0, 8)[:2] == b"\x02\x01"  # pending: the host has to read
    assert rig.read() == PACKET
    check = rig.control(ENDPOINT, 4, 0, 8)
    assert check[:2] == b"\x01\x00"
    assert sent(check) == (taken + 1) * PACKET - 12


def test_an_answer_that_was_never_ready_ends_in_a_zero_length_packet() -> None:
    rig = Rig()
    rig.request(9)
    assert rig.said == [-420]
    assert rig.control(ENDPOINT, 3, 9, 2) == b"\x01\x09"
    assert rig.read() == 0
    assert rig.control(ENDPOINT, 4, 0, 8)[:2] == b"\x01\x00"


def test_an_aborted_message_keeps_what_was_received_and_halts_the_pipe() -> None:
    rig = Rig()
    assert rig.control(ENDPOINT, 1, 5, 2)[:1] == b"\x80"
    rig.send(5, b"half", announced=100)
    assert rig.control(ENDPOINT, 1, 6, 2) == b"\x81\x05"
    assert rig.control(ENDPOINT, 1, 5, 2) == b"\x01\x05"
    assert sent(rig.control(ENDPOINT, 2, 0, 8)) == 4
    with pytest.raises(usb.core.USBError, match="Pipe"):
        rig.send(6, b"more")
    rig.device.clear_halt(1)
    rig.send(7, b" and more")
    assert rig.messages == [b"half and more"]  # nothing but a device clear makes it forget


def test_a_clear_waits_for_the_packet_in_the_fifo_to_be_read() -> None:
    rig = Rig()
    rig.send(1, b"?")
    rig.request(2)
    assert rig.control(INTERFACE, 5, 0, 1) == b"\x01"
    assert rig.control(INTERFACE, 6, 0, 2) == b"\x02\x01"
    assert rig.read() == PACKET
    assert rig.control(INTERFACE, 6, 0, 2) == b"\x01\x00"


def test_a_status_byte_has_to_wait_for_room_in_the_interrupt_pipe() -> None:
    rig = Rig()
    rig.requested = 1
    assert rig.control(INTERFACE, 128, 7, 3) == bytes([0x20, 7, 0])
    assert bytes(rig.device.read(0x83, 8, 100)) == b"\x81\x40"
    assert rig.control(INTERFACE, 128, 8, 3) == bytes([0x01, 8, 0])
    assert bytes(rig.device.read(0x83, 8, 100)) == b"\x88\x40"
    for tag in (0, 1, 128):
        with pytest.raises(usb.core.USBError, match="Pipe"):
            rig.control(INTERFACE, 128, tag, 3)


def test_remote_and_local_are_answered_as_the_capabilities_say() -> None:
    rig = Rig()
    capabilities = rig.control(INTERFACE, 7, 0, 24)
    assert capabilities[14] & 2
    assert capabilities[15] & 2
    for request, value in ((160, 1), (162, 0), (161, 0), (160, 0)):
        assert rig.control(INTERFACE, request, value, 1) == b"\x01"


@pytest.mark.parametrize("request_", range(1, 8))
def test_a_request_to_the_wrong_recipient_stalls(request_: int) -> None:
    with pytest.raises(usb.core.USBError, match="Pipe"):
        Rig().control(INTERFACE if request_ < 5 else ENDPOINT, request_, 1, 8)
