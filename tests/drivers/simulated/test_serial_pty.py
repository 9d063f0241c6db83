"""Drivers talk to simulated controllers through a real serial port of the operating system."""

import math
import os
import subprocess
import sys
import time
from collections.abc import Callable

import pytest

from nlos.drivers.clock import SystemClock
from nlos.drivers.errors import DeviceBusy, DeviceLost
from nlos.drivers.galvo.known_mirrors import MIRRORS, open_mirror
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.galvo.triggerscope.mirror import TriggerScopeSettings
from nlos.drivers.simulated.bench import SimulatedBench
from nlos.drivers.simulated.simulation_settings import SimulationSettings
from nlos.drivers.simulated.table import SimulatedTable

pytestmark = pytest.mark.skipif(os.name != "posix", reason="pseudo-terminals are POSIX")

if os.name == "posix":
    from nlos.drivers.simulated.serial.pty import served_on_pty

ASIDE = MirrorAngles(0.1, -0.05)
SERIAL = [name for name, model in MIRRORS.items() if model.settings.cable == "serial"]


@pytest.mark.parametrize("model", sorted(SERIAL))
def test_a_mirror_moves_through_a_real_port_and_is_lost_with_it(
    dark_bench: Callable[..., SimulatedBench], model: str
) -> None:
    bench = dark_bench()
    kind = MIRRORS[model].settings
    offline = kind(model=model, port="sim://none")
    firmware = MIRRORS[model].firmware(offline, SimulatedTable(bench, SimulationSettings(), 10e6))
    with served_on_pty(firmware, bench) as path:
        settings = kind(model=model, port=path)
        mirror = open_mirror(settings, SystemClock())
        mirror.move_to(ASIDE)
        beam = bench.beam_at(bench.clock.now() + 1.0)  # its clock stands still until the port is used
        assert math.hypot(beam.x_rad - ASIDE.x_rad, beam.y_rad - ASIDE.y_rad) < 5e-5
        with pytest.raises(DeviceBusy, match="another program"):
            open_mirror(settings, SystemClock())
        mirror.close()
        time.sleep(0.5)  # a host that leaves is noticed by looking
        mirror = open_mirror(settings, SystemClock())
    with pytest.raises(DeviceLost, match="went away"):
        mirror.park()
    mirror.close()
    mirror.close()


def test_it_is_served_to_any_program_from_the_command_line() -> None:
    command = [sys.executable, "-m", "nlos.drivers.simulated.serial.pty", "triggerscope"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as served:
        try:
            assert served.stdout is not None
            path = served.stdout.readline().strip()
            mirror = open_mirror(TriggerScopeSettings(model="triggerscope", port=path), SystemClock())
            assert mirror.identity.product.startswith("TriggerScope")
            mirror.close()
        finally:
            served.terminate()
