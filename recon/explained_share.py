"""The share of light that a picture explains, and how it is said."""

import math
from dataclasses import dataclass, replace

LEAST, ERRORS = 0.05, 3.0
"""A picture that explains less than this, or less than so many of its errors, explains nothing."""
LITTLE, FAR_BETTER = 0.25, 2.0
"""Of a picture that explains less than this, another one is made without the response; so many times as much tells."""


@dataclass(frozen=True)
class Explained:
    """The share of light left for judging that the picture accounts for, its standard error, and what to know about it.

    `share` is None where it could not be found; `note` then says why.
    """

    share: float | None
    error: float | None
    note: str = ""
    seconds: float = 0.0
    doubt: str = ""
    """What speaks against the scan's geometry, in words: its points are out of order, or another wall explains more."""

    @property
    def nothing(self) -> bool:
        """Whether the picture explains nothing: nobody should believe it."""
        return self.share is not None and self.share < max(LEAST, ERRORS * (self.error or 0.0))

    @property
    def little(self) -> bool:
        """Whether it explains so little that what is known of the instrument may be wrong."""
        return self.share is not None and self.share < LITTLE

    @property
    def verdict(self) -> str:
        """What to make of the picture, in words; none where the share is unknown, or a doubt says it."""
        if self.share is None or self.doubt:
            return ""
        return "do not believe it" if self.nothing else "believable"

    def __str__(self) -> str:
        return f"{self.figure}; doubtful: {self.doubt}" if self.doubt else self.figure

    @property
    def remark(self) -> str:
        """What to know about the figure, in brackets; nothing where the figure says it, or there is nothing."""
        return f" ({self.note})" if self.note and self.share is not None else ""

    @property
    def figure(self) -> str:
        """How much, in words, without what speaks against it."""
        if self.share is None:
            return f"explained light unknown: {self.note}"
        error = self.error or 0.0
        digits = 1 if error < 0.005 else 0
        figure = f"{100 * self.share:.{digits}f} ± {100 * error:.{digits}f} %"
        return f"EXPLAINS NOTHING of the light ({figure})" if self.nothing else f"explains {figure} of the light"


def blame_response(found: Explained, without: Explained, source: str) -> Explained:
    """What was found with a response from `source`, with a note where the picture without one explains far more, and
    surely so."""
    seconds, share, better = found.seconds + without.seconds, found.share or 0.0, without.share or 0.0
    doubt = ERRORS * math.hypot(found.error or 0.0, without.error or 0.0)
    if without.nothing or better <= FAR_BETTER * share or better <= share + doubt:
        return replace(found, seconds=seconds)
    said = f"without the response ({source}) it {without.figure}: try --response none (in Python response='none')"
    return replace(found, note="; ".join(word for word in (said, found.note) if word), seconds=seconds)


NOT_LOOKED_FOR = Explained(None, None, "it was not computed")
