"""Whatever a USB cable does to a Helios laser DAC's transfers, each call does what it says or fails by name in time.

Not asked of it: to notice a changed byte within a transfer (USB's checksum guards those), or a frame that is skipped.
"""

import array
import errno
import math
import os
from collections.abc import Callable
from typing import Any

import pytest
import usb.core
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from nlos.drivers.errors import DeviceError
from nlos.drivers.galvo.helios.mirror import Helios
from nlos.drivers.galvo.helios.settings import HeliosSettings
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.simulated.bench import SimulatedBench
from nlos.drivers.simulated.helios.firmware import HeliosFirmware
from nlos.drivers.simulated.usb.pipes import SimulatedPipes
from tests.drivers.galvo.calls_in_time import each_call_in_time

CASES = 2500 if os.environ.get("NLOS_SOAK") else 250
SETTINGS = HeliosSettings(model="helios", usb="simulated", markers="colours", timeout_s=0.2)
LONGEST_CALL_S = 5.0
TOLERANCE_RAD = 4e-4  # a code of 12 bits

harms = st.one_of(
    st.sampled_from(["lost", "short", "error", "unplugged", "twice", "other"]).map(lambda kind: (kind, 0.0)),
    st.tuples(st.just("late"), st.sampled_from([0.001, 0.1, 0.19, 0.21, 0.5, 3.0])),
)
coordinate = st.floats(-0.3, 0.3)
positions = st.builds(MirrorAngles, coordinate, coordinate)
calls = st.one_of(
    st.tuples(st.just("move"), positions),
    st.tuples(st.just("move"), positions),
    st.tuples(st.just("sequence"), st.lists(positions, min_size=1, max_size=40)),
    st.tuples(st.just("park"), st.none()),
    st.tuples(st.just("wait"), st.floats(0.001, 1.0)),
)


class HarmedPipes(SimulatedPipes):
    """Harms the n-th transfer as planned, whichever way it goes."""

    plan: dict[int, tuple[str, float]]
    count = 0

    def bulk_write(self, dev_handle: object, ep: int, intf: int, data: Any, timeout: int) -> int:
        return self._out(super().bulk_write, dev_handle, ep, intf, data, timeout)

    def intr_write(self, dev_handle: object, ep: int, intf: int, data: Any, timeout: int) -> int:
        return self._out(super().intr_write, dev_handle, ep, intf, data, timeout)

    def _out(self, write: Callable[..., int], *arguments: Any) -> int:
        kind, delay_s = self._next()
        timeout = arguments[-1]
        if kind == "lost" or (kind == "late" and delay_s > timeout * 1e-3):
            self._bench.clock.sleep(timeout * 1e-3)
            raise usb.core.USBTimeoutError("Operation timed out", -7, errno.ETIMEDOUT)
        if kind == "late":
            self._bench.clock.sleep(delay_s)
        if kind == "short":  # libusb: a timeout after some bytes were moved
            return len(arguments[3]) // 2
        return write(*arguments)

    def intr_read(self, dev_handle: object, ep: int, intf: int, buff: "array.array[int]", timeout: int) -> int:
        kind, delay_s = self._next()
        if kind == "lost" and self._answers:
            self._answers.popleft()
        if kind == "late" and self._answers:
            self._late.append((self._bench.clock.now() + delay_s, self._answers.popleft()))
        if kind == "twice" and self._answers:
            self._answers.append(self._answers[0])
        if kind == "other":
            self._answers.appendleft(b"\x84\x06\x00\x00\x00")
        if kind == "short" and self._answers:
            self._answers.appendleft(self._answers.popleft()[:1])
        return super().intr_read(dev_handle, ep, intf, buff, timeout)

    def _next(self) -> tuple[str, float]:
        harm = self.plan.get(self.count, ("", 0.0))
        self.count += 1
        assert self.count < 2000, "the driver does not stop talking"
        if harm[0] == "unplugged":
            self.unplug()
        if harm[0] == "error":
            raise usb.core.USBError("Input/output error", -1, errno.EIO)
        return harm


def carry_out(bench: SimulatedBench, mirror: Helios, call: tuple[str, Any]) -> Callable[[], None]:
    """Makes the call; what is returned asserts that it did what it says."""
    word, argument = call
    seen: list[MirrorAngles] = []

    def near(beam: MirrorAngles, angles: MirrorAngles) -> None:
        assert math.hypot(beam.x_rad - angles.x_rad, beam.y_rad - angles.y_rad) < TOLERANCE_RAD

    def all_near() -> None:
        for beam, angles in zip(seen, argument, strict=True):
            near(beam, angles)

    if word == "move":
        mirror.move_to(argument)
        return lambda: near(bench.beam, argument)
    if word == "park":
        mirror.park()
        return lambda: near(bench.beam, MirrorAngles(0.0, 0.0))
    if word == "sequence":
        steps = mirror.own_steps(0.004, 0.02)
        mirror.load_steps(argument, steps)
        mirror.start()
        mirror.play()
        for _ in argument:
            bench.clock.sleep(steps.first_s if not seen else steps.step_s)
            seen.append(bench.beam_at(bench.clock.now() + 0.9 * steps.step_s))
        bench.clock.sleep(2 * steps.step_s)
        mirror.stop()
        return all_near
    bench.clock.sleep(argument)
    mirror.look()
    return lambda: None


@pytest.mark.soak
@settings(max_examples=CASES, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(
    spare_opening=st.booleans(),
    plan=st.dictionaries(st.integers(0, 40), harms, max_size=4),
    script=st.lists(calls, min_size=1, max_size=6),
)
def test_each_call_does_what_it_says_or_raises_a_named_error_in_time(
    dark_bench: Callable[..., SimulatedBench],
    spare_opening: bool,
    plan: dict[int, tuple[str, float]],
    script: list[tuple[str, Any]],
) -> None:
    bench = dark_bench()
    firmware = HeliosFirmware(bench, SETTINGS)
    cable = HarmedPipes(firmware, bench, 0.00025)
    cable.plan = {} if spare_opening else plan
    began_s = bench.clock.now()
    try:
        mirror = Helios.open(SETTINGS, bench.clock, cable, None)
    except DeviceError:
        assert bench.clock.now() - began_s < LONGEST_CALL_S
        assert not cable.held
        return
    if spare_opening:
        cable.count, cable.plan = 0, plan
    waits_s = {"wait": 1.0, "sequence": 45 * 0.03}
    each_call_in_time(bench, script, lambda call: carry_out(bench, mirror, call), LONGEST_CALL_S, waits_s)
    mirror.close()
    assert not firmware.erased
    assert not firmware.shutter_pin
