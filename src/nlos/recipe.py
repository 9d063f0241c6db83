"""How a picture is made, wherever its scan comes from: the method, what it is told, and where it computes."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from nlos.response import AUTO, ResponseWanted


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
