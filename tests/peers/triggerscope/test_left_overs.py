"""The driver against the compiled sketches, from open to close, whatever another program left in them."""

import math
from collections.abc import Callable

import pytest

from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.galvo.triggerscope.mirror import TriggerScope, TriggerScopeSettings
from nlos.drivers.simulated.bench import SimulatedBench
from nlos.drivers.simulated.serial.port import plug, plugged, unplug
from nlos.drivers.simulated.triggerscope.firmware import V4, V4B, TriggerScopeFirmware
from nlos.drivers.simulated.triggerscope.left_overs import HALF_LINES, LEFT_OVERS
from nlos.drivers.simulated.triggerscope.wiring import Wiring
from tests.drivers.output_watch import OutputWatch

BOARDS = {"TriggerScope_V4B": V4B, "TriggerScope_V4": V4, "TriggerScope_620MM": V4B, "TriggerScope_612MM": V4}
ON_FALLING_EDGES = {"opens_on_falling_edges", "axes_step_on_falling_edges"}
"""What v.612 does otherwise than the simulated controller: it puts out nothing as such stepping begins."""
SHUTTER = 9
LIMIT_DEG = 10.0
ROUND_TRIP_S = 0.001
PATH = [MirrorAngles(0.1, -0.05), MirrorAngles(-0.2, 0.15), MirrorAngles(0.0, 0.1)]


def scan(bench: SimulatedBench, mirror: TriggerScope, watch: OutputWatch, edges: int) -> None:
    mirror.move_to(PATH[-1])
    mirror.load(PATH)
    mirror.start()
    watch.scanning = True
    mirror.set_shutter_line(True)
    for angles in PATH[:edges]:
        bench.edge("pixel_clock", bench.clock.now())
        bench.clock.sleep(0.02)
        assert math.hypot(bench.beam.x_rad - angles.x_rad, bench.beam.y_rad - angles.y_rad) < 1e-4


def live(firmware: object, bench: SimulatedBench, watch: OutputWatch, state: str, line: str | None) -> None:
    """Left-over state, open, scan, park, kill, and once more; then the clock ticks on after it is closed for good."""
    unplug("peer")
    url = plug("peer", firmware, bench, ROUND_TRIP_S)
    settings = TriggerScopeSettings(
        model="triggerscope", port=url, shutter_pin=SHUTTER, max_mechanical_deg=LIMIT_DEG, allow_unverified_dac=True
    )
    bench.clock.sleep(1.0)
    for killed in (True, True, False):
        for command in LEFT_OVERS[state]:
            firmware.receive(command + b"\n", bench.clock.now())
        firmware.receive(HALF_LINES[line] if line else b"", bench.clock.now())
        watch.ours = True
        mirror = TriggerScope.open(settings, bench.clock)
        assert not bench.shutter_open
        assert not watch.is_beyond
        scan(bench, mirror, watch, len(PATH))
        mirror.set_shutter_line(False)
        watch.scanning = False
        mirror.stop()
        bench.edge("pixel_clock", bench.clock.now())
        mirror.park()
        if killed:
            scan(bench, mirror, watch, 2)
            plugged("peer").close()
            watch.ours = watch.scanning = False
        else:
            mirror.close()
    for _ in range(3):
        bench.clock.sleep(0.01)
        bench.edge("pixel_clock", bench.clock.now())


@pytest.mark.parametrize("line", [None, *HALF_LINES])
@pytest.mark.parametrize("state", LEFT_OVERS)
@pytest.mark.parametrize("name", BOARDS)
def test_from_open_to_close_dark_and_within_limits_and_every_code_and_pin_as_simulated(
    sketch: Callable[..., object], dark_bench: Callable[[], SimulatedBench], name: str, state: str, line: str | None
) -> None:
    watches = []
    for real in (True, False):
        bench = dark_bench()
        wiring = Wiring(bench, shutter_pin=SHUTTER)
        firmware = sketch(name, bench, wiring) if real else TriggerScopeFirmware(bench, wiring, board=BOARDS[name])
        watches.append(OutputWatch(wiring, SHUTTER, LIMIT_DEG * 0.5 * 1.001))
        live(firmware, bench, watches[-1], state, line)
    for watch in watches:
        assert watch.light == 0
        assert watch.left_limits_lit == 0
        assert watch.longest_s <= 1.5 * ROUND_TRIP_S
    assert len(watches[0].events) > 100
    if name != "TriggerScope_612MM" or state not in ON_FALLING_EDGES:
        assert watches[1].events == watches[0].events


def test_without_its_card_it_confirms_everything_and_puts_nothing_out(
    sketch: Callable[..., object], dark_bench: Callable[[], SimulatedBench]
) -> None:
    bench = dark_bench()
    wiring = Wiring(bench)
    firmware = sketch("TriggerScope_V4B", bench, wiring, sd_card=False)
    watch = OutputWatch(wiring, SHUTTER, 10.0)
    assert firmware.opened() == b""
    assert firmware.receive(b"SAR1-4\n", 0.0) == b"!SAR1-4\r\n"
    assert firmware.receive(b"SAO1-0\n", 0.0) == b"!SAO1-0\r\n"
    assert watch.events == []
