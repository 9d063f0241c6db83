"""What a recording that is followed said of itself when it was last looked at."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.recording import Event, Recording, Status
from nlos.drivers.clock import SystemClock


@dataclass(frozen=True)
class Seen:
    """What the file said of itself when it was last looked at."""

    plan: ScanPlan
    status: Status
    events: tuple[Event, ...]
    started_utc: str
    which: str
    """The recording's identity: the file may be another one by now."""
    notes: Mapping[str, str] = field(default_factory=dict)
    """What a person said of the run, by name."""
    header: Header = field(default_factory=Header)
    looked_s: float = field(default_factory=SystemClock().now)
    """When that was. A disk that does not answer holds up the next look for as long as it likes."""

    @property
    def age_s(self) -> float:
        """How long ago that was, a sleep of the computer counted."""
        return SystemClock().now() - self.looked_s

    @classmethod
    def of(cls, recording: Recording) -> "Seen":
        """As it is now."""
        header = recording.header
        return cls(
            recording.plan, recording.status, tuple(recording.events()), header.started_utc, header.identity,
            header.notes.shown(), header,
        )  # fmt: skip
