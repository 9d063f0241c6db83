"""`nlos.methods()`: every reconstruction method, and what may be set in each."""

from dataclasses import dataclass
from functools import cached_property

from nlos.configs.describe import Setting, describe
from nlos.recon.methods import catalogue, find


@dataclass(frozen=True)
class MethodInfo:
    """One method."""

    name: str
    what: str

    @cached_property
    def settings(self) -> dict[str, Setting]:
        """Key -> type, unit, default, range and meaning."""
        return describe(find(self.name).Settings)

    def __str__(self) -> str:
        return "\n".join([f"{self.name}: {self.what}", *(f"  {setting}" for setting in self.settings.values())])


def methods() -> dict[str, MethodInfo]:
    """Every method by its name. Imports none of them before its settings are asked for."""
    return {name: MethodInfo(name, what) for name, what in catalogue().items()}
