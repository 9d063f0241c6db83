"""The inside of a counter in T3 mode, where a signal broke into the passing of its time: it comes up to now at once."""

import numpy as np

from nlos.drivers.clock import VirtualClock
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.simulated.bench import Exposure, Gate, SimulatedBench
from nlos.drivers.simulated.t3_instrument import T3Instrument
from nlos.drivers.tcspc.t3 import GENERIC

PERIOD_S = 0.02


def test_a_step_that_nobody_recorded_costs_a_few_slices_not_thousands() -> None:
    """Shutting the light from a signal handler lets the mirror step while the counter is in the middle of a period."""
    clock, exposed = VirtualClock(), []

    def light(gate: Gate, beam: MirrorAngles, is_open: bool) -> Exposure:
        exposed.append((beam, gate.dwell_s))
        return Exposure(np.zeros(gate.bins, np.uint32), gate.dwell_s, 0, 0, False)

    bench = SimulatedBench(light, clock=clock)
    counter = T3Instrument(bench, GENERIC, 10e6, seed=1)
    counter.start(clock.now(), clock.now() + 1.0, 32e-12)
    counter.set_clock(round(PERIOD_S / 100e-9), clock.now())
    counter.advance(clock.now())
    for k in (1, 2):
        bench.steer(MirrorAngles(0.01 * k, 0.0), clock.now() + (k - 0.5) * PERIOD_S / 2, 1e-3)
    clock.sleep(PERIOD_S)
    counter.advance(clock.now())
    assert len(exposed) < 60
    assert exposed[-1][0] == MirrorAngles(0.02, 0.0)
