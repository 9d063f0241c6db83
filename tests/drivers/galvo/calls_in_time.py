"""Calls to a mirror whose cable does harm: each does what it says or raises a named error, in time."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from nlos.drivers.errors import DeviceError
from nlos.drivers.simulated.bench import SimulatedBench

Call = tuple[str, Any]


def each_call_in_time(
    bench: SimulatedBench,
    script: Sequence[Call],
    carry_out: Callable[[Call], Callable[[], None]],
    longest_s: float,
    waits_s: Mapping[str, float],
) -> None:
    """Makes the calls; what each returns asserts that it did what it says. `waits_s`: how much longer calls of that
    name may take."""
    for call in script:
        began_s = bench.clock.now()
        try:
            check = carry_out(call)
        except DeviceError:
            check = None
        assert bench.clock.now() - began_s < longest_s + waits_s.get(call[0], 0.0)
        if check is not None:
            check()
