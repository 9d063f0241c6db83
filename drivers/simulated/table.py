"""What a simulated device is plugged into: the one bench, and what the bench file says of it."""

from dataclasses import dataclass

from nlos.drivers.simulated.bench import SimulatedBench
from nlos.drivers.simulated.simulation_settings import SimulationSettings


@dataclass(frozen=True)
class SimulatedTable:
    """`repetition_hz`: the laser's, which reaches the counter's sync input."""

    bench: SimulatedBench
    simulation: SimulationSettings
    repetition_hz: float
