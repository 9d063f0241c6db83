"""What can go wrong, by name: faults that a bench file or a test asks the simulators to commit."""

from typing import Any

from pydantic import Field

from configs.settings import Settings


class Fault(Settings):
    """One fault of the tables in docs/faults.md (`G1`, `U7`, ...), and when it strikes.

    It strikes at the first occasion after `after_s` of bench time and after `skip` earlier occasions, `times` times.
    `parameters` are the fault's own (how many bytes, which flag).
    """

    name: str
    after_s: float = Field(default=0.0, ge=0)
    skip: int = Field(default=0, ge=0)
    times: int = Field(default=1, ge=1)
    parameters: dict[str, Any] = {}


class FaultPlan:
    """The faults still to come. Simulators ask `strikes` wherever a fault of that name could happen."""

    def __init__(self, faults: list[Fault] | None = None) -> None:
        self._pending = [[fault, fault.skip, fault.times] for fault in faults or []]

    def strikes(self, name: str, now_s: float) -> Fault | None:
        """The fault to commit at this occasion, or None."""
        for entry in self._pending:
            fault: Fault = entry[0]
            if fault.name != name or now_s < fault.after_s or entry[2] == 0:
                continue
            if entry[1] > 0:
                entry[1] -= 1
                continue
            entry[2] -= 1
            return fault
        return None
