"""What tells one gate from another that is like it: photons of equal gates are drawn independently.

A point of a plan is known by its number, and taken again it holds the same photons. The host tells the bench which
points it arms for, as most instruments cannot stamp numbers. Other gates of one place and length are known by their
order: the first holds other photons than the second.
"""

from collections import Counter
from collections.abc import Iterator, Sequence

from nlos.drivers.galvo.mirror import MirrorAngles

Place = tuple[int, int, int]
"""Nanoradians, made positive, and nanoseconds."""


class Turns:
    """Numbers that are due, and how many gates of each place and length there were."""

    def __init__(self) -> None:
        self._due: Iterator[int] = iter(())
        self._seen: Counter[Place] = Counter()

    def announce(self, numbers: Sequence[int]) -> None:
        """The points that the host is about to arm for, in order; none: what comes is of no plan."""
        self._due = iter(tuple(numbers))

    def next_number(self) -> int | None:
        """The number of the point that begins now. Asked by an instrument that stamps none, once a point."""
        return next(self._due, None)

    def turn(self, beam: MirrorAngles, dwell_s: float) -> int:
        """How many gates like this one there were before it."""
        place = placed(beam, dwell_s)
        self._seen[place] += 1
        return self._seen[place] - 1


def placed(beam: MirrorAngles, dwell_s: float) -> Place:
    """Place and length of a gate in whole units."""
    x, y = (round(angle * 1e9) + (1 << 33) for angle in (beam.x_rad, beam.y_rad))
    return x, y, round(dwell_s * 1e9)
