"""What the `mirror` block of a bench file has in common for all models, and what planning wants to know of one."""

from typing import ClassVar

from nlos.drivers.device_settings import DeviceSettings
from nlos.drivers.galvo.allowed_angles import AllowedAngles
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.galvo.settle import SettleModel


class MirrorBlock(DeviceSettings):
    """Derived from by each model's own settings. Class variables are the model's, not the user's."""

    incidental: ClassVar[frozenset[str]] = DeviceSettings.incidental | {"settle", "allowed_deg", "max_mechanical_deg"}
    commands_per_move: ClassVar[float] = 1
    """Exchanges that one move takes: one for both axes, or one for each."""
    commands_per_sequence: ClassVar[float] = 13
    """Exchanges beside the uploads that clear, start and stop a sequence."""
    steps_per_upload: ClassVar[int] = 99
    """How many steps of a sequence one upload carries; x, y and marks go one after the other."""
    polled_every_s: ClassVar[float | None] = None
    """Pause between two looks at the status of a mirror that has to say twice that it has settled; None: it is waited
    for by the settle model."""

    settle: SettleModel = SettleModel()
    """How long the beam takes to be still after a step of one axis."""
    allowed_deg: AllowedAngles | None = None
    """How far each axis may be sent to each side, in optical degrees, whatever the geometry says; the head's reach
    alone unless given."""

    @property
    def stable_s(self) -> float:
        """How long a mirror that is looked at has to say that it is still, which its moves last longer."""
        return 0.0

    def check_allowed(self, angles: MirrorAngles) -> None:
        """Raises `LimitError` outside `allowed_deg`. A driver asks before it sends."""
        if self.allowed_deg is not None:
            self.allowed_deg.check(self.model, angles)
