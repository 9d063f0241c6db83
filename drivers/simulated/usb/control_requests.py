"""The device's answers to class requests on its control endpoint: aborts, clear, status byte, remote and local.

From USBTMC 1.0 section 4.2.1 and USB488 1.0 sections 4.2 and 4.3. What is already in the Bulk-IN FIFO cannot be called
back: after an abort or a clear the host reads it, up to a short packet, before the device says that it is done.
"""

from collections import deque
from collections.abc import Sized
from typing import Protocol

from nlos.drivers.simulated.faults import FaultPlan

SUCCESS, PENDING, INTERRUPT_IN_BUSY, FAILED, NOT_IN_PROGRESS = 0x01, 0x02, 0x20, 0x80, 0x81
_TO_ENDPOINT, _TO_INTERFACE = 0xA2, 0xA1
_ABORTS = (1, 2, 3, 4)
_REN_CONTROL, _GO_TO_LOCAL, _LOCAL_LOCKOUT = 160, 161, 162


class Stall(Exception):
    """The endpoint, or the control request, is refused."""


class BulkTransfers(Protocol):
    """The device's other endpoints, as far as its control endpoint reaches into them."""

    notifications: deque[bytes]
    halted: set[str]
    out_tag: int
    in_tag: int | None
    last_in_tag: int

    @property
    def transfers(self) -> Sized:
        """Those under way."""
        ...

    @property
    def receiving(self) -> bool:
        """Whether a message has begun and not ended."""
        ...

    def end_reception(self) -> int:
        """Gives up the message under way; its tag."""
        ...

    def end_response(self, now_s: float) -> int:
        """Gives up the answer under way; how many bytes of it were sent."""
        ...

    def clear(self, now_s: float) -> None:
        """Forgets messages and answers."""
        ...

    def queue_service_request(self) -> None:
        """One for the interrupt endpoint."""
        ...

    def status_byte(self) -> int:
        """As READ_STATUS_BYTE answers it."""
        ...


class ControlRequests:
    """Answers for one device, whose transfers it ends. Faults U3 (control) and U4 happen here."""

    def __init__(self, device: BulkTransfers, faults: FaultPlan) -> None:
        self.remote = self.locked_out = False
        self._device = device
        self._faults = faults
        self._pending_replies = 0
        self._received = self._sent = 0

    def answer(self, kind: int, request: int, value: int, now_s: float) -> bytes:
        """The reply to one request. Raises `Stall`."""
        if self._faults.strikes("U3", now_s, "control"):
            raise Stall
        if kind != (_TO_ENDPOINT if request in _ABORTS else _TO_INTERFACE):
            raise Stall
        device = self._device
        match request:
            case 1:
                return self._initiate_abort_out(value)
            case 2:
                return bytes([self._progress(now_s), 0, 0, 0]) + self._received.to_bytes(4, "little")
            case 3:
                return self._initiate_abort_in(value, now_s)
            case 4:
                left = bool(device.transfers)
                return bytes([self._progress(now_s, left), left, 0, 0]) + self._sent.to_bytes(4, "little")
            case 5:
                device.clear(now_s)
                device.halted.add("out")
                return bytes([SUCCESS])
            case 6:
                left = bool(device.transfers)
                return bytes([self._progress(now_s, left), left])
            case 7:
                return bytes([SUCCESS, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0b111, 0b1111]) + bytes(8)
            case 128 if 2 <= value <= 127:
                return self._read_status_byte(value)
            case 160 | 161 | 162:
                return self._remote_local(request, value)
        raise Stall

    def reset(self) -> None:
        """A bus reset: nothing is pending any more."""
        self._pending_replies = 0

    def _initiate_abort_out(self, tag: int) -> bytes:
        device = self._device
        if not device.receiving:
            return bytes([FAILED, device.out_tag])
        if tag != device.out_tag:
            return bytes([NOT_IN_PROGRESS, device.out_tag])
        self._received = device.end_reception()
        device.halted.add("out")
        return bytes([SUCCESS, tag])

    def _initiate_abort_in(self, tag: int, now_s: float) -> bytes:
        device = self._device
        if device.in_tag is None:
            return bytes([NOT_IN_PROGRESS if device.receiving else FAILED, device.last_in_tag])
        if tag != device.in_tag:
            return bytes([NOT_IN_PROGRESS, device.in_tag])
        self._sent = device.end_response(now_s)
        return bytes([SUCCESS, tag])

    def _read_status_byte(self, tag: int) -> bytes:
        device = self._device
        device.queue_service_request()
        if device.notifications:  # the FIFO of the interrupt endpoint holds one
            return bytes([INTERRUPT_IN_BUSY, tag, 0])
        device.notifications.append(bytes([0x80 | tag, device.status_byte()]))
        return bytes([SUCCESS, tag, 0])

    def _remote_local(self, request: int, value: int) -> bytes:
        """RL1 of IEEE 488.1: leaving remote ends the lockout of the front panel."""
        if request == _REN_CONTROL:
            self.remote = bool(value & 1)
        elif request == _LOCAL_LOCKOUT:
            self.locked_out = self.remote
        if request == _GO_TO_LOCAL:
            self.remote = False
        self.locked_out = self.locked_out and self.remote
        return bytes([SUCCESS])

    def _progress(self, now_s: float, left: bool = False) -> int:
        if self._pending_replies == 0 and (fault := self._faults.strikes("U4", now_s)):
            self._pending_replies = int(fault.parameters.get("replies", 3))
        if self._pending_replies:
            self._pending_replies -= 1
            return PENDING
        return PENDING if left else SUCCESS
