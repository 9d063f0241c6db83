"""What can go wrong, by name: faults that a bench file or a test asks the simulators to commit."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from pydantic import Field

from nlos.configs.settings import Settings


class Fault(Settings):
    """One fault by its name (`G1`, `U7`, ...), and when it strikes.

    It strikes at the first occasion after `after_s` of bench time and after `skip` earlier occasions, `times` times.
    `parameters` are the fault's own (how many bytes, which flag).
    """

    name: str
    """`python -m nlos.drivers.simulated.fault_catalogue` prints all, with what each does."""
    after_s: float = Field(default=0.0, ge=0)
    """Bench time before which it does not strike."""
    skip: int = Field(default=0, ge=0)
    """How many occasions it skips."""
    times: int = Field(default=1, ge=1)
    """How often it strikes."""
    parameters: dict[str, Any] = Field(default_factory=dict)
    """The fault's own: how many bytes, which flag."""


@dataclass
class _Pending:
    fault: Fault
    skip: int
    times: int


class FaultPlan:
    """The faults still to come. Simulators ask `strikes` wherever a fault of that name could happen."""

    def __init__(self, faults: Sequence[Fault] = ()) -> None:
        self._pending: list[_Pending] = []
        self.add(*faults)

    def add(self, *faults: Fault) -> None:
        """More to come, from now on."""
        self._pending += [_Pending(fault, fault.skip, fault.times) for fault in faults]

    def strikes(self, name: str, now_s: float, place: str = "") -> Fault | None:
        """The fault to commit at this occasion, or None. Where a fault can happen in several places, one whose
        parameters name a `place` strikes only there."""
        for entry in self._pending:
            if entry.fault.name != name or now_s < entry.fault.after_s or entry.times == 0:
                continue
            if entry.fault.parameters.get("place", place) != place:
                continue
            if entry.skip > 0:
                entry.skip -= 1
                continue
            entry.times -= 1
            return entry.fault
        return None
