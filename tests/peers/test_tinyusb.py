"""The USB link against TinyUSB's USBTMC device class: answers of every length, silence anywhere, aborts and clears."""

import ctypes
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from nlos.configs.load import load
from nlos.drivers.bench import BenchSettings
from nlos.drivers.clock import VirtualClock
from nlos.drivers.errors import DeviceError, DeviceTimeout
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.link.usb488 import Usb488
from nlos.drivers.link.usb_search import find_usb
from nlos.drivers.link.usbtmc import UsbtmcInterface
from nlos.drivers.simulated.bench import SimulatedBench
from nlos.drivers.simulated.instruments import light_of
from nlos.drivers.simulated.tcspc488.firmware import Tcspc488Firmware
from nlos.drivers.simulated.usb.backend import SimulatedUsb
from nlos.drivers.tcspc.counter import Histogram, HistogramAxis, PointGates
from nlos.drivers.tcspc.tcspc488.counter import open_tcspc488
from nlos.drivers.tcspc.tcspc488.settings import Tcspc488Settings
from tests.peers.tinyusb.backend import TinyUsb, silence

HERE = Path(__file__).parent / "tinyusb"
BULK_OUT, BULK_IN = 0x01, 0x82


def said(count: int) -> bytes:
    """`count` bytes, no two neighbours alike, and a newline at the end."""
    return (bytes(range(11, 252)) * (count // 241 + 1))[: count - 1] + b"\n"


@dataclass
class Parrot:
    """Answers a number with as many bytes, anything else with nothing."""

    triggers: int = 0
    service_requests: int = 0

    def execute(self, message: bytes, now_s: float) -> bytes:
        return said(int(message)) if message.isdigit() else b""

    def trigger(self, now_s: float) -> None:
        self.triggers += 1

    def advance(self, now_s: float) -> None:
        pass

    def status_byte(self) -> int:
        return 0x40

    def next_event_s(self) -> float:
        return float("inf")

    def take_service_request(self) -> bool:
        asked, self.service_requests = self.service_requests > 0, 0
        return asked


@dataclass
class Rig:
    backend: TinyUsb
    parrot: Parrot
    link: Usb488
    clock: VirtualClock

    def check_usable(self) -> None:
        for count in (1, 52, 500, 1500):
            assert self.link.ask(b"%d" % count, 1.0) == said(count)


@pytest.fixture(params=[64, 512])
def library(request: pytest.FixtureRequest, checkout: Callable[..., Path], compiled: Callable[..., Path]) -> Path:
    """TinyUSB at full speed (packets of 64 bytes) and at high speed (512)."""
    source = checkout("tinyusb", "src")
    sources = [
        *(source / name for name in ("tusb.c", "common/tusb_fifo.c", "class/usbtmc/usbtmc_device.c")),
        *sorted((source / "device").glob("*.c")),
    ]
    flags = ["-shared", "-fPIC", f"-I{HERE}", f"-I{source}", *(["-DHIGH_SPEED"] if request.param == 512 else [])]
    return compiled(
        f"tinyusb-{request.param}.so", [*sources, HERE / "controller.c", HERE / "instrument.c"], flags, "gcc"
    )


@pytest.fixture
def rig(library: Path) -> Iterator[Rig]:
    clock, parrot = VirtualClock(), Parrot()
    backend = TinyUsb(library, parrot, clock)
    assert f"-{backend.packet_bytes}." in library.name
    pipes = UsbtmcInterface("tinyusb", find_usb("tinyusb", 0x1209, 1, "T1", backend))
    yield Rig(backend, parrot, Usb488(pipes, clock), clock)
    assert backend.failed is None


def test_its_capabilities_are_read(rig: Rig) -> None:
    assert rig.link.capabilities.is_488_2
    assert rig.link.capabilities.takes_trigger
    assert rig.link.capabilities.has_service_request


def test_answers_of_every_length_arrive_whole(rig: Rig) -> None:
    """Every length to three packets and round every boundary after, asked for in one transfer and in several."""
    packet = rig.backend.packet_bytes
    lengths = [*range(1, 3 * packet + 8), *(k * packet - 12 + d for k in (8, 9, 127, 128) for d in range(-4, 5))]
    for count in [*lengths, 1_000_000]:
        assert rig.link.ask(b"%d" % count, 30.0, expected=count) == said(count)
        if count < 2 * packet:
            assert rig.link.ask(b"%d" % count, 30.0, expected=max(1, count // 3)) == said(count)


def test_messages_of_every_length_arrive_whole(rig: Rig) -> None:
    packet = rig.backend.packet_bytes
    sent = [b"x" * length for length in (*range(1, 3 * packet + 8), 40_000)]
    for message in sent:
        rig.link.write(message, 10.0)
    assert rig.backend.messages == sent


@pytest.mark.parametrize("after", range(6))
def test_silence_in_mid_answer_is_an_error_and_the_next_answer_is_right(rig: Rig, after: int) -> None:
    """At every tag, so that the bTag that an abort names is of either half of its range."""
    for _ in range(140 if os.environ.get("NLOS_SOAK") else 20):
        start_s = rig.clock.now()
        with silence(rig.backend, BULK_IN, after), pytest.raises(DeviceTimeout):
            rig.link.ask(b"4000", 0.5)
        assert rig.clock.now() - start_s < 3.0
        rig.check_usable()


@pytest.mark.parametrize("after", range(6))
def test_silence_in_mid_message_is_an_error_and_the_next_answer_is_right(rig: Rig, after: int) -> None:
    for _ in range(20):
        with silence(rig.backend, BULK_OUT, after), pytest.raises(DeviceError):
            rig.link.write(b"x" * 4000, 0.5)
        rig.check_usable()
        assert rig.backend.messages[-1] == b"1500"


def test_an_answer_that_comes_too_late_is_never_the_next_ones(rig: Rig) -> None:
    for _ in range(20):
        rig.backend.device.instrument_mute(True)
        with pytest.raises(DeviceTimeout):
            rig.link.ask(b"300", 0.5)
        rig.backend.device.instrument_mute(False)
        rig.check_usable()


def test_an_answer_nobody_fetched_is_cleared(rig: Rig) -> None:
    rig.link.write(b"700", 1.0)
    rig.link.clear()
    rig.check_usable()


def test_a_service_request_keeps_the_status_byte_waiting_and_is_not_lost(rig: Rig) -> None:
    for _ in range(150):
        assert rig.link.status_byte(1.0) == 0x40
        rig.parrot.service_requests = 1
        assert rig.link.status_byte(1.0) == 0x40
        assert rig.link.wait_service_request(1.0)
        assert not rig.link.wait_service_request(0.01)


def test_a_trigger_and_a_reset_in_mid_answer(rig: Rig) -> None:
    rig.link.trigger(1.0)
    assert rig.parrot.triggers == 1
    rig.link.write(b"4000", 1.0)
    rig.backend.device.host_in(BULK_IN, (ctypes.c_uint8 * 512)())
    rig.link._pipes.reset()
    rig.check_usable()


def scanned(bench: SimulatedBench, backend: object, mode: str) -> list[Histogram]:
    """40 points of 2 ms, started by the host."""
    bench.set_shutter(True)
    counter = open_tcspc488(Tcspc488Settings(model="tcspc488", mode=mode), bench.clock, backend)
    counter.configure(HistogramAxis(512, 32e-12, 8e-9))
    counter.arm(PointGates([2e-3] * 40, list(range(40))))
    for point in range(40):
        bench.steer(MirrorAngles(0.005 * point, 0.0), bench.clock.now(), 0.0)
        counter.trigger()
        assert counter.wait_points(point + 1, 1.0).points_done == point + 1
    taken = counter.read(0, 40)
    counter.close()
    return taken


@pytest.mark.parametrize("mode", ["histogram", "t3"])
def test_a_counter_behind_tinyusb_measures_what_it_does_on_the_simulated_bus(library: Path, mode: str) -> None:
    settings = load("bench", "simulated", BenchSettings).settings
    expected_bench, bench = (SimulatedBench(light_of(settings)) for _ in range(2))
    expected = scanned(expected_bench, SimulatedUsb([Tcspc488Firmware(expected_bench)], expected_bench.clock), mode)
    firmware = Tcspc488Firmware(bench)
    backend = TinyUsb(library, firmware, bench.clock)
    found = scanned(bench, backend, mode)
    assert backend.failed is None
    for one, other in zip(found, expected, strict=True):
        assert (one.counts == other.counts).all()
        assert (one.total_count, one.live_time_s, one.flags) == (other.total_count, other.live_time_s, other.flags)
    assert sum(histogram.total_count for histogram in found) > 5000
