"""The instruments that a simulated bench's file names, plugged into simulated cables around one bench."""

import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nlos.drivers.bench_settings import BenchSettings
from nlos.drivers.clock import VirtualClock
from nlos.drivers.device_model import DeviceModel
from nlos.drivers.device_settings import DeviceSettings
from nlos.drivers.galvo.known_mirrors import MIRRORS
from nlos.drivers.simulated.beam import BeamPath, Misalignment
from nlos.drivers.simulated.bench import Light, SimulatedBench
from nlos.drivers.simulated.faults import FaultPlan
from nlos.drivers.simulated.recorded import RecordedLight, RecordedScan
from nlos.drivers.simulated.scene import SceneLight
from nlos.drivers.simulated.serial.port import plugged_in
from nlos.drivers.simulated.table import SimulatedTable
from nlos.drivers.simulated.usb.backend import SimulatedUsb
from nlos.drivers.simulated.usb.pipes import SimulatedPipes
from nlos.drivers.tcspc.known_counters import COUNTERS


@dataclass(frozen=True)
class PluggedIn:
    """The bench around which everything is simulated, and what replaces libusb or a vendor's library at counter and
    mirror; None where that one is on a serial cable."""

    bench: SimulatedBench
    counter: Any
    mirror: Any


@contextmanager
def plug_in(
    settings: BenchSettings, scene: RecordedScan | None = None, clock: VirtualClock | None = None
) -> Iterator[PluggedIn]:
    """Builds light, bench and firmwares, and plugs them in until the block is left. `clock`: a virtual one by default,
    which runs ahead of the computer's."""
    simulation = settings.simulation
    if simulation is None:
        raise ValueError("the bench file has no simulation block")
    light, faults = light_of(settings, scene), FaultPlan(simulation.faults)
    bench = SimulatedBench(light, clock, faults, simulation.servo, settings.shutter.model == "none")
    table = SimulatedTable(bench, simulation, settings.laser.repetition_hz)
    with ExitStack() as stack:
        if simulation.witness is not None:
            bench.witness = _written_to(Path(simulation.witness), stack)
        mirror = far_end(MIRRORS[settings.mirror.model], settings.mirror, table, stack)
        counter = far_end(COUNTERS[settings.counter.model], settings.counter, table, stack)
        yield PluggedIn(bench, counter, mirror)


def far_end(model: DeviceModel[Any], settings: DeviceSettings, table: SimulatedTable, stack: ExitStack) -> Any:
    """Plugs a model's firmware into its cable until `stack` is left; what its driver then takes as `backend`."""
    bench, simulation = table.bench, table.simulation
    firmware = model.firmware(settings, table)
    if settings.cable == "library":
        return firmware
    if settings.cable == "usb" and isinstance(firmware, SimulatedPipes):
        return firmware
    if settings.cable == "usb":
        rate = simulation.usb_megabytes_per_s
        bytes_per_s = rate * 1e6 if rate else float("inf")
        return SimulatedUsb([firmware], bench.clock, simulation.usb_latency_ms * 1e-3, bytes_per_s)
    name = settings.address.removeprefix("sim://")
    stack.enter_context(plugged_in(name, firmware, bench, simulation.serial_latency_ms * 1e-3))
    return None


def _written_to(path: Path, stack: ExitStack) -> Callable[[float, str], None]:
    """A line a change: a signal handler that shuts the light writes between lines, never within one."""
    log = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    stack.callback(os.close, log)

    def witness(when_s: float, what: str) -> None:
        os.write(log, f"{when_s:.6f} {what}\n".encode())

    return witness


def true_path(settings: BenchSettings, misalignment: Misalignment) -> BeamPath:
    """The beam's real way: as drawn, but for what is out of place."""
    drawn = settings.geometry
    unsaid = {
        key: getattr(drawn, key)
        for key in ("scanner_x_m", "scanner_y_m", "wall_pitch_deg", "wall_yaw_deg")
        if getattr(misalignment, key) is None
    }
    return BeamPath(drawn.wall_distance_m, drawn.mirror_separation_m, misalignment.model_copy(update=unsaid))


def light_of(settings: BenchSettings, scene: RecordedScan | None = None) -> Light:
    """What the bench's detector sees: the scene of its file, or a recorded scan. The geometry is the true one."""
    simulation = settings.simulation
    if simulation is None:
        raise ValueError("the bench file has no simulation block")
    path = true_path(settings, simulation.misalignment)
    repetition_hz = settings.laser.repetition_hz
    if scene is not None:
        return RecordedLight(scene, path, repetition_hz, simulation.seed)
    return SceneLight(simulation.scene, simulation.detector, path, repetition_hz, simulation.seed)
