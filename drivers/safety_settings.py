"""What the `safety` block of a bench file may say."""

from pydantic import Field, field_validator

from nlos.configs.settings import Settings


class SafetySettings(Settings):
    """When the light is shut off without anybody asking. `dry_run`: it never comes on, everything else happens."""

    dry_run: bool = False
    """The light never comes on; everything else happens."""
    watchdog_s: float = Field(default=2.0, ge=0, le=60)
    """The shutter closes when this computer has been silent for so long; 0: never. A counter sees to it that drives the
    shutter itself, else a thread of this program: against whatever hangs the program, not where it is killed."""
    trip_cps: float = Field(default=5e6, gt=0)
    """Detector rate above which the light is shut off, until a person clears it."""
    trip_ms: float = Field(default=10.0, ge=1)
    """How long the rate may be exceeded."""

    @field_validator("watchdog_s")
    @classmethod
    def _is_a_time_the_instrument_can_keep(cls, value: float) -> float:
        if 0 < value < 0.1:
            raise ValueError("must be 0 (off) or at least 0.1 s")
        return value
