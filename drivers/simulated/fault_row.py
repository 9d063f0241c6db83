"""A line of the table of faults, as each model's own module writes it."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

_ONE_OF = re.compile(r"`(\w+)`: (`[^`]+`(?:, `[^`]+`)*)(?!, \.\.\.)(?:[;.]|$)")
"""A parameter with the words that it may be; nothing follows the last of them."""


@dataclass(frozen=True)
class FaultRow:
    """`parameters`: what a bench file or a test may say about it, every name between backticks, and where a few words
    are all that one may be, "`name`: `word`, `word`"; "built in" where it needs no asking for."""

    name: str
    happens: str
    seen: str
    kept: str
    parameters: str = ""

    def unknown(self, given: Mapping[str, object]) -> list[str]:
        """Those of a fault's parameters that `parameters` does not tell, and words that none of them may be."""
        known: dict[str, set[str]] = {}
        for name, listed in _ONE_OF.findall(self.parameters):
            known.setdefault(name, set()).update(re.findall(r'`"?(.+?)"?`', listed))
        return [
            name if f"`{name}`" not in self.parameters else f"{name}: {value}"
            for name, value in given.items()
            if f"`{name}`" not in self.parameters or (name in known and str(value) not in known[name])
        ]


def words(names: Iterable[str]) -> str:
    """As a bench file writes them, side by side."""
    return ", ".join(f"`{name}`" for name in names)


ALL = "everything acknowledged; the point under way is taken again by `--resume`"
SAME = "everything: the scan continues"
