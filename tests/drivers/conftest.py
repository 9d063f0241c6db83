"""Benches in the dark, a bench named by `--bench`, and written dialogues at the far end of a serial cable."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from nlos.configs.load import load
from nlos.drivers.bench import Bench, BenchSettings, open_bench
from nlos.drivers.clock import Clock
from nlos.drivers.errors import DeviceError
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.simulated.bench import Exposure, Gate, SimulatedBench
from nlos.drivers.simulated.faults import Fault, FaultPlan

CONTRACTS = ("test_every_galvo.py", "test_every_counter.py")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--bench", metavar="BENCH", help="Hold this bench's mirror and counter to their contracts, dark.")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """With `--bench` the contracts alone: everything else is about simulated instruments."""
    if config.getoption("--bench", None) is None:
        return
    others = [item for item in items if item.path.name not in CONTRACTS]
    config.hook.pytest_deselected(items=others)
    items[:] = [item for item in items if item.path.name in CONTRACTS]


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """`lab` is every model, or the bench that is named."""
    if "lab" in metafunc.fixturenames and metafunc.definition.path.name in CONTRACTS:
        word = metafunc.config.getoption("--bench", None)
        metafunc.parametrize("lab", metafunc.module.MODELS if word is None else [f"bench {word}"], indirect=True)


class RealTable:
    """What a table of which nobody knows more than its instruments tell has of a simulated one: the time."""

    def __init__(self, clock: Clock) -> None:
        self.clock = clock

    def __getattr__(self, name: str) -> Any:
        pytest.skip(f"{name}: only a simulated table has it")


@dataclass
class NamedBench:
    """The bench of `--bench`, open and dark, and what has been sent to its instruments: (model, bytes)."""

    bench: Bench
    table: RealTable
    sent: list[tuple[str, bytes]] = field(default_factory=list)


@pytest.fixture
def named_bench(request: pytest.FixtureRequest) -> Iterator[NamedBench | None]:
    """None without `--bench`. Opened afresh for every test; a simulated bench is taken for a real one."""
    word = request.config.getoption("--bench", None)
    if word is None:
        yield None
        return
    sent: list[tuple[str, bytes]] = []
    settings = load("bench", word, BenchSettings).settings
    with ExitStack() as stack:
        log = lambda device, way, data: sent.append((device, data)) if way == ">" else None  # noqa: E731
        bench = stack.enter_context(open_bench(settings, wire_log=log))
        bench.shutter.hold("contracts are held in the dark")
        yield NamedBench(bench, RealTable(bench.clock), sent)
        with suppress(DeviceError):  # a test has closed, or confused, what is closed here
            stack.close()


def darkness(gate: Gate, beam: MirrorAngles, is_open: bool) -> Exposure:
    return Exposure(np.zeros(gate.bins, np.uint32), gate.dwell_s, 0, 0, False)


@pytest.fixture(scope="session")
def dark_bench() -> Callable[..., SimulatedBench]:
    """dark_bench(*faults): a bench whose detector sees nothing."""

    def make(*faults: Fault) -> SimulatedBench:
        return SimulatedBench(darkness, faults=FaultPlan(faults))

    return make


class Transcript:
    """A device that follows a written dialogue: each command must be the next one, and gets its answer."""

    def __init__(self, lines: Sequence[tuple[bytes, bytes]], banner: bytes = b"") -> None:
        self._lines = list(lines)
        self._banner = banner

    def opened(self) -> bytes:
        return self._banner

    def reboot(self) -> bytes:
        return self._banner

    def receive(self, data: bytes, when_s: float) -> bytes:
        assert self._lines, f"{data!r} came after the end of the dialogue"
        command, answer = self._lines.pop(0)
        assert data == command
        return answer

    @property
    def finished(self) -> bool:
        return not self._lines


@pytest.fixture(scope="session")
def transcript() -> type[Transcript]:
    return Transcript


@pytest.fixture(scope="session")
def chopped() -> Callable[..., Callable[[str, bytes], Iterable[tuple[float, bytes]]]]:
    """chopped(size, gap_s): what a device sends arrives in pieces of `size` bytes, one every `gap_s`."""

    def make(size: int, gap_s: float = 0.0002) -> Callable[[str, bytes], Iterable[tuple[float, bytes]]]:
        def cut(direction: str, data: bytes) -> Iterator[tuple[float, bytes]]:
            step = size if direction == "<" else len(data)
            for index, start in enumerate(range(0, len(data), step)):
                yield index * gap_s, data[start : start + step]

        return cut

    return make
