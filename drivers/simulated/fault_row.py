"""A line of the table of faults, as each model's own module writes it."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class FaultRow:
    """`parameters`: what a bench file or a test may say about it, each name between backticks, with the words that it
    may be where these are few: "`count`, `delay_s`; `kind`: `word`, `word`". "built in" where it needs no asking
    for."""

    name: str
    happens: str
    seen: str
    kept: str
    parameters: str = ""

    def unknown(self, given: Mapping[str, object]) -> list[str]:
        """Those of a fault's parameters that it does not have, and words that one of them cannot be."""
        known = self._known()
        return [
            f"{name}: {value}" if name in known else name
            for name, value in given.items()
            if name not in known or (known[name] and str(value) not in known[name])
        ]

    def _known(self) -> dict[str, set[str]]:
        """Name -> the words that it may be; none where it may be anything."""
        found: dict[str, set[str]] = {}
        for part in re.split("[;.] ", self.parameters):
            names, _, words = part.rpartition("`: ") if "`: " in part else (part, "", "")
            for name in re.findall(r"`(\w+)", names):
                found.setdefault(name, set()).update([] if "..." in words else re.findall(r'`"?(.+?)"?`', words))
        return found


def words(names: Iterable[str]) -> str:
    """As a bench file writes them, side by side."""
    return ", ".join(f"`{name}`" for name in names)


ALL = "everything acknowledged; the point under way is taken again by `--resume`"
SAME = "everything: the scan continues"
