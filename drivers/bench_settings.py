"""What a bench file says: which instruments, how they are wired, where the wall is, and when the light is shut off."""

from typing import Literal, Self

from pydantic import Field, model_validator

from nlos.configs.settings import Settings
from nlos.drivers.errors import LimitError
from nlos.drivers.galvo.models import MirrorSettings
from nlos.drivers.safety import SafetySettings
from nlos.drivers.simulated.beam import Misalignment
from nlos.drivers.simulated.faults import Fault
from nlos.drivers.simulated.scene import SceneSettings
from nlos.drivers.simulated.servo import ServoSettings
from nlos.drivers.simulated.spad import DetectorSettings
from nlos.drivers.tcspc.models import CounterSettings


class ShutterSettings(Settings):
    """What closes the light: the counter's own output, a TTL output of the mirror controller, or nothing."""

    model: Literal["tcspc488", "triggerscope_ttl", "none"]
    """Which instrument closes the light."""


class AllowedArea(Settings):
    """The part of the wall's plane that the beam may be sent to, in wall coordinates."""

    left_m: float
    """Least x."""
    right_m: float
    """Greatest x."""
    bottom_m: float
    """Least y."""
    top_m: float
    """Greatest y."""

    @model_validator(mode="after")
    def _has_an_inside(self) -> Self:
        if not (self.left_m < self.right_m and self.bottom_m < self.top_m):
            raise ValueError("left_m must lie below right_m, and bottom_m below top_m")
        return self

    def check(self, x_m: float, y_m: float) -> None:
        """Raises `LimitError` outside."""
        if not (self.left_m <= x_m <= self.right_m and self.bottom_m <= y_m <= self.top_m):
            raise LimitError(
                "wall",
                f"x = {x_m:+.3f} m, y = {y_m:+.3f} m lies outside the allowed area ({self.left_m:+g} to "
                f"{self.right_m:+g} m by {self.bottom_m:+g} to {self.top_m:+g} m).",
                "Shrink the wall in the plan, or widen geometry.allowed in the bench file.",
            )


class GeometrySettings(Settings):
    """Where the relay wall is: `wall_distance_m` from the second mirror, straight ahead. Without `allowed` the mirror's
    own limits are all that holds the beam."""

    wall_distance_m: float = Field(gt=0, le=100)
    """From the second mirror to the wall, straight ahead."""
    mirror_separation_m: float = Field(default=0.0, ge=0, le=1)
    """Between the two galvo mirrors."""
    allowed: AllowedArea | None = None
    """The part of the wall's plane that the beam may be sent to; the mirror's limits alone unless given."""


class LaserSettings(Settings):
    """The pulsed laser. `name`, wavelength and power go into the recording; software controls none of them."""

    name: str = ""
    """Goes into the recording."""
    repetition_hz: float = Field(default=10e6, ge=1e3, le=1e9)
    """Pulses a second; the counter's sync rate is checked against it."""
    wavelength_nm: float | None = Field(default=None, gt=0)
    """Goes into the recording."""
    power_mw: float | None = Field(default=None, ge=0)
    """Goes into the recording."""


class SimulationSettings(Settings):
    """What a simulated bench is made of beyond its instruments. Latencies are there and back, on the bench's clock."""

    seed: int = Field(default=0, ge=0)
    """Of every random number of the bench: the same seed gives the same photons."""
    scene: SceneSettings = SceneSettings()
    """What is behind the corner."""
    detector: DetectorSettings = DetectorSettings()
    """The single-photon detector."""
    misalignment: Misalignment = Misalignment()
    """How the real bench differs from the drawing."""
    servo: ServoSettings = ServoSettings()
    """The galvo head that really moves the beam; the mirror's `settle` is what plans it."""
    serial_latency_ms: float = Field(default=1.0, ge=0, le=1000)
    """There and back on the serial cable."""
    usb_latency_ms: float = Field(default=0.25, ge=0, le=1000)
    """There and back on the USB cable."""
    usb_megabytes_per_s: float | None = Field(default=None, gt=0)
    """Throughput of the USB cable; unlimited unless given."""
    faults: tuple[Fault, ...] = ()
    """What goes wrong, see docs/faults.md."""
    witness: str | None = None
    """A file to which the simulated table itself writes every change of shutter and beam, one line each."""


class BenchSettings(Settings):
    """A bench file. The bench is simulated where its instruments' addresses say so: all of them, or none."""

    name: str
    """The bench's name, for people and for its constants."""
    mirror: MirrorSettings
    """The mirror controller: `model`, its port, its head."""
    counter: CounterSettings
    """The photon counter: `model`, its address, its inputs."""
    shutter: ShutterSettings
    """What closes the light."""
    geometry: GeometrySettings
    """Where the wall is."""
    laser: LaserSettings = LaserSettings()
    """The pulsed laser."""
    safety: SafetySettings = SafetySettings()
    """When the light is shut off without anybody asking."""
    simulation: SimulationSettings | None = None
    """What a simulated bench is made of; not for real instruments."""

    @property
    def simulated(self) -> bool:
        return self.mirror.port.startswith("sim://")

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        address = self.counter.usb if self.counter.model == "tcspc488" else self.counter.library
        if self.simulated != (address == "simulated"):
            raise ValueError("one of mirror and counter is simulated and the other is not; they share one clock")
        if self.simulated and self.simulation is None:
            raise ValueError("a simulated bench needs a `simulation` block")
        if not self.simulated and self.simulation is not None:
            raise ValueError("a `simulation` block stands beside real instruments; remove it")
        if self.shutter.model == "tcspc488" and self.counter.model != "tcspc488":
            raise ValueError("shutter tcspc488 is an output of the counter tcspc488, which this bench does not have")
        if self.shutter.model == "triggerscope_ttl" and (
            self.mirror.model != "triggerscope" or self.mirror.shutter_pin is None
        ):
            raise ValueError("shutter triggerscope_ttl needs mirror triggerscope with its shutter_pin")
        return self
