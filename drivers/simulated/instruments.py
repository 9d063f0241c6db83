"""The instruments that a simulated bench's file names, plugged into simulated cables around one bench."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from drivers.bench_settings import BenchSettings, SimulationSettings
from drivers.simulated.beam import BeamPath
from drivers.simulated.bench import Light, SimulatedBench
from drivers.simulated.faults import FaultPlan
from drivers.simulated.optotune_firmware import OptotuneFirmware
from drivers.simulated.picoquant_library import PicoquantLibrary
from drivers.simulated.recorded import RecordedLight, RecordedScan
from drivers.simulated.scene import SceneLight
from drivers.simulated.serial_cable import SerialFirmware
from drivers.simulated.serial_port import plug, unplug
from drivers.simulated.tcspc488_firmware import Tcspc488Firmware
from drivers.simulated.triggerscope_firmware import TriggerScopeFirmware
from drivers.simulated.usb_backend import SimulatedUsb

FIRMWARES: dict[str, Callable[[SimulatedBench, Any], SerialFirmware]] = {
    "triggerscope": TriggerScopeFirmware.matching,
    "optotune": OptotuneFirmware.matching,
}
"""Mirror model -> its simulated controller."""


@dataclass(frozen=True)
class PluggedIn:
    """The bench around which everything is simulated, and what stands in for libusb or the vendor's library."""

    bench: SimulatedBench
    backend: SimulatedUsb | PicoquantLibrary


@contextmanager
def plug_in(settings: BenchSettings, scene: RecordedScan | None = None) -> Iterator[PluggedIn]:
    """Builds light, bench and firmwares, and plugs them in until the block is left."""
    simulation = settings.simulation
    if simulation is None:
        raise ValueError("the bench file has no simulation block")
    bench = SimulatedBench(light_of(settings, scene), faults=FaultPlan(simulation.faults))
    name = settings.mirror.port.removeprefix("sim://")
    firmware = FIRMWARES[settings.mirror.model](bench, settings.mirror)
    plug(name, firmware, bench, simulation.serial_latency_ms * 1e-3)
    try:
        yield PluggedIn(bench, _counter(settings, simulation, bench))
    finally:
        unplug(name)


def _counter(
    settings: BenchSettings, simulation: SimulationSettings, bench: SimulatedBench
) -> SimulatedUsb | PicoquantLibrary:
    if settings.counter.model == "picoquant":
        return PicoquantLibrary(bench, settings.counter.device, settings.laser.repetition_hz, simulation.seed)
    rate = simulation.usb_megabytes_per_s
    return SimulatedUsb(
        [Tcspc488Firmware(bench)], bench.clock, simulation.usb_latency_ms * 1e-3, rate * 1e6 if rate else float("inf")
    )


def light_of(settings: BenchSettings, scene: RecordedScan | None = None) -> Light:
    """What the bench's detector sees: the scene of its file, or a recorded scan. The geometry is the true one."""
    simulation = settings.simulation
    if simulation is None:
        raise ValueError("the bench file has no simulation block")
    path = BeamPath(settings.geometry.wall_distance_m, settings.geometry.mirror_separation_m, simulation.misalignment)
    repetition_hz = settings.laser.repetition_hz
    if scene is not None:
        return RecordedLight(scene, path, repetition_hz, simulation.seed)
    return SceneLight(simulation.scene, simulation.detector, path, repetition_hz, simulation.seed)
