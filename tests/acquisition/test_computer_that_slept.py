"""A computer that sleeps for an hour at any moment of a scan: histograms are right or none, and the light is off."""

import os
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from nlos.acquisition.scanning.engine import scan
from nlos.drivers.bench import open_bench
from nlos.drivers.clock import VirtualClock
from nlos.drivers.errors import DeviceError
from tests.acquisition.fault_cases import BENCHES, plan, settings

ASLEEP_S = 3600.0
MOMENTS = 150 if os.environ.get("NLOS_SOAK") else 6

Taken = dict[int, tuple[bytes, float]]


@contextmanager
def sleeps_at(wait: int) -> Iterator[list[float]]:
    """The instruments go on meanwhile. What is waited for, wait by wait."""
    waits: list[float] = []
    passed = VirtualClock.sleep

    def sleep(clock: VirtualClock, seconds: float) -> None:
        if seconds > 0:
            waits.append(seconds)
        passed(clock, seconds + ASLEEP_S * (seconds > 0 and len(waits) == wait))

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(VirtualClock, "sleep", sleep)
        yield waits


def taken(name: str) -> tuple[Taken, str]:
    """Point number -> counts and live time; and what ended the scan."""
    found: Taken = {}
    error = ""
    try:
        with open_bench(settings(name)) as bench:
            for sample in scan(plan(name, 3, 3), bench):
                found[sample.point.number] = (sample.histogram.counts.tobytes(), sample.histogram.live_time_s)
    except DeviceError as ended:
        error = str(ended)
    assert bench.simulated is not None
    assert not bench.simulated.shutter_open
    return found, error


@pytest.mark.parametrize("name", sorted(BENCHES))
def test_a_computer_that_slept_keeps_nothing_that_is_wrong_and_no_light_on(name: str) -> None:
    with sleeps_at(0) as waits:
        undisturbed, error = taken(name)
    assert not error
    for wait in range(1, len(waits) + 1, max(1, len(waits) // MOMENTS)):
        with sleeps_at(wait):
            found, error = taken(name)
        assert found.items() <= undisturbed.items()
        assert error or found == undisturbed
