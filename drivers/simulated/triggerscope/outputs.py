"""One output of a TriggerScope: its value, its table of states, and how both follow the trigger input."""

from collections.abc import Callable
from dataclasses import dataclass, field

STATES = 1200


@dataclass
class Output:
    """A DAC or a group of eight TTL outputs: its value, its table, and how they follow the trigger input."""

    put_out: Callable[[int], None]
    most: int  # the largest value
    value: int = 0
    before_stepping: int = 0
    stepping: bool = False
    steps_at: bool = False  # the level of the trigger input whose beginning is an edge
    blanking: bool = False
    active_at: bool = False  # the level of the trigger input at which the value is put out
    table: list[int] = field(default_factory=lambda: [0] * STATES)
    length: int = 0
    index: int = 0
    wave: tuple[int, int] | None = None
    """(offset, amplitude) of what an edge plays in place of the table."""

    def show(self, level: bool) -> None:
        """Puts out its value, or 0 while the trigger level blanks it."""
        self.put_out(self.value if not self.blanking or self.active_at == level else 0)

    def clear(self) -> None:
        """Forgets the table and stops stepping; what is put out stays."""
        self.stepping = False
        self.index = self.length = 0
        self.table = [0] * STATES

    def next_state(self) -> int:
        """Wraps where it meets the loaded length; where it never does, it runs on past the table's end."""
        state = self.table[self.index] if self.index < STATES else self.most
        self.index += 1
        return state

    def begin_stepping(self, rising: bool) -> None:
        """From now on an edge brings the next state; for falling edges the first one at once."""
        self.stepping, self.steps_at = True, rising
        self.before_stepping, self.index = self.value, 0
        if not rising:
            self.put_out(self.next_state())

    def end_stepping(self, rising: bool) -> None:
        """The value goes back to what it was before, for the next one who shows it; what is put out stays."""
        self.stepping, self.steps_at = False, rising
        self.value = self.before_stepping

    def follow(self, level: bool) -> None:
        """The trigger input changed. Of a wave its crest and its end are put out."""
        if self.stepping and self.wave is not None:
            if self.steps_at == level:
                self.put_out(min(sum(self.wave), self.most))
                self.put_out(self.wave[0])
        elif self.stepping and self.steps_at == level:
            self.value = self.next_state()
            if self.index == self.length:
                self.index = 0
            if not self.blanking:
                self.put_out(self.value)
        if self.blanking:
            self.show(level)
