"""Messages over USBTMC-USB488: one whole message out, one whole answer in, and the way back from anything else.

After any failure the ladder of `usbtmc_recovery` has run before the error is raised, so that a late or garbled answer
is never taken for that of the next query.
"""

import array
import threading
from collections.abc import Callable
from typing import TypeVar

from nlos.drivers.clock import Clock
from nlos.drivers.errors import DeviceError, DeviceLost, DeviceTimeout, Preempted, ProtocolError
from nlos.drivers.link import usbtmc_recovery
from nlos.drivers.link.usbtmc import UsbtmcInterface
from nlos.drivers.link.usbtmc_headers import (
    GET_CAPABILITIES,
    HEADER_BYTES,
    MAX_PADDING_BYTES,
    READ_STATUS_BYTE,
    STATUS_INTERRUPT_IN_BUSY,
    STATUS_SUCCESS,
    Capabilities,
    HeaderError,
    decode_capabilities,
    decode_response,
    encode_message,
    encode_request,
    encode_trigger,
    next_tag,
)

MOST_PER_TRANSFER = 256 * 1024
"""Bytes asked for at once: 10 ms at 25 MB/s, so that a shutter command never waits longer behind a transfer."""
MOST_PER_MESSAGE = 64 * 1024 * 1024
_SLICE_S = 0.1
_BUSY_S = 0.1
_SERVICE_REQUEST = b"\x81"

_Answer = TypeVar("_Answer")


class Usb488:
    """One instrument's message exchange. `lock` is held over each question and its answer."""

    def __init__(self, pipes: UsbtmcInterface, clock: Clock, recovery_s: float = 1.0) -> None:
        self._pipes = pipes
        self._clock = clock
        self._recovery_s = recovery_s
        self._tag = 0
        self._request_tag = 1
        self._earlier_tag = 1
        self._status_tag = 1
        self._buffers: dict[int, array.array[int]] = {}
        self._preemptions = 0
        self._seen_preemptions = 0
        self._busy = False
        self._service_requested = False
        self._unfinished = False
        """An exchange was left half-way, by an interrupt say: the link is put in step before the next one."""
        self.lock = threading.RLock()
        try:
            usbtmc_recovery.recover(pipes, clock, 1, 1, recovery_s)
            self.capabilities: Capabilities = decode_capabilities(pipes.control(GET_CAPABILITIES, 0, 24, recovery_s))
        except HeaderError as error:
            pipes.close()
            raise ProtocolError(pipes.device, f"{error}.") from error
        except DeviceError:
            pipes.close()
            raise

    def write(self, message: bytes, timeout_s: float) -> None:
        """Sends one message, whole."""
        with self.lock:
            self._exchange(lambda: self._send(message, timeout_s))

    def ask(self, message: bytes, timeout_s: float, expected: int = 4096) -> bytes:
        """Sends `message` and returns the answer, whole. `expected`: about how many bytes, to size the first read.

        Raises `DeviceTimeout`, `ProtocolError` or `DeviceLost`; in the first two cases the link is clean again.
        """
        with self.lock:
            return self._exchange(lambda: self._ask(message, timeout_s, expected))

    def trigger(self, timeout_s: float) -> None:
        """USB488 TRIGGER, which is to `*TRG` what a wire is to a letter."""
        with self.lock:
            self._tag = next_tag(self._tag)
            message = encode_trigger(self._tag)
            self._exchange(lambda: self._pipes.write(message, timeout_s))

    def clear(self) -> None:
        """Device clear: forgets messages and answers under way on both sides."""
        with self.lock:
            usbtmc_recovery.clear(self._pipes, self._clock, self._clock.now() + self._recovery_s)

    def status_byte(self, timeout_s: float) -> int:
        """READ_STATUS_BYTE, over the control pipe: works while the bulk pipes are stuck.

        Where the interrupt pipe is busy, what fills it is read first and the question asked again. A service request
        that arrives in between is kept for `wait_service_request`.
        """
        deadline_s = self._clock.now() + timeout_s
        while (left_s := deadline_s - self._clock.now()) > 0:
            self._status_tag = 2 if self._status_tag >= 127 else self._status_tag + 1
            reply = self._pipes.control(READ_STATUS_BYTE, self._status_tag, 3, left_s)
            if len(reply) == 3 and reply[:2] == bytes([STATUS_INTERRUPT_IN_BUSY, self._status_tag]):
                self._notification(min(_SLICE_S, left_s))
                continue
            if len(reply) != 3 or reply[:2] != bytes([STATUS_SUCCESS, self._status_tag]):
                raise ProtocolError(self._pipes.device, f"READ_STATUS_BYTE answered {reply.hex(' ') or 'nothing'}.")
            if not self._pipes.has_interrupt:
                return reply[2]
            while (left_s := deadline_s - self._clock.now()) > 0:
                packet = self._notification(left_s)
                if packet[:1] == bytes([0x80 | self._status_tag]) and len(packet) == 2:
                    return packet[1]
        raise DeviceTimeout(self._pipes.device, "no status byte came.")

    def wait_service_request(self, timeout_s: float) -> bool:
        """Whether the device asked for service (SRQ) within `timeout_s`, or since the last look."""
        if not self._pipes.has_interrupt:
            self._clock.sleep(timeout_s)
            return False
        deadline_s = self._clock.now() + timeout_s
        while not self._service_requested and (left_s := deadline_s - self._clock.now()) > 0:
            self._notification(left_s)
        requested, self._service_requested = self._service_requested, False
        return requested

    def _notification(self, timeout_s: float) -> bytes:
        """What comes over the interrupt pipe next, empty for nothing. A service request is kept in mind."""
        packet = self._pipes.read_interrupt(timeout_s) or b""
        self._service_requested = self._service_requested or packet[:1] == _SERVICE_REQUEST
        return packet

    def urgent(self, message: bytes, timeout_s: float) -> None:
        """Sends `message` (no answer expected) past whatever is under way; never waits for that longer than 100 ms.

        May be called from another thread or a signal handler: the exchange it breaks into fails with `Preempted`.
        """
        owned = self.lock.acquire(timeout=_BUSY_S)
        try:
            if self._busy or self._unfinished or not owned:
                self._preemptions += 1
                self._recover()
            self._send(message, timeout_s)
        finally:
            if owned:
                self.lock.release()

    def close(self) -> None:
        self._pipes.close()

    def _exchange(self, work: Callable[[], _Answer]) -> _Answer:
        if self._unfinished:
            self._recover()
        outer = (
            self._busy,
            self._seen_preemptions,
        )  # of an exchange that a signal handler's own one broke into
        preemptions = self._seen_preemptions = self._preemptions
        self._busy = self._unfinished = True
        try:
            answer = work()
            self._unfinished = False
        except DeviceLost:
            raise
        except DeviceError as error:
            if preemptions == self._preemptions:
                self._recover()
                raise
            self._unfinished = True  # a request that was about to be sent was sent afterwards, perhaps
            raise self._preempted() from error  # whatever it looks like: another answer, a wrong tag
        finally:
            self._busy, self._seen_preemptions = outer
        if preemptions != self._preemptions:
            self._unfinished = True
            raise self._preempted()
        return answer

    def _recover(self) -> None:
        usbtmc_recovery.recover(self._pipes, self._clock, self._request_tag, self._earlier_tag, self._recovery_s)
        self._unfinished = False

    def _send(self, message: bytes, timeout_s: float) -> None:
        self._tag = next_tag(self._tag)
        try:
            self._pipes.write(encode_message(self._tag, message), timeout_s)
        except DeviceTimeout:
            deadline_s = self._clock.now() + self._recovery_s
            usbtmc_recovery.abort_bulk_out(self._pipes, self._clock, self._tag, deadline_s)
            raise

    def _ask(self, message: bytes, timeout_s: float, expected: int) -> bytes:
        deadline_s = self._clock.now() + timeout_s
        self._send(message, timeout_s)
        parts: list[bytes] = []
        total, end = 0, False
        while not end:
            data, end = self._receive(MOST_PER_TRANSFER if parts else expected, deadline_s)
            parts.append(data)
            total += len(data)
            if total > MOST_PER_MESSAGE:
                raise ProtocolError(self._pipes.device, f"its answer does not end ({total} bytes so far).")
        answer = parts[0] if len(parts) == 1 else b"".join(parts)
        if self.capabilities.is_488_2 and not answer.endswith(b"\n"):
            # The one mark of a whole answer (IEEE 488.2 section 8.5): no length or checksum is there to tell.
            raise ProtocolError(self._pipes.device, f"its answer ends in {answer[-8:]!r}, not in a newline.")
        return answer

    def _receive(self, size: int, deadline_s: float) -> tuple[bytes, bool]:
        """One REQUEST_DEV_DEP_MSG_IN and the transfer that answers it."""
        size = min(size, MOST_PER_TRANSFER)
        packet = self._pipes.packet_bytes
        self._tag = next_tag(self._tag)
        self._earlier_tag, self._request_tag = self._request_tag, self._tag
        self._pipes.write(encode_request(self._tag, size), self._left(deadline_s))
        # One packet more than data, header and padding can fill: a zero-length packet always finds room.
        room = (HEADER_BYTES + size + MAX_PADDING_BYTES + packet - 1) // packet * packet + packet
        buffer = self._buffers.get(room)
        if buffer is None:
            buffer = self._buffers[room] = array.array("B", bytes(room))
        # The zero-length packet of an earlier transfer may come late; it holds nothing, and the answer comes after it.
        got = self._read_slice(buffer, deadline_s) or self._read_slice(buffer, deadline_s)
        view = memoryview(buffer)
        try:
            announced, end = decode_response(
                view[:HEADER_BYTES] if got >= HEADER_BYTES else view[:got], self._tag, size
            )
        except HeaderError as error:
            raise ProtocolError(self._pipes.device, f"{error}.") from error
        whole = HEADER_BYTES + announced
        while got < whole:
            if got % packet:
                raise ProtocolError(
                    self._pipes.device, f"it announced {announced} bytes and ended after {got - HEADER_BYTES}."
                )
            rest = array.array("B", bytes(room - got))
            count = self._read_slice(rest, deadline_s)
            view[got : got + count] = memoryview(rest)[:count]
            got += count
            if count == 0:
                raise ProtocolError(
                    self._pipes.device, f"it announced {announced} bytes and ended after {got - HEADER_BYTES}."
                )
        if got > whole + MAX_PADDING_BYTES:
            raise ProtocolError(self._pipes.device, f"it sent {got - HEADER_BYTES} bytes and announced {announced}.")
        return view[HEADER_BYTES:whole].tobytes(), end

    def _read_slice(self, buffer: "array.array[int]", deadline_s: float) -> int:
        """Waits in slices, so that a device that omits the zero-length packet costs one slice, not the timeout."""
        while True:
            left_s = self._left(deadline_s)
            try:
                return self._pipes.read_into(buffer, min(_SLICE_S, left_s))
            except DeviceTimeout:
                pass

    def _preempted(self) -> Preempted:
        return Preempted(self._pipes.device, "an urgent command broke into this exchange.")

    def _left(self, deadline_s: float) -> float:
        if self._preemptions != self._seen_preemptions:
            raise self._preempted()
        left_s = deadline_s - self._clock.now()
        if left_s <= 0:
            raise DeviceTimeout(self._pipes.device, "no complete answer in time.")
        return left_s
