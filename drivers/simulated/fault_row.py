"""A line of the table of faults, as each model's own module writes it."""

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class FaultRow:
    """`parameters`: what a bench file or a test may say about it; "built in" where it needs no asking for."""

    name: str
    happens: str
    seen: str
    kept: str
    parameters: str = ""


def words(names: Iterable[str]) -> str:
    """As a bench file writes them, side by side."""
    return ", ".join(f"`{name}`" for name in names)


ALL = "everything acknowledged; the point under way is taken again by `--resume`"
SAME = "everything: the scan continues"
