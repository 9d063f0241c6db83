"""The simulated serial cable between a port and a firmware, and what can go wrong on it."""

import copy
import math
import threading
from collections import deque
from collections.abc import Callable, Iterable
from typing import Any, Protocol

from nlos.drivers.simulated.bench import SimulatedBench
from nlos.drivers.simulated.faults import Fault, one_of

_TOGETHER_S = 0.0005  # writes closer than this reach a firmware's main loop in one piece [K: one or two USB frames]

Mangle = Callable[[str, bytes], Iterable[tuple[float, bytes]]]
"""(">" to the device or "<" to the host, bytes) -> (extra delay in seconds, bytes) that really travel."""


class SerialFirmware(Protocol):
    """What sits at the far end."""

    def opened(self) -> bytes:
        """What it says, unasked, when a host opens the port."""
        ...

    def receive(self, data: bytes, when_s: float) -> bytes:
        """Takes bytes that arrived together at bench time `when_s`; returns what it sends back."""
        ...

    def reboot(self) -> bytes:
        """The power dipped and its settings are gone. Returns what it says as it starts."""
        ...


class SerialCable:
    """Bytes take `latency_s` there and back together. Commits the faults G1-G7 of docs/faults.md on any firmware."""

    def __init__(self, name: str, firmware: SerialFirmware, bench: SimulatedBench, latency_s: float = 0.0) -> None:
        self.name = name
        self.firmware = firmware
        self.clock = bench.clock
        self.latency_s = latency_s
        self.plugged = True
        self.held = False
        self.mangle: Mangle | None = None
        self._faults = bench.faults
        self._sent: deque[tuple[float, bytes]] = deque()
        self._arriving: deque[tuple[float, bytes]] = deque()
        self._withheld = b""
        # Who closes the light of a program that hangs writes from a thread of its own.
        self._both = threading.RLock()

    def strikes(self, name: str, place: str = "") -> Fault | None:
        """The fault to commit now, if the bench asks for one of that name (at that place)."""
        return self._faults.strikes(name, self.clock.now(), place)

    def plugged_anew(self) -> "SerialCable":
        """Another cable to the same device, which was not switched off."""
        another = copy.copy(self)
        another.plugged, another.held = True, False
        another._sent, another._arriving, another._withheld = deque(), deque(), b""
        return another

    def open(self) -> None:
        """A host opens the port."""
        self.held = True
        self._sent.clear()
        self._arriving.clear()
        self._reply(self.firmware.opened(), self.clock.now() + self.latency_s)

    def close(self) -> None:
        """The host closes the port; what it sent still gets there."""
        if self.plugged:
            self._deliver_until(math.inf)
        self.held = False

    def send(self, data: bytes) -> None:
        """The host writes. The firmware gets to it when time advances, with all that is written until then."""
        with self._both:
            for delay_s, piece in self.mangle(">", data) if self.mangle else ((0.0, data),):
                last_s = self._sent[-1][0] if self._sent else 0.0
                self._sent.append((max(last_s, self.clock.now() + delay_s), piece))

    def say(self, data: bytes) -> None:
        """The far end speaks unasked."""
        self._reply(data, self.clock.now())

    def next_event_s(self) -> float | None:
        """When bytes next reach either end, None where none are on their way."""
        with self._both:
            self.deliver()
            return min((way[0][0] for way in (self._arriving, self._sent) if way), default=None)

    def arrived(self) -> int:
        """How many bytes wait in the host's port."""
        self.deliver()
        with self._both:
            return sum(len(data) for when_s, data in self._arriving if when_s <= self.clock.now())

    def take(self, size: int) -> bytes:
        """At most `size` of the bytes that have arrived."""
        with self._both:
            taken = b""
            while len(taken) < size and self._arriving and self._arriving[0][0] <= self.clock.now():
                when_s, data = self._arriving.popleft()
                room = size - len(taken)
                taken += data[:room]
                if len(data) > room:
                    self._arriving.appendleft((when_s, data[room:]))
            return taken

    def forget_arrived(self) -> None:
        """The host empties its input buffer."""
        self.take(self.arrived())

    def deliver(self) -> None:
        """Hands the firmware what has reached it, joining what arrives together."""
        self._deliver_until(self.clock.now())

    def _deliver_until(self, end_s: float) -> None:
        with self._both:
            while self._sent and self._sent[0][0] <= end_s:
                when_s, data = self._sent.popleft()
                while self._sent and self._sent[0][0] <= min(end_s, when_s + _TOGETHER_S):
                    data += self._sent.popleft()[1]
                if self.strikes("G6"):
                    self._reply(self.firmware.reboot(), when_s + self.latency_s)
                    continue
                answer = self.firmware.receive(data, when_s)
                if answer:
                    self._commit(answer, when_s + self.latency_s)

    def _commit(self, answer: bytes, when_s: float) -> None:
        """Sends an answer on its way, with what goes wrong with it."""
        if self.strikes("G1"):
            return
        if fault := self.strikes("G2"):
            when_s += float(fault.parameters.get("delay_s", 1.0))
        if fault := self.strikes("G4"):
            answer = _garble(answer, fault.parameters)
        if self.strikes("G5"):
            answer = _another_value(answer)
        if fault := self.strikes("G3"):
            at = int(fault.parameters.get("at", len(answer) // 2))
            self._reply(answer[:at], when_s)
            answer, when_s = answer[at:], when_s + float(fault.parameters.get("delay_s", 0.05))
        if fault := self.strikes("G7"):
            size, gap_s = int(fault.parameters.get("chunk", 1)), float(fault.parameters.get("gap_s", 0.0001))
            if size == 0:  # this answer arrives together with the next one
                self._withheld += answer
                return
            answer, self._withheld = self._withheld + answer, b""
            for index, start in enumerate(range(0, len(answer), size)):
                self._reply(answer[start : start + size], when_s + index * gap_s)
            return
        self._reply(self._withheld + answer, when_s)
        self._withheld = b""

    def _reply(self, data: bytes, when_s: float) -> None:
        with self._both:
            for delay_s, piece in self.mangle("<", data) if self.mangle and data else ((0.0, data),):
                last_s = self._arriving[-1][0] if self._arriving else 0.0
                if piece:  # bytes never overtake each other
                    self._arriving.append((max(last_s, when_s + delay_s), piece))


def _garble(answer: bytes, parameters: dict[str, Any]) -> bytes:
    middle = len(answer) // 2
    garbled = {
        "noise": bytes(range(128, 160)) + answer,
        "nul": answer[:middle] + b"\0" + answer[middle:],
        "non_ascii": answer[:middle] + b"\xe9" + answer[middle:],
        "overlong": b"x" * 100_000,
    }
    return garbled[one_of(parameters, "kind", "noise", garbled)]


def _another_value(answer: bytes) -> bytes:
    """The answer to a neighbouring command: its last digit is another one."""
    for index in range(len(answer) - 1, -1, -1):
        if answer[index : index + 1].isdigit():
            return answer[:index] + b"%d" % ((answer[index] - 48 + 1) % 10) + answer[index + 1 :]
    return answer.swapcase()
