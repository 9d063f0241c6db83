"""What a cable may do to a message: each harm makes of its bytes the pieces that arrive, and when."""

import itertools
from collections.abc import Callable

Piece = tuple[float, bytes]
"""Seconds later, bytes."""
Harm = Callable[[bytes], list[Piece]]


def split(cuts: list[float], gap_s: float) -> Harm:
    def harm(data: bytes) -> list[Piece]:
        at = sorted({0, len(data), *(int(cut * len(data)) for cut in cuts)})
        return [(index * gap_s, data[start:end]) for index, (start, end) in enumerate(itertools.pairwise(at))]

    return harm


def corrupted(place: float, flip: int) -> Harm:
    def harm(data: bytes) -> list[Piece]:
        at = int(place * len(data))
        return [(0.0, data[:at] + bytes((data[at] ^ flip,)) + data[at + 1 :])]

    return harm


def interspersed(place: float, noise: bytes) -> Harm:
    def harm(data: bytes) -> list[Piece]:
        at = int(place * len(data))
        return [(0.0, data[:at] + noise + data[at:])]

    return harm
