"""What a bench file says of an Optotune mirror."""

from typing import ClassVar, Literal, Self

from pydantic import Field, model_validator

from nlos.drivers.galvo.block import MirrorBlock
from nlos.drivers.galvo.settle import SettleModel, SettlePoint
from nlos.drivers.udev import tty_rule

_ST_VENDOR_ID = 0x0483
"""Of the controller's microcontroller, and of other makers' boards too."""


class OptotuneSettings(MirrorBlock):
    """The mirror block of a bench file."""

    cable: ClassVar = "serial"
    incidental: ClassVar[frozenset[str]] = MirrorBlock.incidental | {
        "controller", "settle_timeout_s", "stable_ms", "readback", "warn_error_deg", "max_error_deg"}  # fmt: skip
    polled_every_s: ClassVar[float] = 0.5e-3

    model: Literal["optotune"]
    port: str
    """The serial port: /dev/ttyACM0, COM3, or sim://NAME for a simulated one."""
    controller: Literal["auto", "MR-E-2", "MR-E-3"] = "auto"
    """The one that it must be, or "auto" for whichever of the two answers."""
    max_mechanical_deg: float = Field(default=25.0, gt=0, le=25)
    """How far the mirror may turn either way from its centre (mechanical; the beam turns twice that); beyond it moves
    are refused."""
    settle: SettleModel = SettleModel(
        table=(
            SettlePoint(step_deg=0.1, settle_ms=2.0),
            SettlePoint(step_deg=10.0, settle_ms=7.0),
            SettlePoint(step_deg=50.0, settle_ms=20.0),
        )
    )
    """For planning only, and not from a data sheet: measure it."""
    timeout_s: float = Field(default=0.5, ge=0.02, le=10)
    """How long an answer may take."""
    settle_timeout_s: float = Field(default=0.5, gt=0, le=10)
    """How long it may take to say that it is still; then the scan ends."""
    stable_ms: float = Field(default=6.0, ge=0, le=1000)
    """How long after it said so for the first time it has to be still: it says so several times while it rings. Of one
    MR-15-30 the last time came 5.2 ms after the first, after a step that is not told (measured by others)."""
    readback: bool = False
    """After every move the measured position is compared with the commanded one, which costs about 60 ms."""
    warn_error_deg: float = Field(default=0.3, gt=0)
    """Mechanical distance of measured from commanded position that is worth a warning."""
    max_error_deg: float = Field(default=1.0, gt=0)
    """The same mechanical distance from which it is a fault."""

    @property
    def stable_s(self) -> float:
        """From the first time that it says so to the second."""
        return self.stable_ms * 1e-3

    @property
    def udev_rule(self) -> str:
        """By the vendor id of the controller's USB port."""
        return tty_rule(_ST_VENDOR_ID, self.model)

    @model_validator(mode="after")
    def _warns_first(self) -> Self:
        if self.warn_error_deg > self.max_error_deg:
            raise ValueError("warn_error_deg must not be larger than max_error_deg")
        return self
