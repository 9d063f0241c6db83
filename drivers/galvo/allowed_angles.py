"""How far each axis may be sent to each side, in the angles that are sent: a limit that no geometry can move."""

import math
from typing import Self

from pydantic import Field, model_validator

from nlos.configs.settings import Settings
from nlos.drivers.errors import LimitError
from nlos.drivers.galvo.mirror import MirrorAngles


class AllowedAngles(Settings):
    """Optical degrees, +x right and +y up as the scanner sees it; the centre, where mirrors park, is always inside."""

    left_deg: float = Field(default=-90.0, gt=-91, le=0)
    """Least x, optical."""
    right_deg: float = Field(default=90.0, ge=0, lt=91)
    """Greatest x, optical."""
    bottom_deg: float = Field(default=-90.0, gt=-91, le=0)
    """Least y, optical."""
    top_deg: float = Field(default=90.0, ge=0, lt=91)
    """Greatest y, optical."""

    @model_validator(mode="after")
    def _has_an_inside(self) -> Self:
        if not (self.left_deg < self.right_deg and self.bottom_deg < self.top_deg):
            raise ValueError("left_deg must lie below right_deg, and bottom_deg below top_deg")
        return self

    def check(self, device: str, angles: MirrorAngles) -> None:
        """Raises `LimitError` outside."""
        for axis, sent_rad, least_deg, greatest_deg in (
            ("x", angles.x_rad, self.left_deg, self.right_deg),
            ("y", angles.y_rad, self.bottom_deg, self.top_deg),
        ):
            sent_deg = math.degrees(sent_rad)
            if not least_deg - 1e-9 <= sent_deg <= greatest_deg + 1e-9:
                raise LimitError(
                    device,
                    f"{axis} = {sent_deg:+.3f} deg optical is outside {least_deg:+g} to {greatest_deg:+g} deg "
                    "(mirror.allowed_deg).",
                    "Shrink the wall in the plan, aim nearer to its middle, or widen mirror.allowed_deg in the bench "
                    "file.",
                )
