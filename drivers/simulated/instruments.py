"""The instruments that a simulated bench's file names, plugged into simulated cables around one bench."""

import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nlos.drivers.bench_settings import BenchSettings, SimulationSettings
from nlos.drivers.simulated.beam import BeamPath
from nlos.drivers.simulated.bench import Light, SimulatedBench
from nlos.drivers.simulated.faults import FaultPlan
from nlos.drivers.simulated.optotune.firmware import OptotuneFirmware
from nlos.drivers.simulated.picoquant.library import PicoquantLibrary
from nlos.drivers.simulated.recorded import RecordedLight, RecordedScan
from nlos.drivers.simulated.scene import SceneLight
from nlos.drivers.simulated.serial.cable import SerialFirmware
from nlos.drivers.simulated.serial.port import plug, unplug
from nlos.drivers.simulated.tcspc488.firmware import Tcspc488Firmware
from nlos.drivers.simulated.triggerscope.firmware import TriggerScopeFirmware
from nlos.drivers.simulated.usb.backend import SimulatedUsb

FIRMWARES: dict[str, Callable[[SimulatedBench, Any], SerialFirmware]] = {
    "triggerscope": TriggerScopeFirmware.matching,
    "optotune": OptotuneFirmware.matching,
}
"""Mirror model -> its simulated controller."""


@dataclass(frozen=True)
class PluggedIn:
    """The bench around which everything is simulated, and what replaces libusb or the vendor's library."""

    bench: SimulatedBench
    backend: SimulatedUsb | PicoquantLibrary


@contextmanager
def plug_in(settings: BenchSettings, scene: RecordedScan | None = None) -> Iterator[PluggedIn]:
    """Builds light, bench and firmwares, and plugs them in until the block is left."""
    simulation = settings.simulation
    if simulation is None:
        raise ValueError("the bench file has no simulation block")
    bench = SimulatedBench(light_of(settings, scene), faults=FaultPlan(simulation.faults), servo=simulation.servo)
    name = settings.mirror.port.removeprefix("sim://")
    firmware = FIRMWARES[settings.mirror.model](bench, settings.mirror)
    with ExitStack() as stack:
        if simulation.witness is not None:
            bench.witness = _written_to(Path(simulation.witness), stack)
        plug(name, firmware, bench, simulation.serial_latency_ms * 1e-3)
        stack.callback(unplug, name)
        yield PluggedIn(bench, _counter(settings, simulation, bench))


def _written_to(path: Path, stack: ExitStack) -> Callable[[float, str], None]:
    """A line a change: a signal handler that shuts the light writes between lines, never within one."""
    log = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    stack.callback(os.close, log)

    def witness(when_s: float, what: str) -> None:
        os.write(log, f"{when_s:.6f} {what}\n".encode())

    return witness


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
