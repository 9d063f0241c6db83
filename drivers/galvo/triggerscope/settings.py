"""What a bench file says of a TriggerScope-MM and the galvo head behind it."""

from typing import ClassVar, Literal, Self

from pydantic import Field, model_validator

from nlos.configs.settings import Settings
from nlos.drivers.galvo.block import MirrorBlock
from nlos.drivers.udev import tty_rule

_TEENSY_VENDOR_ID = 0x16C0
"""Of its microcontroller board, and of other projects' too."""


class AxisSettings(Settings):
    """One galvo axis: the output that drives it, and what its volts mean."""

    dac: int = Field(ge=1, le=9)
    """The analogue output that it is wired to."""
    volts_per_degree: float = Field(default=0.5, ge=-10, le=10)
    """Of the galvo driver, per mechanical degree; negative where the axis is mounted the other way round."""
    offset_v: float = Field(default=0.0, ge=-10, le=10)
    """Volts with the mirror at its centre."""


class TriggerScopeSettings(MirrorBlock):
    """The mirror block of a bench file."""

    cable: ClassVar = "serial"
    incidental: ClassVar[frozenset[str]] = MirrorBlock.incidental | {
        "banner_timeout_s", "allow_unverified_dac", "shutter_pin"}  # fmt: skip
    commands_per_move: ClassVar[float] = 2
    marker_output_v: ClassVar[float] = 5.0
    """Its outputs go through level shifters from 3.3 V."""
    trigger_input: ClassVar[str] = "TTL of at least 10 us"
    """It is polled: a shorter pulse is not seen."""

    model: Literal["triggerscope"]
    port: str
    """The serial port: /dev/ttyACM0, COM3, or sim://NAME for a simulated one."""
    x: AxisSettings = AxisSettings(dac=1)
    """The axis that moves the beam sideways."""
    y: AxisSettings = AxisSettings(dac=2)
    """The axis that moves the beam up and down."""
    max_mechanical_deg: float = Field(default=20.0, gt=0, le=45)
    """How far the head may turn either way from its centre (mechanical; the beam turns twice that); beyond it moves are
    refused."""
    shutter_pin: int | None = Field(default=None, ge=9, le=16)
    """TTL output that is wired to the laser shutter; outputs 1 to 3 carry the markers of a sequence."""
    timeout_s: float = Field(default=0.5, ge=0.02, le=10)
    """How long an answer may take."""
    banner_timeout_s: float = Field(default=1.0, ge=0.1, le=10)
    """How long the start-up text may take after the port is opened."""
    allow_unverified_dac: bool = False
    """Moves although no start-up text was seen, which is how a controller without SD card looks: it confirms every
    command and moves nothing. `nlos jog` asks somebody to look at its first small moves."""

    @property
    def udev_rule(self) -> str:
        """By the vendor id of the board's USB port."""
        return tty_rule(_TEENSY_VENDOR_ID, self.model)

    @model_validator(mode="after")
    def _two_axes(self) -> Self:
        if self.x.dac == self.y.dac:
            raise ValueError("x and y need a DAC each")
        if 0.0 in (self.x.volts_per_degree, self.y.volts_per_degree):
            raise ValueError("volts_per_degree must not be 0")
        return self
