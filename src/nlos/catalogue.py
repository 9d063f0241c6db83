"""`nlos.methods()`: every reconstruction method, and what may be set in each."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from nlos.configs.describe import Setting, describe
from nlos.recon.methods import catalogue, find, first_line
from nlos.recon.own_methods import in_a_file


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


def method(word: str) -> MethodInfo:
    """One method, by its name or its file. Raises `InvalidSettings`."""
    find(word)
    if in_a_file(word):
        return MethodInfo(word, first_line(Path(word).expanduser().read_text(encoding="utf-8")))
    return methods()[word]


def methods() -> dict[str, MethodInfo]:
    """Every method by its name. Imports none of them before its settings are asked for."""
    return {name: MethodInfo(name, what) for name, what in catalogue().items()}
