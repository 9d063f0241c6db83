"""Micro-Manager's adapter as host: of the simulated controller, of the compiled sketches, and before and after us."""

import random
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.galvo.triggerscope.mirror import TriggerScope, TriggerScopeSettings
from nlos.drivers.simulated.bench import SimulatedBench
from nlos.drivers.simulated.serial.port import plug, unplug
from nlos.drivers.simulated.triggerscope.firmware import V4, V4B, TriggerScopeFirmware
from nlos.drivers.simulated.triggerscope.wiring import SPAN_V, Wiring

BOARDS = {"TriggerScope_V4B": V4B, "TriggerScope_V4": V4}
RANGES = {1: "0 - 5V", 2: "0 - 10V", 3: "-5 - 5V", 4: "-10 - 10V", 5: "-2 - 2V"}
HUB, LOW, HIGH = "TriggerScopeMM-Hub", "TS_TTL1-8", "TS_TTL9-16"
DACS = [f"TS_DAC{number:02d}" for number in range(1, 17)]
ROUNDS = 300
Make = Callable[..., Any]


class MicroManager:
    """Its adapter in a process of its own, with one controller at its port."""

    def __init__(self, program: Path, firmware: Any, bench: SimulatedBench) -> None:
        self._firmware, self._bench, self._heard = firmware, bench, bytes(firmware.opened())
        self.process = subprocess.Popen([program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1)

    def does(self, command: str) -> str:
        """What it read, of a command that its devices carry out without an error."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        print(command, file=self.process.stdin)
        value = ""
        while not (line := self.process.stdout.readline()).startswith("="):
            kind, _, rest = line.strip().partition(" ")
            if kind == ">":
                self._heard += self._firmware.receive(bytes.fromhex(rest), self._bench.clock.now())
            elif kind == "?":
                answer, end, after = self._heard.partition(b"\r\n")
                self._heard = after if end else self._heard
                print(answer.hex() if end else "-", file=self.process.stdin)
            elif kind == "purge":
                self._heard = b""
            else:
                assert kind == "value", line
                value = rest
        assert line.strip() == "= 0", f"{command}: {line}"
        return value

    def initialises(self, ranges: dict[int, int]) -> None:
        """As its hardware configuration does, with a range for each DAC."""
        self.does(f"init {HUB}")
        for number, chosen in ranges.items():
            self.does(f"set {DACS[number - 1]}|Voltage Range|{RANGES[chosen]}")
            self.does(f"init {DACS[number - 1]}")
            self.does(f"set {DACS[number - 1]}|Sequence|On")
        for group in (LOW, HIGH):
            self.does(f"init {group}")


@pytest.fixture
def host(checkout: Callable[..., Path], compiled: Callable[..., Path]) -> Iterator[Make]:
    """host(firmware, bench): Micro-Manager at the port of this controller."""
    folder = checkout("mmCoreAndDevices")
    sources = [
        Path(__file__).parent / "host/micromanager.cpp",
        *sorted((folder / "DeviceAdapters/TriggerScopeMM").glob("*.cpp")),
        *(folder / "MMDevice" / f"{name}.cpp" for name in ("DeviceUtils", "MMDevice", "ModuleInterface", "Property")),
    ]
    flags = [
        "-std=c++17",
        "-include",
        "iomanip",
        "-DMODULE_EXPORTS",
        "-I",
        folder / "MMDevice",
        "-I",
        folder / "MMCore",
    ]
    program, running = compiled("micromanager", sources, [*flags, "-lpthread"]), []

    def start(firmware: Any, bench: SimulatedBench) -> MicroManager:
        running.append(MicroManager(program, firmware, bench))
        return running[-1]

    yield start
    for each in running:
        for pipe in (each.process.stdin, each.process.stdout):
            assert pipe is not None
            pipe.close()
        each.process.wait()


def deed(rng: random.Random) -> str:
    """Something that a person or an acquisition asks of its devices."""
    dac, group, edge = rng.choice(DACS[:9]), rng.choice((LOW, HIGH)), rng.choice(("Rising", "Falling"))
    on, level = rng.choice(("On", "Off")), rng.choice(("Low", "High"))
    volts, masks = ([rng.randint(*span) for _ in range(rng.randint(1, 60))] for span in ((0, 2), (0, 255)))
    return rng.choice(
        [
            f"set {dac}|Volts|{rng.choice((0, 0.5, 1, 1.7, 2))}",
            f"set {dac}|Blanking|{on}", f"set {dac}|Blank On|{level}",
            f"set {dac}|Sequence Trigger Edge|{edge}", f"load {dac}|Volts|{'|'.join(map(str, volts))}",
            f"start {dac}|Volts", f"stop {dac}|Volts", f"gate {dac}|{rng.randint(0, 1)}",
            f"set {group}|State|{rng.randint(0, 255)}", f"set {group}|Blanking|{on}", f"set {group}|Blank On|{level}",
            f"set {group}|Sequence Trigger Edge|{edge}", f"load {group}|State|{'|'.join(map(str, masks))}",
            f"start {group}|State", f"stop {group}|State", f"gate {group}|{rng.randint(0, 1)}",
            f"set {LOW}|TTL-{rng.randint(1, 8)}|{rng.randint(0, 1)}", f"set {HUB}|UseActionLEDs|{on}",
        ]
    )  # fmt: skip


@pytest.mark.parametrize("name", BOARDS)
def test_it_finds_either_controller_and_does_the_same_with_both(
    host: Make, sketch: Make, dark_bench: Callable[[], SimulatedBench], name: str
) -> None:
    logs: list[list[Any]] = []
    for theirs in (False, True):
        bench = dark_bench()
        wiring, log, rng = Wiring(bench, shutter_pin=9), [], random.Random(3)
        firmware = sketch(name, bench, wiring) if theirs else TriggerScopeFirmware(bench, wiring, board=BOARDS[name])
        program = host(firmware, bench)
        wiring.log = lambda when_s, *event, log=log: log.append(event)
        program.initialises({number: 1 + number % 5 for number in range(1, 17)})
        assert program.does(f"get {HUB}|Firmware Version").encode() == BOARDS[name]
        for each in range(ROUNDS):
            if rng.random() < 0.3:
                bench.edge("pixel_clock", 0.001 * (each + 1))
            log.append(said := deed(rng))
            program.does(said)
        logs.append(log)
    assert logs[0] == logs[1]
    assert len(logs[0]) > 4 * ROUNDS


@pytest.mark.parametrize("number", RANGES)
def test_its_volts_are_ours(host: Make, dark_bench: Callable[[], SimulatedBench], number: int) -> None:
    """To two steps of 1/65536: its code for the upper end is 65535, and it rounds down."""
    bench = dark_bench()
    wiring, codes = Wiring(bench), dict[int, int]()
    program = host(TriggerScopeFirmware(bench, wiring), bench)
    program.initialises({3: number})
    wiring.log = lambda when_s, what, dac, value: codes.__setitem__(dac, value)
    low_v, high_v = (float(each) for each in RANGES[number].removesuffix("V").split(" - "))
    span = SPAN_V[number] if number != 5 else (low_v, high_v)  # it calls +-2.5 V "-2 - 2V"
    for step in range(11):
        volts = low_v + (high_v - low_v) * step / 10
        program.does(f"set {DACS[2]}|Volts|{volts:.3f}")
        assert span[0] + (span[1] - span[0]) * codes[3] / 65536 == pytest.approx(
            volts, abs=2 * (high_v - low_v) / 65536
        )


@pytest.mark.parametrize("name", BOARDS)
@pytest.mark.parametrize("seed", range(12))
def test_whatever_it_left_we_are_dark_and_centred_and_it_finds_the_controller_again(
    host: Make, dark_bench: Callable[[], SimulatedBench], name: str, seed: int
) -> None:
    bench, rng = dark_bench(), random.Random(seed)
    settings = TriggerScopeSettings(model="triggerscope", port="sim://peer", shutter_pin=9, allow_unverified_dac=True)
    firmware = TriggerScopeFirmware(bench, Wiring.matching(bench, settings), board=BOARDS[name])
    before = host(firmware, bench)
    before.initialises({number: rng.randint(1, 5) for number in (1, 2, 3)})
    for _ in range(60):
        said = deed(rng)
        if not said.split("|")[0].endswith(tuple(DACS[3:9])):
            before.does(said)
    unplug("peer")
    plug("peer", firmware, bench, 0.001)
    mirror = TriggerScope.open(settings, bench.clock)
    assert not bench.shutter_open
    for each in range(5):
        bench.edge("pixel_clock", bench.clock.now())
        assert not bench.shutter_open
        bench.clock.sleep(0.01)
        assert bench.beam.x_rad == pytest.approx(0.0, abs=1e-4)
        mirror.move_to(MirrorAngles(0.0, 0.01 * each))
        assert bench.beam.y_rad == pytest.approx(0.01 * each, abs=1e-4)
    mirror.close()
    after = host(firmware, bench)
    after.initialises(dict.fromkeys((1, 2), 4))
    after.does(f"set {HIGH}|State|1")
    assert bench.shutter_open
