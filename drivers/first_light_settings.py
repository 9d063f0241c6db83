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
    bench: str = ""
    """The bench that this was measured on. Another bench's values are not used."""
    simulated: bool | None = None
    """Whether that was a simulated bench. Its values are not used on the real bench of that name, nor the other way."""
    counter: str = ""
    """Model and serial number of the counter: every counter and its cables have a delay of their own."""

    def of_another(self, name: str, simulated: bool, counter: str = "") -> str:
        """Why these are not the values of that bench; empty where they are, or do not say. `counter`: its name, where
        somebody asked it."""
        kinds = {True: "simulated", False: "real"}
        if self.simulated is not None and self.simulated != simulated:
            return f"measured on a {kinds[self.simulated]} bench, and this one is {kinds[simulated]}"
        if self.bench and self.bench != name:
            return f"measured on bench {self.bench}, and this one is {name}"
        if self.counter and counter and self.counter != counter:
            return f"measured with {self.counter}, and the counter is {counter}"
        return ""
