"""What a bench file says of a TriggerScope-MM and the galvo head behind it."""

from typing import ClassVar, Literal, Self

from pydantic import Field, model_validator

from nlos.configs.settings import Settings
from nlos.drivers.galvo.settle import SettleModel


class AxisSettings(Settings):
    """One galvo axis: its DAC, volts per mechanical degree (negative: mounted the other way round), volts at centre."""

    dac: int = Field(ge=1, le=9)
    volts_per_degree: float = Field(default=0.5, ge=-10, le=10)
    offset_v: float = Field(default=0.0, ge=-10, le=10)


class TriggerScopeSettings(Settings):
    """The mirror block of a bench file.

    `shutter_pin`: TTL output (9 to 16) wired to the laser shutter; outputs 1 to 3 carry the markers of a sequence.
    `allow_unverified_dac`: moves although no start-up banner was seen, which is how a controller without SD card looks:
    it confirms every command and moves nothing.
    """

    marker_output_v: ClassVar[float] = 5.0
    """Its outputs go through level shifters from 3.3 V."""
    trigger_input: ClassVar[str] = "TTL of at least 10 us"
    """It is polled: a shorter pulse is not seen."""

    model: Literal["triggerscope"]
    port: str
    x: AxisSettings = AxisSettings(dac=1)
    y: AxisSettings = AxisSettings(dac=2)
    max_mechanical_deg: float = Field(default=20.0, gt=0, le=45)
    settle: SettleModel = SettleModel()
    shutter_pin: int | None = Field(default=None, ge=9, le=16)
    timeout_s: float = Field(default=0.5, ge=0.02, le=10)
    banner_timeout_s: float = Field(default=1.0, ge=0.1, le=10)
    allow_unverified_dac: bool = False

    @model_validator(mode="after")
    def _two_axes(self) -> Self:
        if self.x.dac == self.y.dac:
            raise ValueError("x and y need a DAC each")
        if 0.0 in (self.x.volts_per_degree, self.y.volts_per_degree):
            raise ValueError("volts_per_degree must not be 0")
        return self
