"""What the `alignment` block of a bench file may say: how much light there is while somebody aims by hand."""

from typing import Self

from pydantic import Field, model_validator

from nlos.configs.settings import Settings

SHORTEST_S = 0.2
"""Shortest light that may be asked for: a shutter takes a while, and so may a busy computer."""
SHORTEST_FLASH_S = 0.08
"""Shortest opening of a duty: light is told to go off before its time, so that of less nothing would be left."""


class AlignmentSettings(Settings):
    """Light of `nlos point`, `nlos jog` and `nlos monitor`. `duty` opens the shutter for that part of each period; the
    laser's power is a person's business, who is asked to turn it down to `power_mw` before the first light."""

    duty: float = Field(default=1.0, gt=0, le=1)
    """Part of each period for which the shutter is open."""
    period_s: float = Field(default=1.0, ge=0.5, le=10)
    """How long one opening and the dark after it last together."""
    longest_s: float = Field(default=120.0, ge=SHORTEST_S, le=3600)
    """Longest light that may be asked for at once."""
    power_mw: float | None = Field(default=None, gt=0)
    """What a person turns the laser down to before the first light."""

    @model_validator(mode="after")
    def _gives_light(self) -> Self:
        if (flash_s := self.duty * self.period_s) < SHORTEST_FLASH_S - 1e-9:
            raise ValueError(
                f"duty {self.duty:g} of period_s {self.period_s:g} opens the shutter for {flash_s:g} s at a time. Of "
                f"less than {SHORTEST_FLASH_S:g} s next to nothing is left. Raise period_s, or duty"
            )
        return self
