"""Which damaged file each case of the campaign is, and which command reads it: drawn from the case's number alone."""

import math
from collections.abc import Iterable

from tests.nlos.strangers.kinds_of_files import KINDS, verbs_of

DRAWS = ("report", "live", "reconstruct", "calibrate", "serve")
"""Verbs that take seconds where a file survives its damage: pictures are drawn, a page is served."""
OFTEN = 7
"""Every other pair of kind and verb comes so many times as often."""

Pair = tuple[str, tuple[str, ...]]


def pairs(kinds: Iterable[str] = KINDS) -> list[Pair]:
    """Kind of file and command, each as often as it comes in one round of the campaign, well mixed."""
    each = [(kind, words) for kind in kinds for words in verbs_of(kind)]
    once = [pair for turn in range(OFTEN) for pair in each if turn == 0 or pair[1][0] not in DRAWS]
    step = next(n for n in range(len(once) * 5 // 8, len(once)) if math.gcd(n, len(once)) == 1)
    return [once[index * step % len(once)] for index in range(len(once))]
