"""A Time Tagger dates laser pulses back by one period: of a slow laser that has to be known to a billionth."""

from typing import Any

import numpy as np
import pytest

from nlos.drivers.errors import SyncLost
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.simulated.bench import Exposure, Gate, SimulatedBench
from nlos.drivers.simulated.simulation_settings import SimulationSettings
from nlos.drivers.simulated.table import SimulatedTable
from nlos.drivers.simulated.timetagger.package import TimeTaggerPackage
from nlos.drivers.tcspc.counter import HistogramAxis, PointGates
from nlos.drivers.tcspc.timetagger.counter import TimeTagger
from nlos.drivers.tcspc.timetagger.settings import TimeTaggerSettings

ARRIVES_S, PHOTONS = 5.5e-9, 400


def opened(laser_hz: float, mode: str) -> tuple[TimeTagger, SimulatedBench, Any]:
    def light(gate: Gate, beam: MirrorAngles, is_open: bool) -> Exposure:
        counts = np.zeros(gate.bins, np.uint32)
        if (at := int(ARRIVES_S / gate.bin_width_s)) < gate.bins:
            counts[at] = PHOTONS
        return Exposure(counts, gate.dwell_s, round(laser_hz * gate.dwell_s), PHOTONS, False)

    bench = SimulatedBench(light)
    settings = TimeTaggerSettings(model="timetagger", library="simulated", mode=mode)
    package = TimeTaggerPackage(SimulatedTable(bench, SimulationSettings(), laser_hz), settings)
    return TimeTagger.open(settings, bench.clock, package), bench, package


@pytest.mark.parametrize("mode", ["histogram", "list"])
@pytest.mark.parametrize("laser_hz", [99_995.0, 333_335.0, 1_000_705.0, 2.5e6, 10e6])
def test_photons_are_where_they_arrive_however_slow_the_laser(laser_hz: float, mode: str) -> None:
    """Its rate meter counts whole pulses in a tenth of a second: the same photons came up to 1 ns apart from one start
    to the next."""
    counter, bench, _ = opened(laser_hz, mode)
    counter.configure(HistogramAxis(8192, 4e-12))
    simulated_within_s = 4e-12 + max(4e-12, 1 / laser_hz / 32_000)
    places = set()
    for pause_s in (0.0013, 0.0047, 0.0091, 0.0002):
        bench.clock.sleep(pause_s)
        counter.arm(PointGates([8e-3], [0]))
        counter.trigger()
        counter.wait_points(1, 2.0)
        (seen,) = counter.read(0, 1)
        (at,) = np.flatnonzero(seen.counts)
        assert abs(at * 4e-12 - ARRIVES_S) <= simulated_within_s
        places.add(int(at))
        assert seen.counts[at] == PHOTONS
        assert seen.sync_count == pytest.approx(laser_hz * 8e-3, abs=1)
    assert len(places) == 1


def test_a_slow_laser_whose_pulses_come_irregularly_is_no_clock() -> None:
    counter, _, package = opened(200e3, "histogram")
    counter.configure(HistogramAxis(8192, 4e-12))
    package._panel.period_ps = round(package._panel.period_ps * 1.01)  # what its meter says is of other pulses
    with pytest.raises(SyncLost, match=r"200000 Hz by count and 1980\d\d Hz by the times of its pulses"):
        counter.arm(PointGates([8e-3], [0]))
