"""An instrument that says what it is told to, at the far end of a simulated USB cable."""

from collections.abc import Callable
from dataclasses import dataclass, field

import pytest

from nlos.drivers.clock import VirtualClock
from nlos.drivers.link.usb488 import Usb488
from nlos.drivers.link.usb_search import find_usb
from nlos.drivers.link.usbtmc import UsbtmcInterface
from nlos.drivers.simulated.faults import Fault, FaultPlan
from nlos.drivers.simulated.usb.backend import SimulatedUsb
from nlos.drivers.simulated.usb.descriptors import UsbDescription


def said(count: int) -> bytes:
    """`count` bytes of which no two neighbours are alike, the last of them the newline that ends every answer."""
    return (bytes(range(11, 252)) * (count // 241 + 1))[: count - 1] + b"\n"


@dataclass
class Parrot:
    """Answers the message `b"7"` with seven bytes, a message that ends in `!` with nothing."""

    usb: UsbDescription
    faults: FaultPlan
    messages: list[bytes] = field(default_factory=list)
    errors: list[int] = field(default_factory=list)
    triggers: int = 0
    service_requests: int = 0

    def execute(self, message: bytes, now_s: float) -> bytes:
        self.messages.append(message)
        return b"" if message.endswith(b"!") else said(int(message))

    def trigger(self, now_s: float) -> None:
        self.triggers += 1

    def message_exchange_error(self, code: int) -> None:
        self.errors.append(code)

    def status_byte(self) -> int:
        return 0x54

    def advance(self, now_s: float) -> None:
        pass

    def next_event_s(self) -> float:
        return float("inf")

    def take_service_request(self) -> bool:
        self.service_requests, asked = max(0, self.service_requests - 1), self.service_requests > 0
        return asked


@dataclass
class Cable:
    """Both ends of a USB link."""

    parrot: Parrot
    clock: VirtualClock
    backend: SimulatedUsb
    link: Usb488
    wire: list[tuple[str, bytes]]

    @staticmethod
    def said(count: int) -> bytes:
        return said(count)


@pytest.fixture
def cable() -> Callable[..., Cable]:
    """cable(*faults, packet_bytes=512, latency_s=0.0): an open link to a `Parrot`."""

    def make(*faults: Fault, packet_bytes: int = 512, latency_s: float = 0.0) -> Cable:
        plan = FaultPlan(faults)
        parrot = Parrot(UsbDescription(0x1209, 1, "NLOS", "parrot", "P1", packet_bytes), plan)
        clock = VirtualClock()
        backend = SimulatedUsb([parrot], clock, latency_s)
        wire: list[tuple[str, bytes]] = []
        found = find_usb("parrot", 0x1209, 1, None, backend)
        pipes = UsbtmcInterface("parrot", found, lambda device, way, data: wire.append((way, data)))
        return Cable(parrot, clock, backend, Usb488(pipes, clock), wire)

    return make
