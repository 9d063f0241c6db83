"""What the `counter` block of a bench file has in common for all models, and what planning wants to know of one."""

from collections.abc import Mapping
from typing import ClassVar, Literal

from nlos.drivers.device_settings import DeviceSettings

Pulse = Literal["nim", "ttl"]
"""What a detector or a laser puts out: 0 to -0.8 V, or 0 to 3 V and more."""


class CounterBlock(DeviceSettings):
    """Derived from by each model's own settings. Class variables are the model's, not the user's; they are what list
    mode costs, beyond the link."""

    @classmethod
    def pulse_keys(cls, pulse: Pulse, device: str = "") -> Mapping[str, object] | None:
        """Keys of an input block that such a pulse crosses, on this model's `device`; None: it needs a converter.
        `edge` of a model whose channels have signs: "falling" is a negative channel."""
        return {}

    @classmethod
    def laser_keys(cls, repetition_hz: float, device: str = "") -> Mapping[str, object]:
        """Keys of the block that a laser of this rate asks for, on this model's `device`."""
        return {}

    def laser_misfit(self, repetition_hz: float) -> str:
        """Why the sync of a laser of this rate cannot be taken, and what to do; empty where it can."""
        return ""

    usual_pulse: ClassVar[Pulse] = "nim"
    """What detectors in front of such a counter mostly put out."""
    usual_mode: ClassVar[str | None] = None
    """Its `mode` in a new bench file, where that is not its default."""
    listed_point_s: ClassVar[float] = 0.0
    """How much later than the gate closes a point started by the host is known to be complete."""
    listing_begins_s: ClassVar[float] = 0.0
    """How long a scan in list mode takes to begin."""
    listing_ends_s: ClassVar[float] = 0.0
    """How long the last photons of a sequence take out of the instrument."""
