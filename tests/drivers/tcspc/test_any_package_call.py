"""Whichever calls of the Time Tagger's package fail, the counter gives right histograms or names the error."""

import os
from contextlib import suppress
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from nlos.drivers.errors import DeviceError, DeviceTimeout
from nlos.drivers.simulated.bench import Exposure, Gate, SimulatedBench
from nlos.drivers.simulated.simulation_settings import SimulationSettings
from nlos.drivers.simulated.table import SimulatedTable
from nlos.drivers.tcspc.counter import Histogram, HistogramAxis, HistogramFlag, PointGates, Trigger
from nlos.drivers.tcspc.timetagger.counter import TimeTagger
from nlos.drivers.tcspc.timetagger.model import TIMETAGGER
from nlos.drivers.tcspc.timetagger.settings import TimeTaggerSettings

CASES = 2000 if os.environ.get("NLOS_SOAK") else 120
AXIS = HistogramAxis(512, 32e-12, 8e-9)
DWELLS_S = [0.004] * 4
LONGEST_S = 20.0

failures = st.sampled_from(
    [
        RuntimeError("USB transfer failed"),
        ValueError("out of range"),
        OSError("no memory"),
        RuntimeError("The Time Tagger is not connected any more"),
    ]
)
plans = st.dictionaries(st.integers(0, 150), failures, max_size=3)


class Failing:
    """Hands out the package's own functions and classes, of which the n-th call fails."""

    def __init__(self, real: Any, plan: dict[int, Exception], calls: list[int]) -> None:
        self._real, self._plan, self._calls = real, plan, calls

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._real, name)
        if not callable(found):
            return found

        def call(*arguments: Any) -> Any:
            self._calls[0] += 1
            if (error := self._plan.get(self._calls[0])) is not None and not name.startswith("free"):
                raise error
            plain = [each._real if isinstance(each, Failing) else each for each in arguments]
            answer = found(*plain)
            simple = isinstance(answer, int | float | str | list | np.ndarray | None.__class__)
            return answer if simple else Failing(answer, self._plan, self._calls)

        return call


def steady(gate: Gate, beam: object, is_open: bool) -> Exposure:
    """100 photons a millisecond, all in one place of the axis."""
    counts = np.zeros(gate.bins, np.uint32)
    place = round((9e-9 - gate.offset_s) / gate.bin_width_s)
    if 0 <= place < gate.bins:
        counts[place] = round(gate.dwell_s * 1e5)
    return Exposure(counts, gate.dwell_s, round(gate.dwell_s * 10e6), int(counts.sum()), False)


def take(counter: TimeTagger, trigger: Trigger) -> list[Histogram]:
    counter.configure(AXIS)
    counter.arm(PointGates(DWELLS_S, range(4), trigger, 0.001 if trigger is Trigger.CLOCK else 0.0))
    taken: list[Histogram] = []
    for k in range(4):
        if trigger is Trigger.HOST:
            counter.trigger()
        counter.wait_points(k + 1, 1.0)
        taken += counter.read(k, 1)
    counter.abort()
    return taken


def counted(histogram: Histogram) -> npt.NDArray[np.int64]:
    return histogram.counts.astype(np.int64)


@pytest.mark.soak
@pytest.mark.parametrize("mode", ["histogram", "list"])
@settings(max_examples=CASES // 2, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(plan=plans, trigger=st.sampled_from([Trigger.HOST, Trigger.CLOCK]))
def test_any_call_that_fails_gives_the_right_histograms_or_a_named_error_in_time(
    mode: str, plan: dict[int, Exception], trigger: Trigger
) -> None:
    bench = SimulatedBench(steady)
    chosen = TimeTaggerSettings(model="timetagger", library="simulated", mode=mode, pixel_clock=1)
    package = TIMETAGGER.firmware(chosen, SimulatedTable(bench, SimulationSettings(), 10e6))
    turn = [0]

    def step(when_s: float) -> None:
        bench.edge(f"marker_{1 + turn[0] % 2}", when_s)
        turn[0] += 1

    bench.wire("pixel_clock", step)
    calls = [0]
    began_s = bench.clock.now()
    with suppress(DeviceError):
        counter = TimeTagger.open(chosen, bench.clock, Failing(package, plan, calls))
        with suppress(DeviceError):
            for histogram in take(counter, trigger):
                if HistogramFlag.DATA_LOST not in histogram.flags:
                    assert counted(histogram).sum() == pytest.approx(400, abs=2)
                    assert np.flatnonzero(histogram.counts).tolist() in ([31], [31, 32], [30, 31])
        counter.close()
    assert bench.clock.now() - began_s < LONGEST_S
    assert calls[0] < 5000
    assert not package.held
    turn[0] = 0
    counter = TimeTagger.open(chosen, bench.clock, package)  # what went wrong has left nothing behind
    assert [int(each.counts.sum()) for each in take(counter, trigger)] == pytest.approx([400] * 4, abs=2)
    counter.close()


def test_a_rate_that_never_comes_is_a_timeout(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is asked for while light is on: no deadline, no dark."""
    bench = SimulatedBench(steady)
    chosen = TimeTaggerSettings(model="timetagger", library="simulated")
    package = TIMETAGGER.firmware(chosen, SimulatedTable(bench, SimulationSettings(), 10e6))
    counter = TimeTagger.open(chosen, bench.clock, package)
    call = counter.tagger.call
    monkeypatch.setattr(counter.tagger, "call", lambda name, *rest: name == "isRunning" or call(name, *rest))
    began_s = bench.clock.now()
    for ask in (counter.rates, counter.tagger.detector_hz):
        with pytest.raises(DeviceTimeout, match="still counts"):
            ask()
    assert bench.clock.now() - began_s < 2.0
