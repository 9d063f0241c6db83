"""The `simulation` block of a bench file."""

from pydantic import Field

from nlos.configs.settings import Settings
from nlos.drivers.simulated.beam import Misalignment
from nlos.drivers.simulated.faults import Fault
from nlos.drivers.simulated.scene import SceneSettings
from nlos.drivers.simulated.servo import ServoSettings
from nlos.drivers.simulated.spad import DetectorSettings


class SimulationSettings(Settings):
    """What a simulated bench is made of beyond its instruments. Latencies are there and back, on the bench's clock."""

    seed: int = Field(default=0, ge=0)
    """Of every random number of the bench: the same seed gives the same photons."""
    scene: SceneSettings = SceneSettings()
    """What is behind the corner."""
    detector: DetectorSettings = DetectorSettings()
    """The single-photon detector."""
    misalignment: Misalignment = Misalignment()
    """How the simulated bench differs from what the bench file says."""
    servo: ServoSettings = ServoSettings()
    """The galvo head that really moves the beam; the mirror's `settle` is what plans it."""
    serial_latency_ms: float = Field(default=1.0, ge=0, le=1000)
    """There and back on the serial cable."""
    usb_latency_ms: float = Field(default=0.25, ge=0, le=1000)
    """There and back on the USB cable."""
    usb_megabytes_per_s: float | None = Field(default=None, gt=0)
    """Throughput of the USB cable; unlimited unless given."""
    faults: tuple[Fault, ...] = ()
    """What goes wrong, each by its name."""
    witness: str | None = None
    """A file to which the simulated table itself writes every change of shutter and beam, one line each."""
