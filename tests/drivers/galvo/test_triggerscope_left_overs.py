"""Whatever another program left in a TriggerScope: dark without a scan, and no axis beyond its limits."""

import math
import os
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable
from dataclasses import dataclass

import pytest

from nlos.drivers.clock import SystemClock
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.galvo.triggerscope.mirror import TriggerScope, TriggerScopeSettings
from nlos.drivers.simulated.bench import SimulatedBench
from nlos.drivers.simulated.faults import Fault
from nlos.drivers.simulated.serial.port import plug, plugged, unplug
from nlos.drivers.simulated.triggerscope.firmware import V4B, WAVES, TriggerScopeFirmware
from nlos.drivers.simulated.triggerscope.left_overs import HALF_LINES, LEFT_OVERS
from nlos.drivers.simulated.triggerscope.wiring import Wiring
from tests.drivers.output_watch import OutputWatch

SHUTTER = 9
PATH = [MirrorAngles(0.1, -0.05), MirrorAngles(-0.2, 0.15), MirrorAngles(0.0, 0.1)]
LIMIT_DEG = 10.0
ROUND_TRIP_S = 0.001


@dataclass
class Lab:
    bench: SimulatedBench
    firmware: TriggerScopeFirmware
    watch: OutputWatch

    def leave(self, state: str, line: str | None) -> None:
        """Another program sets a state and is killed in the middle of a line."""
        for command in LEFT_OVERS[state]:
            self.firmware.receive(command + b"\n", self.bench.clock.now())
        self.firmware.receive(HALF_LINES[line] if line else b"", self.bench.clock.now())


@pytest.fixture
def lab(dark_bench: Callable[..., SimulatedBench]) -> Callable[..., Lab]:
    def make(*faults: Fault, board: bytes = V4B) -> Lab:
        bench = dark_bench(*faults)
        wiring = Wiring(bench, shutter_pin=SHUTTER)
        firmware = TriggerScopeFirmware(bench, wiring, board=board)
        unplug("left")
        plug("left", firmware, bench, ROUND_TRIP_S)
        return Lab(bench, firmware, OutputWatch(wiring, SHUTTER, LIMIT_DEG * 0.5 * 1.001))

    return make


def open_mirror(this: Lab) -> TriggerScope:
    settings = TriggerScopeSettings(
        model="triggerscope",
        port="sim://left",
        shutter_pin=SHUTTER,
        max_mechanical_deg=LIMIT_DEG,
        allow_unverified_dac=True,  # only the first program after power-up sees a banner
    )
    this.watch.ours = True
    mirror = TriggerScope.open(settings, this.bench.clock)
    assert not this.bench.shutter_open
    assert not this.watch.is_beyond
    for dac in (1, 2):
        assert this.firmware._dacs[dac].value == 32767
    return mirror


def begin_scan(this: Lab, mirror: TriggerScope, edges: int) -> None:
    """Loads, opens the shutter, and takes some of the steps."""
    mirror.load(PATH)
    mirror.start()
    this.watch.scanning = True
    mirror.set_shutter_line(True)
    for angles in PATH[:edges]:
        this.bench.edge("pixel_clock", this.bench.clock.now())
        this.bench.clock.sleep(0.02)
        assert math.hypot(this.bench.beam.x_rad - angles.x_rad, this.bench.beam.y_rad - angles.y_rad) < 1e-4


def end_scan(this: Lab, mirror: TriggerScope) -> None:
    mirror.set_shutter_line(False)
    this.watch.scanning = False
    mirror.stop()
    for _ in range(3):  # the clock may tick on
        this.bench.edge("pixel_clock", this.bench.clock.now())
    mirror.park()


def kill(this: Lab) -> None:
    """The program is gone from one moment to the next: its port closes, nothing else happens to the controller."""
    plugged("left").close()
    this.watch.ours = this.watch.scanning = False


@pytest.mark.parametrize("line", [None, *HALF_LINES])
@pytest.mark.parametrize("state", LEFT_OVERS)
def test_open_scan_park_kill_reopen_after_any_left_over(lab: Callable[..., Lab], state: str, line: str | None) -> None:
    this = lab()
    this.bench.clock.sleep(1.0)
    for _ in range(2):
        this.leave(state, line)
        mirror = open_mirror(this)
        begin_scan(this, mirror, len(PATH))
        end_scan(this, mirror)
        begin_scan(this, mirror, 2)
        kill(this)
    mirror = open_mirror(this)
    end_scan(this, mirror)
    mirror.close()
    assert this.watch.light == 0
    assert this.watch.left_limits_lit == 0
    assert this.watch.longest_s <= 1.5 * ROUND_TRIP_S, (
        "one axis stands at code 0 while the other's range is set, no longer"
    )


@pytest.mark.parametrize(
    "fault",
    [
        *(Fault(name="A8", parameters={"state": state}) for state in LEFT_OVERS),
        *(Fault(name="A9", parameters={"line": line}) for line in HALF_LINES),
    ],
    ids=lambda fault: fault.parameters.get("state") or fault.parameters["line"],
)
def test_left_overs_are_faults_by_name(lab: Callable[..., Lab], fault: Fault) -> None:
    this = lab(fault)
    mirror = open_mirror(this)
    begin_scan(this, mirror, len(PATH))
    end_scan(this, mirror)


CHILD = """
    import sys, time
    from nlos.drivers.clock import SystemClock
    from nlos.drivers.galvo.mirror import MirrorAngles
    from nlos.drivers.galvo.triggerscope.mirror import TriggerScope, TriggerScopeSettings

    settings = TriggerScopeSettings(
        model="triggerscope", port=sys.argv[1], shutter_pin=9, allow_unverified_dac=True, banner_timeout_s=0.3
    )
    mirror = TriggerScope.open(settings, SystemClock())
    mirror.load([MirrorAngles(0.1, -0.05), MirrorAngles(-0.2, 0.15)])
    mirror.start()
    mirror.set_shutter_line(True)
    print("lit", flush=True)
    if sys.argv[2] == "half":
        mirror._controller._line.write(b"SDO1-255")
    time.sleep(60)
"""


@pytest.mark.skipif(os.name != "posix", reason="pseudo-terminals and SIGKILL are POSIX")
@pytest.mark.parametrize("line", ["whole", "half"])
def test_a_program_killed_while_it_scans_is_followed_by_one_that_finds_it_dark(
    dark_bench: Callable[..., SimulatedBench], line: str
) -> None:
    """A real port, and a real SIGKILL."""
    from nlos.drivers.simulated.serial.pty import served_on_pty

    bench = dark_bench()
    firmware = TriggerScopeFirmware(bench, Wiring(bench, shutter_pin=SHUTTER))
    with served_on_pty(firmware, bench) as path:
        command = [sys.executable, "-c", textwrap.dedent(CHILD), path, line]
        with subprocess.Popen(command, stdout=subprocess.PIPE) as child:
            assert child.stdout is not None
            assert child.stdout.readline() == b"lit\n"
            time.sleep(0.2)
            os.kill(child.pid, signal.SIGKILL)
        assert bench.shutter_open  # nothing on a TTL output closes it by itself
        time.sleep(0.5)
        pins: list[tuple[int, int]] = []
        firmware.wiring.log = lambda when_s, what, number, value: (
            pins.append((number, value)) if what == "pin" else None
        )
        settings = TriggerScopeSettings(
            model="triggerscope", port=path, shutter_pin=9, allow_unverified_dac=True, banner_timeout_s=0.3
        )
        mirror = TriggerScope.open(settings, SystemClock())
        assert not bench.shutter_open
        bench.edge("pixel_clock", bench.clock.now())
        mirror.park()
        mirror.close()
        assert pins == [(SHUTTER, 0)]


def test_a_wave_that_was_left_behind_is_not_played_in_place_of_the_points(lab: Callable[..., Lab]) -> None:
    """V.622-MM forgets it with no other command: its markers would count on while the beam swings to full scale."""
    this = lab(board=WAVES)
    for dac in (b"1", b"2"):
        this.firmware.receive(b"WAV%b-32767-32767-180-0\n" % dac, this.bench.clock.now())
    mirror = open_mirror(this)
    begin_scan(this, mirror, len(PATH))
    end_scan(this, mirror)
    assert this.watch.left_limits_lit == 0
    mirror.close()
