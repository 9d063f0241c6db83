"""How a picture is made, wherever its scan comes from: the method, what it is told, and where it computes."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from nlos.recon.methods import find
from nlos.response import AUTO, ResponseWanted

FARTHEST_M = 1000.0
"""No picture is limited to what lies deeper."""


@dataclass(frozen=True)
class Recipe:
    """The same for a file, a film and a scan that is being followed."""

    method: str = "lct"
    settings: Mapping[str, object] = field(default_factory=dict)
    """The method's own; of a file also `offsets=file`."""
    constants: Path | None = None
    """Measured constants of the bench; None: the newest that hold for the scan."""
    response: ResponseWanted = AUTO
    device: str = "cpu"

    def limited_to(self, depth_m: tuple[float, float] | None) -> "Recipe":
        """For a picture of which (nearest, farthest) is kept: a method that can looks no deeper, unless told to."""
        if depth_m is None or "farthest_m" not in find(self.method).Settings.model_fields:
            return self
        return replace(self, settings={"farthest_m": depth_m[1], **self.settings})
