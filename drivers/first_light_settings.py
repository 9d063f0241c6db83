"""The `first_light` block of a bench file: what was measured before the first scan."""

from pydantic import Field

from nlos.configs.settings import Settings


class FirstLightSettings(Settings):
    """Written by `nlos calibrate --first-light`. `plan` holds time windows against it, `scan` its first points."""

    delay_ns: float = Field(ge=-1e6, le=1e6)
    """From the sync pulse to the photon's pulse, less the light's way to the wall and back: cables and electronics."""
    response_fwhm_ps: float | None = Field(default=None, gt=0)
    """Width of the direct peak."""
    direct_cps: float | None = Field(default=None, ge=0)
    """Direct light from the middle of the area, at the laser power of that day."""
    dark_cps: float | None = Field(default=None, ge=0)
    """Clicks with the detector covered."""
    room_cps: float | None = Field(default=None, ge=0)
    """Clicks of light that is not the laser's, with the shutter closed."""
