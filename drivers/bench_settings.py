"""What a bench file says: which instruments, how they are wired, where the wall is, and when the light is shut off."""

from typing import TYPE_CHECKING, Literal, Self

import numpy as np
import numpy.typing as npt
from pydantic import ConfigDict, Field, field_validator, model_validator

from nlos.configs.settings import Settings
from nlos.drivers.alignment_settings import AlignmentSettings
from nlos.drivers.arm_settings import ArmSettings
from nlos.drivers.errors import LimitError
from nlos.drivers.first_light_settings import FirstLightSettings
from nlos.drivers.galvo.known_mirrors import MIRRORS, MirrorSettings
from nlos.drivers.run_defaults import RunDefaults
from nlos.drivers.safety_settings import SafetySettings
from nlos.drivers.simulated.fault_catalogue import refusal
from nlos.drivers.simulated.simulation_settings import SimulationSettings
from nlos.drivers.tcspc.known_counters import COUNTERS, CounterSettings

if TYPE_CHECKING:
    ShutterWord = str
else:
    ShutterWord = Literal[
        *(word for models in (COUNTERS, MIRRORS) for each in models.values() for word in each.shutters), "none"
    ]


class ShutterSettings(Settings):
    """What closes the light: the counter's own output, a TTL output of the mirror controller, or nothing."""

    model: ShutterWord
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

    def __str__(self) -> str:
        return f"x {self.left_m:+g} to {self.right_m:+g} m, y {self.bottom_m:+g} to {self.top_m:+g} m"

    def holds(self, x_m: npt.NDArray[np.float64], y_m: npt.NDArray[np.float64]) -> npt.NDArray[np.bool_]:
        """Which of these places, of any shape, lie in it."""
        return (self.left_m <= x_m) & (x_m <= self.right_m) & (self.bottom_m <= y_m) & (y_m <= self.top_m)

    def check(self, x_m: float, y_m: float) -> None:
        """Raises `LimitError` outside."""
        if not self.holds(np.array(x_m), np.array(y_m)):
            raise LimitError(
                "wall",
                f"x = {x_m:+.3f} m, y = {y_m:+.3f} m lies outside the allowed area ({self.left_m:+g} to "
                f"{self.right_m:+g} m by {self.bottom_m:+g} to {self.top_m:+g} m).",
                "Shrink the wall in the plan, aim nearer to its middle, or widen geometry.allowed in the bench file.",
            )


class GeometrySettings(Settings):
    """Where the relay wall is: `wall_distance_m` from the second mirror, straight ahead, and where the scanner stands
    before it. Without `allowed` the mirror's own limits are all that holds the beam."""

    wall_distance_m: float = Field(gt=0, le=100)
    """From the second mirror to the wall, straight ahead."""
    mirror_separation_m: float = Field(default=0.0, ge=0, le=1)
    """Between the two galvo mirrors."""
    scanner_x_m: float = Field(default=0.0, ge=-100, le=100)
    """How far the scanner is to the right of the wall's centre, where wall coordinates begin."""
    scanner_y_m: float = Field(default=0.0, ge=-100, le=100)
    """How far the scanner is above the wall's centre."""
    wall_pitch_deg: float = Field(default=0.0, gt=-60, lt=60)
    """The wall's top edge leans away from the scanner by this angle."""
    wall_yaw_deg: float = Field(default=0.0, gt=-60, lt=60)
    """The wall's right edge swings away from the scanner by this angle."""
    allowed: AllowedArea | None = None
    """The part of the wall's plane that the beam may be sent to; the mirror's limits alone unless given."""


class LaserSettings(Settings):
    """The pulsed laser. `name`, wavelength and power go into the recording; software controls none of them."""

    name: str = ""
    """Goes into the recording."""
    repetition_hz: float = Field(default=10e6, ge=1e3, le=1e9)
    """Pulses per second; the counter's sync rate is checked against it."""
    wavelength_nm: float | None = Field(default=None, gt=0)
    """Goes into the recording."""
    power_mw: float | None = Field(default=None, ge=0)
    """Goes into the recording."""


class LightSettings(Settings):
    """What of a bench file has to be right for the light to be shut off: whatever else is wrong in it."""

    model_config = ConfigDict(extra="ignore")

    mirror: MirrorSettings
    counter: CounterSettings
    shutter: ShutterSettings

    @property
    def simulated(self) -> bool:
        """As of a whole bench."""
        return self.mirror.simulated

    @property
    def shutter_on(self) -> Literal["mirror", "counter", "nothing"]:
        """Which instrument's output closes the light."""
        return _shutter_on(self.mirror, self.counter, self.shutter)


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
    first_light: FirstLightSettings | None = None
    """What `nlos calibrate --first-light` found."""
    runs: RunDefaults = RunDefaults()
    """What applies to every run: operator, tags, data folder, who is told at the end."""
    alignment: AlignmentSettings = AlignmentSettings()
    """How much light there is while somebody aims by hand."""
    arm: ArmSettings | None = None
    """What has to happen before the first light."""
    simulation: SimulationSettings | None = None
    """What a simulated bench is made of; not for real instruments."""

    @field_validator("simulation")
    @classmethod
    def _faults_are_known(cls, simulation: SimulationSettings | None) -> SimulationSettings | None:
        """Here and not where a fault is described, because models bring their own."""
        refused = filter(None, map(refusal, simulation.faults if simulation else ()))
        if (first := next(refused, None)) is not None:
            raise ValueError(first)
        return simulation

    @property
    def simulated(self) -> bool:
        """Whether its instruments are simulated: all of them, or none."""
        return self.mirror.simulated

    @property
    def arming(self) -> ArmSettings | None:
        """What has to happen before light; None on a simulated bench that does not ask for a rehearsal of it."""
        return self.arm or (None if self.simulated else ArmSettings())

    def foreign_first_light(self, counter: str = "") -> str:
        """What to say of a `first_light` block that is another bench's; empty where it is this one's. `counter`: model
        and serial number, where it was asked."""
        why = "" if self.first_light is None else self.first_light.of_another(self.name, self.simulated, counter)
        return why and f"the bench file's first_light is not used: {why}. Run `nlos calibrate --first-light` here"

    def with_own_first_light(self, counter: str = "") -> Self:
        """This bench without what was measured on another one."""
        return self.model_copy(update={"first_light": None}) if self.foreign_first_light(counter) else self

    @property
    def shutter_on(self) -> Literal["mirror", "counter", "nothing"]:
        """Which instrument's output closes the light."""
        return _shutter_on(self.mirror, self.counter, self.shutter)

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if self.simulated != self.counter.simulated:
            raise ValueError("one of mirror and counter is simulated and the other is not; they share one clock")
        if self.simulated and self.simulation is None:
            raise ValueError("a simulated bench needs a `simulation` block")
        if not self.simulated and self.simulation is not None:
            raise ValueError("a `simulation` block beside real instruments; remove it")
        if misfit := self.counter.laser_misfit(self.laser.repetition_hz):
            raise ValueError(f"counter: {misfit}")
        if self.shutter.model != "none":
            self._has_its_shutter()
        return self

    def _has_its_shutter(self) -> None:
        word = self.shutter.model
        both = (("counter", COUNTERS, self.counter), ("mirror", MIRRORS, self.mirror))
        if all(word in models[block.model].shutters for _, models, block in both):
            raise ValueError(
                f"shutter {word} is an output of counter {self.counter.model} and of mirror {self.mirror.model}: "
                "nobody knows which one closes the light. The package that took the other's word has to change its own"
            )
        for role, models, block in both:
            output = models[block.model].shutters.get(word)
            if output is not None:
                if output.needs and getattr(block, output.needs) is None:
                    raise ValueError(f"shutter {word} needs {role} {block.model} with its {output.needs}")
                return
        others = [f"{role} {name}" for role, models, _ in both for name in models if word in models[name].shutters]
        raise ValueError(f"shutter {word} is an output of the {' or '.join(others)}, which this bench does not have")


def _shutter_on(
    mirror: MirrorSettings, counter: CounterSettings, shutter: ShutterSettings
) -> Literal["mirror", "counter", "nothing"]:
    if shutter.model in COUNTERS[counter.model].shutters:
        return "counter"
    return "mirror" if shutter.model in MIRRORS[mirror.model].shutters else "nothing"
