"""What can go wrong, by name: faults that a bench file or a test asks the simulators to commit."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import AfterValidator, Field

from nlos.configs.settings import ConfigError, Settings


class Parameters(dict[str, Any]):
    """A fault's own, as a person wrote them. What is of another kind than its default raises `ConfigError`."""

    def get(self, key: str, default: Any = None) -> Any:
        """The value, or the default."""
        value = super().get(key, default)
        if type(default) in (int, float) and (isinstance(value, bool) or not isinstance(value, int | float)):
            raise ConfigError(f"simulation: faults: parameters: {key}: write a number (given {value!r})")
        return value


def one_of(parameters: dict[str, Any], key: str, default: str, known: Iterable[str]) -> str:
    """The word given, or the default. Raises `ConfigError` for one that is not among `known`."""
    word = str(parameters.get(key, default))
    if word not in known:
        raise ConfigError(
            f"simulation: faults: parameters: {key}: write one of {', '.join(sorted(known))} (given {word!r})"
        )
    return word


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
    parameters: Annotated[dict[str, Any], AfterValidator(Parameters)] = Field(default_factory=Parameters)
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
