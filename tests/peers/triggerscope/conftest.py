"""The vendor's TriggerScope sketches, compiled unchanged with the core of `core/`, at the far end of the cable."""

import os
import re
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from nlos.drivers.simulated.bench import Exposure, SimulatedBench
from nlos.drivers.simulated.triggerscope.trigger_input import TriggerInput
from nlos.drivers.simulated.triggerscope.wiring import DACS, Wiring

CORE = Path(__file__).parent / "core"
FLAGS = ["-x", "c++", "-fno-stack-protector", "-fpermissive", "-U_FORTIFY_SOURCE", "-I", CORE]
SKETCHES = ("TriggerScope_V4B", "TriggerScope_V4")
_FUNCTION = re.compile(r"^(?:inline )?((?:void|int8_t) (\w+)\(([^()]*)\))\s*\{", re.MULTILINE)


class Sketch:
    """A `SerialFirmware` that is a sketch in a process of its own, with the same wiring as the simulated one."""

    def __init__(self, program: Path, outputs: dict[tuple[str, int], int], bench: SimulatedBench, wiring: Wiring,
                 sd_card: bool = True) -> None:  # fmt: skip
        self.wiring = wiring
        self._outputs = outputs
        self._bench = bench
        self._spans: dict[int, int] = {}
        environment = os.environ | ({} if sd_card else {"NO_SD_CARD": "1"})
        self.process = subprocess.Popen([program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment)
        wiring.live = sd_card
        self._banner = self._carry_out(b"", bench.clock.now())
        self._trigger = TriggerInput(bench, lambda level, when_s: self._carry_out(b"T%d\n" % level, when_s))

    def opened(self) -> bytes:
        banner, self._banner = self._banner, b""
        return banner

    def reboot(self) -> bytes:
        raise NotImplementedError

    def receive(self, data: bytes, when_s: float) -> bytes:
        self._trigger.fall_if_due(when_s)
        return self._carry_out(b"R%d\n%s" % (len(data), data), when_s)

    def close(self) -> None:
        for pipe in (self.process.stdin, self.process.stdout):
            assert pipe is not None
            pipe.close()
        self.process.wait()

    def _carry_out(self, command: bytes, when_s: float) -> bytes:
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(command)
        self.process.stdin.flush()
        said = b""
        while (line := self.process.stdout.readline()) != b".\n":
            assert line, "the sketch ended"
            kind, *words = line.decode().split()
            if kind == "S":
                said = bytes.fromhex(words[0])
            elif kind == "D":
                self._frame(bytes.fromhex(words[0]), when_s)
            elif output := self._outputs.get((kind, int(words[0]))):
                self.wiring.set_pin(output, words[1] == "1", when_s)
        return said

    def _frame(self, frame: bytes, when_s: float) -> None:
        """The DAC chip (LTC2668): write and update one; write a span, in force at the next update; write and update
        all."""
        command, dac, code = frame[1] >> 4, (frame[1] & 15) + 1, int.from_bytes(frame[2:], "big")
        if command == 3:
            self.wiring.set_code(dac, code, when_s)
        elif command == 6:
            self._spans[dac] = code + 1
        else:
            assert (command, code) == (10, 0), frame
            for each, number in self._spans.items():
                self.wiring.set_range(each, number, when_s)
            self._spans.clear()


Make = Callable[..., Sketch]


@pytest.fixture(scope="session")
def programs(checkout: Callable[..., Path], compiled: Callable[..., Path], tmp_path_factory: pytest.TempPathFactory):
    """programs(name, *flags): the compiled sketch and its TTL outputs, (kind of pin, its number) -> output from 1."""

    def build(name: str, *flags: str) -> tuple[Path, dict[tuple[str, int], int]]:
        # `..MM`: from the vendor's own repository, older than those of Micro-Manager's.
        folder = checkout("TriggerScopeARC", name) if name.endswith("MM") else checkout("TriggerScopeMM", f"src/{name}")
        source = folder / f"{name}.ino"
        text = source.read_text(encoding="utf-8", errors="replace")
        # What the Arduino builder does with a sketch: a prototype of each function before its first line.
        inline = set(re.findall(r"^inline \w+ (\w+)\(", text, re.MULTILINE))
        functions = {match[2]: match[1] for match in _FUNCTION.finditer(text)}
        prototypes = tmp_path_factory.mktemp(name) / "prototypes.h"
        lines = [f"{'inline ' if each in inline else ''}{head};" for each, head in functions.items()]
        prototypes.write_text('#include "Arduino.h"\n' + "\n".join(lines) + "\n")
        expander = [each for each in [folder / "Adafruit_MCP23017.cpp"] if each.exists()]
        program = compiled(
            f"{name}{'-'.join(flags)}", [CORE / "core.cpp", source, *expander],
            [*flags, "-include", prototypes, "-I", folder, "-I", checkout("TriggerScopeMM", "src/TriggerScope_V3")],
            before=FLAGS,
        )  # fmt: skip
        pins = re.search(r"const byte ttl\[NR_DACS\] = \{([^}]*)\}", text)
        assert pins is not None
        on_expander = 9 if expander else DACS  # board V4: outputs 10 to 16
        kinds = ["P" if output < on_expander else "X" for output in range(DACS)]
        return program, {
            (kind, int(pin)): n + 1 for n, (kind, pin) in enumerate(zip(kinds, pins[1].split(","), strict=True))
        }

    return build


@pytest.fixture
def sketch(programs: Callable[..., tuple[Path, dict[tuple[str, int], int]]]) -> Iterator[Make]:
    """sketch(name, bench, wiring): a sketch that has just been switched on."""
    running: list[Sketch] = []

    def switch_on(name: str, bench: SimulatedBench, wiring: Wiring | None = None, sd_card: bool = True) -> Sketch:
        running.append(Sketch(*programs(name), bench, wiring or Wiring(bench), sd_card))
        return running[-1]

    yield switch_on
    for each in running:
        each.close()


@pytest.fixture
def dark_bench() -> Callable[[], SimulatedBench]:
    """A bench whose detector sees nothing."""
    return lambda: SimulatedBench(
        lambda gate, beam, lit: Exposure(np.zeros(gate.bins, np.uint32), gate.dwell_s, 0, 0, False)
    )
