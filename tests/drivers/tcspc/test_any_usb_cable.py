"""Whatever a USB link does to the bytes, a counter gives the right histogram or a named error in time, and never lies.

Bulk transfers are split, delayed, doubled, lost and changed in either direction; records have a checksum, commands are
read back. Not asked of any link: to see a changed digit in a text answer (USB's own checksum guards those).
"""

import os
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from nlos.drivers.errors import DeviceError
from nlos.drivers.tcspc.counter import HistogramAxis, HistogramFlag, PointGates, Trigger
from tests.drivers.harms import Harm, Piece, corrupted, interspersed, split

CASES = 5000 if os.environ.get("NLOS_SOAK") else 300
LONGEST_CALL_S = 20.0  # a dozen exchanges, each asked for twice and recovered from
NUMBERS = [7, 3, 9, 2]
BINS = 64

places = st.floats(0, 1, exclude_max=True)
delays = st.sampled_from([0.0, 0.001, 0.09, 0.11, 0.2, 0.99, 1.01, 3.0])


harms = st.one_of(
    st.builds(split, st.lists(places, max_size=6), delays),
    st.builds(lambda delay_s: lambda data: [(delay_s, data)], delays),
    st.builds(lambda delay_s: lambda data: [(0.0, data), (delay_s, data)], delays),
    st.just(lambda data: []),
    st.builds(corrupted, places, st.integers(1, 255)),
    st.builds(interspersed, places, st.binary(min_size=1, max_size=300)),
)
plans = st.dictionaries(st.integers(0, 60), harms, max_size=4)


class Cable:
    """Harms the n-th transfer as planned, and counts them so that nothing runs forever."""

    def __init__(self, plan: dict[int, Harm]) -> None:
        self._plan = plan
        self._count = 0

    def __call__(self, way: str, data: bytes) -> Iterator[Piece]:
        harm = self._plan.get(self._count)
        self._count += 1
        assert self._count < 3000, "the driver does not stop talking"
        yield from [(0.0, data)] if harm is None else harm(data)


def scan(this: Any, trigger: Trigger) -> Iterator[Callable[[], Any]]:
    """A short scan, call by call."""
    counter = this.counter
    taken: list[Any] = []
    yield lambda: counter.arm_watchdog(60.0)
    yield lambda: counter.configure(HistogramAxis(BINS, 32e-12))
    yield lambda: counter.arm(PointGates([0.002, 0.001, 0.002, 0.003], NUMBERS, trigger, 0.0))
    for k in range(len(NUMBERS)):
        if trigger is Trigger.HOST:
            yield counter.trigger
        yield lambda k=k: counter.wait_points(k + 1, 1.0)
        if trigger is Trigger.HOST:
            yield lambda k=k: taken.extend(counter.read(k, 1))
    if trigger is Trigger.CLOCK:
        yield lambda: taken.extend(counter.read(0, len(NUMBERS)))
    assert len(taken) == len(NUMBERS)
    for number, dwell_s, histogram in zip(NUMBERS, [0.002, 0.001, 0.002, 0.003], taken, strict=True):
        if HistogramFlag.DATA_LOST in histogram.flags:
            assert not histogram.counts.any()
            assert histogram.live_time_s == 0
        else:
            np.testing.assert_array_equal(histogram.counts, this.counts(number))
            assert histogram.live_time_s == pytest.approx(dwell_s)


def scan_in_time(this: Any, trigger: Trigger) -> None:
    """`scan`, each of whose calls ends within `LONGEST_CALL_S`, or in an error within it."""
    for call in scan(this, trigger):
        start_s = this.bench.clock.now()
        try:
            call()
        finally:
            assert this.bench.clock.now() - start_s < LONGEST_CALL_S


@pytest.mark.soak
@pytest.mark.parametrize("mode", ["histogram", "t3"])
@settings(
    max_examples=CASES // 2,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(plans, st.sampled_from([Trigger.HOST, Trigger.CLOCK]), st.sampled_from([64, 512]))
def test_any_harm_gives_the_right_histograms_or_a_named_error_in_time(
    rig: Callable, mode: str, plan: dict[int, Harm], trigger: Trigger, packet_bytes: int
) -> None:
    this = rig(bins=BINS, packet_bytes=packet_bytes, mode=mode)
    this.usb.device("SIM0001").mangle = Cable(plan)
    with suppress(DeviceError):
        scan_in_time(this, trigger)
    this.usb.device("SIM0001").mangle = None
    this.counter.instrument.link.clear()  # what the harm left behind
    this.counter.instrument.scpi.drain_errors()
    this.counter.abort()
    for call in scan(this, trigger):
        call()
    this.counter.close()
