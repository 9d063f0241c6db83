"""An Optotune controller whose input another program left with a gain: its centre is where it is with any."""

from collections.abc import Callable

import pytest

from nlos.drivers.errors import DeviceFault
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.galvo.optotune.mirror import Optotune, OptotuneSettings
from nlos.drivers.simulated.bench import SimulatedBench
from nlos.drivers.simulated.optotune.firmware import OptotuneFirmware
from nlos.drivers.simulated.serial.port import plug, unplug

Dark = Callable[..., SimulatedBench]


def opened(bench: SimulatedBench, gains: tuple[float, float], model: bytes = b"MR-E-2") -> Optotune:
    unplug("gained")
    url = plug("gained", OptotuneFirmware(bench, model=model, gains=gains), bench, 0.001)
    return Optotune.open(OptotuneSettings(model="optotune", port=url), bench.clock)


@pytest.mark.parametrize("model", [b"MR-E-2", b"MR-E-3"])
@pytest.mark.parametrize("gains", [(0.04, 0.01), (1.0, 0.01), (0.04, 1.0), (-1.0, 1.0), (1.0, 1.3)])
def test_a_mirror_that_goes_a_part_of_its_way_is_stopped_at_the_first_far_place(
    dark_bench: Dark, gains: tuple[float, float], model: bytes
) -> None:
    """0.04 and 0.01: as one lab sets an MR-E-2 up for its analog inputs."""
    mirror = opened(dark_bench(), gains, model)
    mirror.move_to(MirrorAngles(0.02, 0.02))  # nearer than what is a fault
    with pytest.raises(DeviceFault, match=r"was sent to x = \+17.19 deg, y = \+14.32 deg optical and is at"):
        mirror.move_to(MirrorAngles(0.3, 0.25))
    with pytest.raises(DeviceFault, match="not known any more"):
        mirror.move_to(MirrorAngles(0.0, 0.0))
    mirror.close()


def test_each_axis_is_looked_at_each_time_that_it_is_twice_as_far_out(dark_bench: Dark) -> None:
    bench, looks = dark_bench(), []
    mirror = opened(bench, (1.0, 1.0))
    look = mirror.measured
    mirror.measured = lambda: looks.append(mirror._target) or look()  # type: ignore[method-assign]
    path = [(0.03, 0.0), (0.1, 0.0), (0.1, 0.1), (0.15, 0.15), (0.3, 0.0), (0.3, 0.15), (0.0, 0.3), (0.3, 0.3)]
    for x_rad, y_rad in 2 * path:
        mirror.move_to(MirrorAngles(x_rad, y_rad))
    mirror.close()
    assert [(each.x_rad, each.y_rad) for each in looks] == [(0.1, 0.0), (0.1, 0.1), (0.3, 0.0), (0.0, 0.3)]
