"""Benches in the dark, and written dialogues that stand at the far end of a serial cable."""

from collections.abc import Callable, Iterable, Iterator, Sequence

import numpy as np
import pytest

from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.simulated.bench import Exposure, Gate, SimulatedBench
from nlos.drivers.simulated.faults import Fault, FaultPlan


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
