"""Whatever a cable does to the bytes, each call does what it says or raises a named error in time, and never lies.

Not asked of any link: to survive the same change to a command and to its echo, or to both of two readings; or, on the
TriggerScope, a changed digit on its way into a table, which it confirms by counts alone (USB's checksum guards that).
"""

import math
import os
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pydantic import TypeAdapter

from nlos.drivers.errors import DeviceError
from nlos.drivers.galvo.known_mirrors import MIRRORS, MirrorSettings, open_mirror
from nlos.drivers.galvo.mirror import GalvoMirror, MirrorAngles
from nlos.drivers.galvo.triggerscope.mirror import TriggerScope
from nlos.drivers.simulated.bench import SimulatedBench
from nlos.drivers.simulated.serial.port import plug, plugged, unplug
from nlos.drivers.simulated.simulation_settings import SimulationSettings
from nlos.drivers.simulated.table import SimulatedTable
from tests.drivers.galvo.calls_in_time import each_call_in_time
from tests.drivers.harms import Harm, Piece, corrupted, interspersed, split

SETTINGS: TypeAdapter[MirrorSettings] = TypeAdapter(MirrorSettings)
CASES = 2500 if os.environ.get("NLOS_SOAK") else 400  # of each of the two models
TIMEOUT_S = 0.2
LONGEST_CALL_S = 8.0  # some thirty exchanges, one of which may fail and be put right, each in 4 timeouts at most
MODELS: dict[str, dict[str, Any]] = {
    "triggerscope": {"shutter_pin": 9},
    "optotune": {"readback": True, "settle_timeout_s": 0.3},  # its replies repeat nothing: only reading back tells
}
TOLERANCE_RAD = {"triggerscope": 5e-5, "optotune": 2.0 * math.radians(1.0)}

delays = st.sampled_from([0.0, 0.0003, 0.002, 0.05, 0.19, 0.2, 0.21, 0.3, 0.7, 3.0])
places = st.floats(0, 1, exclude_max=True)


harmless = st.builds(split, st.lists(places, max_size=8), delays)
late = st.builds(lambda delay_s: lambda data: [(delay_s, data)], delays)
doubled = st.builds(lambda delay_s: lambda data: [(0.0, data), (delay_s, data)], delays)
lost = st.just(lambda data: [])
changed = st.builds(corrupted, places, st.integers(1, 255)) | st.builds(interspersed, places, st.binary(max_size=300))
harms = st.one_of(
    *(st.tuples(st.just(name), harm) for name, harm in [("", harmless | late | doubled | lost), ("changed", changed)])
)


class Cable:
    """Harms the n-th message as planned, whichever way it goes; counts messages so that nothing runs forever."""

    def __init__(self, plan: dict[int, tuple[str, Harm]]) -> None:
        self._plan = plan
        self._count = 0
        self._changed: set[bytes] = set()
        self._changed_command = False

    def __call__(self, direction: str, data: bytes) -> Iterator[Piece]:
        kind, harm = self._plan.get(self._count, ("", None))
        self._count += 1
        assert self._count < 5000, "the driver does not stop talking"
        twice = data in self._changed or (direction == "<" and self._changed_command)
        if kind == "changed" and (twice or data[:3] in (b"PAO", b"PDO")):
            harm = None
        if kind == "changed":
            self._changed.add(data)
        self._changed_command = direction == ">" and kind == "changed"
        yield from [(0.0, data)] if harm is None or not data else harm(data)


coordinate = st.floats(-0.3, 0.3)
positions = st.builds(MirrorAngles, coordinate, coordinate)
calls = st.one_of(
    st.tuples(st.just("move"), positions),
    st.tuples(st.just("move"), positions),
    st.tuples(st.just("sequence"), st.lists(positions, min_size=1, max_size=120)),
    st.tuples(st.just("shutter"), st.booleans()),
    st.tuples(st.just("shutter"), st.booleans()),
    st.tuples(st.just("park"), st.none()),
    st.tuples(st.just("wait"), st.floats(0.001, 1.0)),
)


def carry_out(bench: SimulatedBench, mirror: GalvoMirror, call: tuple[str, Any]) -> Callable[[], None]:
    """Makes the call; what is returned asserts that it did what it says."""
    word, argument = call
    tolerance_rad = TOLERANCE_RAD[mirror.identity.model]

    def points_at(angles: MirrorAngles) -> bool:
        beam = bench.beam
        return math.hypot(beam.x_rad - angles.x_rad, beam.y_rad - angles.y_rad) < tolerance_rad

    def there(angles: MirrorAngles) -> Callable[[], None]:
        def check() -> None:
            assert points_at(angles)

        return check

    if word == "move":
        mirror.move_to(argument)
        return there(argument)
    if word == "park":
        mirror.park()
        return there(MirrorAngles(0.0, 0.0))
    if word == "shutter" and isinstance(mirror, TriggerScope):
        mirror.set_shutter_line(argument)
        is_open = bench.shutter_open
        return lambda: None if is_open == argument else pytest.fail("the shutter is not where it was said to be")
    if word == "sequence":
        steps: list[float] = []
        mirror.load(argument)
        mirror.start()
        for line in ("marker_1", "marker_2"):
            bench.wire(line, steps.append)
        for angles in argument:
            bench.edge("pixel_clock", bench.clock.now())
            bench.clock.sleep(0.02)
            assert points_at(angles)
        mirror.stop()
        assert len(steps) == len(argument)
    if word == "wait":
        bench.clock.sleep(argument)
        mirror.look()
    return lambda: None


@pytest.mark.soak
@pytest.mark.parametrize("model", sorted(MODELS))
@settings(max_examples=CASES, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(
    spare_opening=st.booleans(),
    plan=st.dictionaries(st.integers(0, 60), harms, max_size=6),
    script=st.lists(calls, min_size=1, max_size=8),
)
def test_each_call_does_what_it_says_or_raises_a_named_error_in_time(
    dark_bench: Callable[..., SimulatedBench],
    model: str,
    spare_opening: bool,
    plan: dict[int, tuple[str, Harm]],
    script: list[tuple[str, Any]],
) -> None:
    bench = dark_bench()
    made = SETTINGS.validate_python({"model": model, "port": "sim://any", "timeout_s": TIMEOUT_S, **MODELS[model]})
    unplug("any")
    plug("any", MIRRORS[model].firmware(made, SimulatedTable(bench, SimulationSettings(), 10e6)), bench, 0.001)
    cable = plugged("any")
    cable.mangle = None if spare_opening else Cable(plan)
    began_s = bench.clock.now()
    try:
        mirror = open_mirror(made, bench.clock)
    except DeviceError:
        assert bench.clock.now() - began_s < LONGEST_CALL_S
        assert not cable.held
        return
    if spare_opening:
        cable.mangle = Cable(plan)
    assert (mirror.identity.vendor, mirror.identity.firmware) in {("ARC", "v.620-MM"), ("Optotune", "1.4.2")}
    waits_s = {"wait": 1.0, "sequence": 2.5}
    each_call_in_time(bench, script, lambda call: carry_out(bench, mirror, call), LONGEST_CALL_S, waits_s)
    mirror.close()
