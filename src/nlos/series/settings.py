"""What a queue file says: which scans, on which bench, where to, and what an alarm does to the rest."""

from typing import Literal, Self

from pydantic import Field, model_validator

from nlos.configs.settings import Settings
from nlos.drivers.run_defaults import HookSettings

Value = bool | int | float | str
MOST_RUNS = 10_000


class QueuedScan(Settings):
    """One scan, or several: with `sweep` one for each value (each combination of several keys), `repeat` times."""

    scan: str
    """A scan file, relative to the queue file, or a name in configs/scan."""
    bench: str | None = None
    """A bench other than the queue's."""
    set: dict[str, Value] = Field(default_factory=dict)
    """Keys of the scan file that differ here: `{dwell_ms: 4, wall.rows: 32}`."""
    sweep: dict[str, tuple[Value, ...]] = Field(default_factory=dict)
    """Keys of the scan file and the values that they take in turn."""
    repeat: int = Field(default=1, ge=1, le=1000)
    """How often, one after the other."""
    sample: str | None = None
    """What is behind the corner; the queue's unless given."""
    operator: str | None = None
    """Who measures."""
    note: str | None = None
    """Anything worth finding again."""
    tags: tuple[str, ...] = ()
    """Beside the queue's."""

    @model_validator(mode="after")
    def _has_values(self) -> Self:
        for key, values in self.sweep.items():
            if not values:
                raise ValueError(f"sweep.{key} has no values")
            if key in self.set:
                raise ValueError(f"{key} is in both set and sweep; remove one")
        return self


class QueueSettings(Settings):
    """Scans in their order, and what holds for all of them."""

    runs: tuple[QueuedScan, ...] = Field(min_length=1)
    """In this order."""
    bench: str = "simulated"
    """A bench file, relative to the queue file, or a name in configs/bench."""
    folder: str | None = None
    """Where recordings and journal go, relative to the queue file; a folder of the queue's own name unless given."""
    on_alarm: Literal["stop", "skip"] = "stop"
    """What an alarm in one scan does to the rest: end the series, to be resumed, or leave that scan as it is. A trip,
    which stands until a person clears it, always ends it."""
    reconstruct: str | None = None
    """Method by which all are reconstructed at the end."""
    constants: str | None = None
    """Constants to aim by, or none; the bench's newest unless given."""
    no_shutter: bool = False
    """Agrees to a bench without a shutter."""
    sample: str | None = None
    """What is behind the corner."""
    operator: str | None = None
    """Who measures."""
    note: str | None = None
    """Anything worth finding again."""
    tags: tuple[str, ...] = ()
    """Words to find all of them by."""
    hooks: HookSettings | None = None
    """Who is told when the series is done, and of every alarm; the bench's unless given."""
