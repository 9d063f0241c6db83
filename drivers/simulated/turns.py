"""What tells one gate from another that is like it: photons of equal gates are drawn independently.

A point of a plan is known by its number, and taken again it holds the same photons. The host tells the bench which
points it arms for and where they are, as most instruments cannot stamp numbers: an edge that a mirror misses delays all
points that begin at the mirror's own steps, and changes none of them. Other gates of one place and length are known by
their order: the first holds other photons than the second.
"""

import math
from collections import Counter
from collections.abc import Sequence

from nlos.drivers.galvo.mirror import MirrorAngles

Place = tuple[int, int, int]
"""Nanoradians, made positive, and nanoseconds."""


NEAR = 4
"""Steps that a mirror may be behind the clock, or ahead of it, and is still known by its place."""
CLEARLY = 4.0
"""How many times nearer another point's place must be: a converter's steps and a servo's error are no other place."""


class Turns:
    """Numbers that are due, and how many gates of each place and length there were."""

    def __init__(self) -> None:
        self._due: tuple[int, ...] = ()
        self._places: tuple[MirrorAngles, ...] = ()
        self._begun = 0
        self._seen: Counter[Place] = Counter()

    def announce(self, numbers: Sequence[int], places: Sequence[MirrorAngles] = ()) -> None:
        """The points that the host is about to arm for, in order, and where each is, if that may tell them apart; none:
        what comes is of no plan."""
        self._due, self._places, self._begun = tuple(numbers), tuple(places), 0

    def next_number(self) -> int | None:
        """The number of the point that begins now. Asked by an instrument that stamps none, once a point."""
        self._begun += 1
        return self._due[self._begun - 1] if self._begun <= len(self._due) else None

    def number_at(self, beam: MirrorAngles) -> int | None:
        """The number of the point that began last, or of the one near it in order in whose place the beam rests."""
        last = self._begun - 1
        own = self._due[last] if 0 <= last < len(self._due) else None
        near = range(max(0, last - NEAR), min(len(self._places), last + NEAR + 1))
        if not near:
            return own
        off = {k: math.hypot(beam.x_rad - self._places[k].x_rad, beam.y_rad - self._places[k].y_rad) for k in near}
        best = min(near, key=lambda k: (off[k], abs(k - last)))
        return self._due[best] if last not in off or off[last] > CLEARLY * off[best] else own

    def turn(self, beam: MirrorAngles, dwell_s: float) -> int:
        """How many gates like this one there were before it."""
        place = placed(beam, dwell_s)
        self._seen[place] += 1
        return self._seen[place] - 1


def placed(beam: MirrorAngles, dwell_s: float) -> Place:
    """Place and length of a gate in whole units."""
    x, y = (round(angle * 1e9) + (1 << 33) for angle in (beam.x_rad, beam.y_rad))
    return x, y, round(dwell_s * 1e9)
