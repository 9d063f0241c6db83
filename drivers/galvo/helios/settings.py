"""What a bench file says of a Helios laser DAC and the ILDA galvos behind it."""

from typing import ClassVar, Literal, Self

from pydantic import Field, model_validator

from nlos.drivers.galvo.block import MirrorBlock
from nlos.drivers.galvo.helios.wire import COLOUR_FULL_V, MOST_POINTS
from nlos.drivers.udev import usb_rule

VENDOR_ID, PRODUCT_ID = 0x1209, 0xE500


class HeliosSettings(MirrorBlock):
    """The mirror block of a bench file. The DAC's shutter pin stays low: it is no shutter of a bench, because a stop
    leaves it as it is."""

    cable: ClassVar = "usb"
    incidental: ClassVar[frozenset[str]] = MirrorBlock.incidental | {"markers", "marker_output_v"}
    commands_per_move: ClassVar[float] = 1.5
    """The status, there and back, and the frame, one way."""
    commands_per_sequence: ClassVar[float] = 3
    """The first position, then the frame."""
    steps_per_upload: ClassVar[int] = MOST_POINTS

    model: Literal["helios"]
    usb: str = "auto"
    """The only one plugged in ("auto"), or "simulated"."""
    optical_deg_at_full_scale: float = Field(default=40.0, gt=0, le=60)
    """Optical deflection of an axis at the DAC's last code: measure it on the wall."""
    invert_x: bool = False
    """The x galvo is wired the other way round."""
    invert_y: bool = False
    """The y galvo is wired the other way round."""
    markers: Literal["none", "colours"] = "none"
    """Where the colour outputs go: to nothing, and the computer steps the mirror; or to the counter, R, G and B to its
    marker inputs 1 to 3 and I to its trigger input, and the DAC's own clock steps it. Never to a laser."""
    marker_output_v: float = Field(default=3.3, ge=2.0, le=COLOUR_FULL_V)
    """How high a mark on a colour output is."""
    max_mechanical_deg: float = Field(default=20.0, gt=0, le=30)
    """How far the head may turn either way from its centre (mechanical; the beam turns twice that); beyond it moves are
    refused."""
    timeout_s: float = Field(default=0.2, ge=0.02, le=10)
    """How long an answer may take."""

    @property
    def udev_rule(self) -> str:
        """By the ids that pid.codes gave it."""
        return usb_rule(VENDOR_ID, PRODUCT_ID)

    @model_validator(mode="after")
    def _one_only(self) -> Self:
        if self.usb not in ("auto", "simulated"):
            raise ValueError("usb must be auto or simulated: a Helios has no serial number")
        return self
