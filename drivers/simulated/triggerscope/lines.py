"""How the TriggerScope's firmware reads a line: characters at fixed places, numbers up to whatever follows them.

What is malformed is often accepted - a missing separator, a number that overflows, words behind the last digit - so
that a simulated controller that parsed like a grammar would refuse what the real one carries out.
"""

import re
from dataclasses import dataclass

_NUMBER = re.compile(rb"[ \t\n\v\f\r]*([+-]?\d+)")


def integer(text: bytes) -> int:
    """The number a text begins with, 0 where there is none, at most what 32 bits hold."""
    match = _NUMBER.match(text)
    return max(-(2**31), min(2**31 - 1, int(match[1]))) if match else 0


@dataclass(frozen=True)
class Line:
    """What has arrived until the main loop looked, a newline somewhere in it."""

    text: bytes

    @property
    def string(self) -> bytes:
        """The whole, as a comparison sees it."""
        return self.part(0)

    @property
    def name(self) -> bytes:
        """The command: its first three characters."""
        return self.part(0, 3)

    def part(self, left: int, right: int | None = None) -> bytes:
        """A substring, cut at a NUL."""
        return self.text[left:right].split(b"\0")[0]

    def number(self, left: int, right: int | None = None) -> int:
        """As the sketch's `toInt`: digits up to the first other character, 0 for none."""
        return integer(self.part(left, right))

    def byte(self, left: int, right: int | None = None) -> int:
        """A number kept in 8 bits: 257 is 1."""
        return self.number(left, right) & 255

    def separated(self, at: int) -> bool:
        """Whether a `-` stands there."""
        return self.text[at : at + 1] == b"-"

    def output(self) -> tuple[int, int] | None:
        """A DAC's number of one or two digits and where its arguments begin; None without separator or such a DAC."""
        after = 4 if self.separated(4) else 5
        dac = self.number(3, after)
        return (dac, after + 1) if self.separated(after) and 1 <= dac <= 16 else None

    def states(self, start: int) -> tuple[int, list[int]] | None:
        """The first index and the values of a table; empty places between separators are skipped, and the last value
        counts up to the newline. None where nothing separates them."""
        first = self.text.find(b"-", start)
        if not 0 <= first < len(self.text) - 1:
            return None
        *inner, last = self.text[first + 1 :].split(b"-")
        values = [integer(value.split(b"\0")[0]) for value in inner if value]
        if len(last) > 1:
            values.append(integer(last.split(b"\0")[0]))
        return self.number(start, first), values
