"""The device's end of USBTMC-USB488: transfers in, transfers out, aborts and clears, around any message instrument.

Transfers towards the host are kept whole and sliced only as the host reads them.
"""

import struct
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Protocol

from nlos.drivers.simulated.faults import FaultPlan
from nlos.drivers.simulated.usb.control_requests import ControlRequests, Stall

_HEADER = struct.Struct("<BBBBIBBH")
HEADER_BYTES = 12

Mangle = Callable[[str, bytes], Iterable[tuple[float, bytes]]]
"""(">" to the device or "<" from it, one bulk transfer) -> what comes of it: (seconds later, bytes) each."""


class Instrument(Protocol):
    """What answers the messages. Times are bench seconds."""

    def execute(self, message: bytes, now_s: float) -> bytes:
        """Carries out a program message; its response message, empty for none."""
        ...

    def trigger(self, now_s: float) -> None: ...

    def message_exchange_error(self, code: int) -> None:
        """-410 interrupted, -420 unterminated, -430 deadlocked."""
        ...

    def status_byte(self) -> int:
        """IEEE 488.2, 11.2."""
        ...

    def advance(self, now_s: float) -> None:
        """Lets everything happen that is due by `now_s`."""
        ...

    def next_event_s(self) -> float:
        """When something will happen by itself next; infinity if nothing will."""
        ...

    def take_service_request(self) -> bool:
        """Whether SRQ is asserted, once."""
        ...


@dataclass
class Transfer:
    """One Bulk-IN transfer on its way: `data` from `position`, complete at `ready_s`, ended by a short packet."""

    data: bytes
    ready_s: float
    ends_short: bool = True
    """False: no zero-length packet follows a total that fills whole packets."""
    position: int = 0
    whole: bool = True
    """False: the device stops in the middle, and still has the transfer under way."""


class UsbtmcDevice:
    """Bulk, control and interrupt endpoints of one instrument. Its faults U1 to U10 and U19 happen here."""

    input_limit = 16 * 1024 * 1024

    def __init__(self, instrument: Instrument, faults: FaultPlan, packet_bytes: int) -> None:
        self.instrument = instrument
        self.packet_bytes = packet_bytes
        self.transfers: deque[Transfer] = deque()
        self.notifications: deque[bytes] = deque()
        self.halted: set[str] = set()
        self.mangle: Mangle | None = None
        self._faults = faults
        self._incoming = bytearray()
        self._message = bytearray()
        self._response = memoryview(b"")
        self.out_tag = 0
        self.in_tag: int | None = None
        """Of the Bulk-IN transfer under way: from its request until its last packet has gone."""
        self.last_in_tag = 0
        self._waiting: tuple[int, int] | None = None
        self.requests = ControlRequests(self, faults)

    # Bulk-OUT

    def receive(self, data: bytes, now_s: float) -> None:
        """Bytes from the host: part of a transfer, or a whole one."""
        if self.mangle is None:
            self._take(data, now_s)
        else:
            for _, piece in self.mangle(">", data):
                self._take(piece, now_s)

    def _take(self, data: bytes, now_s: float) -> None:
        if "out" in self.halted:
            raise Stall
        if self._faults.strikes("U3", now_s, "out"):
            self.halted.add("out")
            raise Stall
        if self._incoming:
            self._incoming += data
            data = bytes(self._incoming)
            self._incoming.clear()
        if len(data) < HEADER_BYTES:
            self._incoming += data
            return
        kind, tag, inverse, reserved, size, attributes, _, _ = _HEADER.unpack_from(data)
        if tag ^ 0xFF != inverse or tag == 0 or reserved or kind not in (1, 2, 128):
            self.halted.add("out")
            raise Stall
        self.out_tag = tag
        if kind == 1:
            if len(data) < HEADER_BYTES + size:
                self._incoming += data
                return
            self._program(data[HEADER_BYTES : HEADER_BYTES + size], bool(attributes & 1), now_s)
        elif kind == 2:
            self._request(tag, size, now_s)
        else:
            self._begin_message(now_s)
            self.instrument.trigger(now_s)

    def _program(self, data: bytes, end: bool, now_s: float) -> None:
        if not self._message:
            self._begin_message(now_s)
        if len(self._message) + len(data) > self.input_limit:
            self._message.clear()
            self.instrument.message_exchange_error(-430)
            return
        if end and not self._message:
            message = data
        else:
            self._message += data
            if not end:
                return
            message = bytes(self._message)
            self._message.clear()
        self._response = memoryview(self.instrument.execute(message, now_s))
        if self._waiting is not None:
            waiting, self._waiting = self._waiting, None
            self._respond(*waiting, now_s)

    def _begin_message(self, now_s: float) -> None:
        """A new message while an answer is unread throws the answer away (IEEE 488.2 section 6.3.2.3)."""
        if self._response or self.transfers:
            self._response = memoryview(b"")
            self.transfers.clear()
            self.in_tag = None
            self.instrument.message_exchange_error(-410)

    # Bulk-IN

    def _request(self, tag: int, size: int, now_s: float) -> None:
        self.in_tag = self.last_in_tag = tag
        if not self._response:
            self.instrument.message_exchange_error(-420)
            self._waiting = (tag, size)
            return
        self._respond(tag, size, now_s)

    def _respond(self, tag: int, size: int, now_s: float) -> None:
        strikes = self._faults.strikes
        if strikes("U3", now_s, "in"):
            self.halted.add("in")
        if strikes("U1", now_s):
            self._response = memoryview(b"")
            return
        delay_s = 0.0
        if fault := strikes("U19", now_s):
            delay_s = float(fault.parameters.get("delay_s", 0.005))
        take = min(size, len(self._response))
        split = strikes("U6", now_s)
        what = str(split.parameters.get("what", "split")) if split else ""
        if split and what == "split":
            take = min(take, int(split.parameters.get("size", 1)))
        body = bytes(self._response[:take])
        end = take == len(self._response)
        self._response = self._response[take:]
        announced = take
        if what == "too_large":
            announced = size + 1
        elif what == "cut":
            announced, body = take, body[: max(0, take - 5)]
        elif what == "early_end":
            body, end, announced = body[: take // 2], True, take // 2
        header = bytearray(_HEADER.pack(2, tag, tag ^ 0xFF, 0, announced, 1 if end else 0, 0, 0))
        if fault := strikes("U5", now_s):
            _spoil_header(header, str(fault.parameters.get("field", "tag")))
        padding = bytes(-len(body) % 4)
        if fault := strikes("U8", now_s):
            padding = bytes([0xA5]) * int(fault.parameters.get("bytes", len(padding)))
        data = bytes(header) + body + padding
        if strikes("U10", now_s):
            data += bytes(size + 8 * self.packet_bytes)
        ends_short, whole = strikes("U7", now_s) is None, True
        if fault := strikes("U2", now_s):
            data = data[: int(fault.parameters.get("packets", 1)) * self.packet_bytes]
            ends_short = whole = False
        for later_s, piece in [(0.0, data)] if self.mangle is None else self.mangle("<", data):
            self.transfers.append(Transfer(piece, now_s + delay_s + later_s, ends_short, whole=whole))

    def transfer_read(self) -> None:
        """The host has taken the first transfer, its short packet included."""
        if self.transfers.popleft().whole and not self.transfers:
            self.in_tag = None

    # What control requests do

    @property
    def receiving(self) -> bool:
        """Whether a Bulk-OUT transfer has begun and not ended."""
        return bool(self._incoming)

    def end_reception(self) -> int:
        """Ends the Bulk-OUT transfer under way. The data that came stays part of the message, which has no end yet;
        how many bytes of it."""
        came = bytes(self._incoming[HEADER_BYTES:])
        self._incoming.clear()
        self._message += came
        return len(came)

    def end_response(self, now_s: float) -> int:
        """Ends the Bulk-IN transfer under way but for the packet in the FIFO; how many bytes of data were sent."""
        sent = self._keep_packet_in_fifo(now_s)
        if not self.transfers:
            self.transfers.append(Transfer(b"", now_s))  # a short packet ends every transfer
        self._waiting = None
        return max(0, sent - HEADER_BYTES)

    def clear(self, now_s: float) -> None:
        """Empties both buffers, but for the packet in the Bulk-IN FIFO."""
        self._keep_packet_in_fifo(now_s)
        self._forget()

    def _keep_packet_in_fifo(self, now_s: float) -> int:
        """Drops all that is on its way to the host but the packet that its hardware holds; where that packet ends."""
        first = self.transfers[0] if self.transfers else None
        self.transfers.clear()
        if first is None or first.ready_s > now_s:
            return 0
        end = min(len(first.data), first.position - first.position % self.packet_bytes + self.packet_bytes)
        self.transfers.append(Transfer(first.data[first.position : end], now_s))
        return end

    def queue_service_request(self) -> None:
        """SRQ goes to the interrupt endpoint as soon as there is room."""
        if not self.notifications and self.instrument.take_service_request():
            self.notifications.append(bytes([0x81, self.instrument.status_byte()]))

    def control(self, kind: int, request: int, value: int, now_s: float) -> bytes:
        """The reply to a class request. Raises `Stall`."""
        return self.requests.answer(kind, request, value, now_s)

    def clear_halt(self, pipe: str) -> None:
        self.halted.discard(pipe)

    def reset(self) -> None:
        """A port reset: the link starts afresh, the instrument keeps its settings."""
        self.transfers.clear()
        self._forget()
        self.halted.clear()
        self.notifications.clear()
        self.requests.reset()

    def _forget(self) -> None:
        self._incoming.clear()
        self._message.clear()
        self._response = memoryview(b"")
        self._waiting = None
        self.in_tag = None

    def status_byte(self) -> int:
        """The instrument's, with bit 4 for an answer that waits."""
        return self.instrument.status_byte() | (16 if self._response or self.transfers else 0)


def _spoil_header(header: bytearray, field: str) -> None:
    if field == "tag":
        header[1] = header[1] % 255 + 1
        header[2] = header[1] ^ 0xFF
    elif field == "inverse":
        header[2] ^= 0x10
    elif field == "kind":
        header[0] = 7
    else:
        header[3] = 1
