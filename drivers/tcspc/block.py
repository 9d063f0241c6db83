"""What the `counter` block of a bench file has in common for all models, and what planning wants to know of one."""

from typing import ClassVar

from nlos.drivers.device_settings import DeviceSettings


class CounterBlock(DeviceSettings):
    """Derived from by each model's own settings. Class variables are the model's, not the user's; they are what list
    mode costs, beyond the link."""

    listed_point_s: ClassVar[float] = 0.0
    """How much later than the gate closes a point started by the host is known to be complete."""
    listing_begins_s: ClassVar[float] = 0.0
    """How long a scan in list mode takes to begin."""
    listing_ends_s: ClassVar[float] = 0.0
    """How long the last photons of a sequence take out of the instrument."""
