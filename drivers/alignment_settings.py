"""What the `alignment` block of a bench file may say: how much light there is while somebody aims by hand."""

from pydantic import Field

from nlos.configs.settings import Settings


class AlignmentSettings(Settings):
    """Light of `nlos point`, `nlos jog` and `nlos monitor`. `duty` opens the shutter for that part of each period; the
    laser's power is a person's business, who is asked to turn it down to `power_mw` before the first light."""

    duty: float = Field(default=1.0, gt=0, le=1)
    """Part of each period for which the shutter is open."""
    period_s: float = Field(default=1.0, ge=0.5, le=10)
    """How long one opening and the dark after it last together."""
    longest_s: float = Field(default=120.0, gt=0, le=3600)
    """Longest light that may be asked for at once."""
    power_mw: float | None = Field(default=None, gt=0)
    """What a person turns the laser down to before the first light."""
