"""What the keys of `nlos jog` do, and what its screen says."""

import math
from collections.abc import Callable

from nlos.by_hand import lines
from nlos.by_hand.hand import Hand
from nlos.by_hand.marks import Marks
from nlos.drivers.galvo.mirror import MirrorAngles

STEPS_DEG = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0)
"""Optical."""
_ZOOM_S = 2e-9
_WAYS = {"up": (0, 1), "down": (0, -1), "right": (1, 0), "left": (-1, 0)}
_HELP = (
    "arrows move   + - step size   g go to a place   0 centre   SPACE held: light",
    "m mark a spot   z zoom on the peak and back   l log or linear   q ends",
)


class Jog:
    """State between two keys. `ended`: somebody wants to leave."""

    def __init__(self, hand: Hand, marks: Marks, page_url: str = "") -> None:
        self._hand, self._marks, self._page_url = hand, marks, page_url
        self._step = STEPS_DEG.index(0.1)
        self._logarithmic, self._zoomed = True, False
        self._question, self._typed = "", ""
        self._answered: Callable[[str], None] = lambda text: None
        self.ended = False
        hand.begin_text = frozenset("gm")

    def press(self, key: str) -> None:
        """Does what a key means; what may not be is noted, and nothing moves."""
        if self._question:
            self._type(key)
        elif key in _WAYS:
            step_rad, (x, y) = math.radians(STEPS_DEG[self._step]), _WAYS[key]
            at = self._hand.angles
            self._move(MirrorAngles(at.x_rad + x * step_rad, at.y_rad + y * step_rad))
        elif key in "+=-_" and len(key) == 1:
            self._step = min(max(self._step + (1 if key in "+=" else -1), 0), len(STEPS_DEG) - 1)
        elif key == "0":
            self._move(MirrorAngles(0.0, 0.0))
        elif key == "g":
            self._ask("go to x y on the wall, metres", self._go)
        elif key == "m":
            self._ask(self._mark_question(), self._mark)
        elif key == "l":
            self._logarithmic = not self._logarithmic
        elif key == "z":
            self._zoom()
        elif key == "q":
            self.ended = True

    def lines(self, columns: int, rows: int) -> list[str]:
        """The screen, top to bottom."""
        hand = self._hand
        shown = [
            *lines.heading(hand), *lines.address(self._page_url), "",
            *lines.beam(hand),
            f"step        {STEPS_DEG[self._step]:g} deg      marks {self._marks.count}",
            lines.light(hand),
            *lines.counts(hand),
        ]  # fmt: skip
        below = [*lines.notes(hand, columns), f"{self._question}: {self._typed}_" if self._question else "", *_HELP]
        room = rows - len(shown) - len(below) - 4
        return [*shown, *lines.histogram(hand, columns - 1, min(room, 12), self._logarithmic), *below]

    def _move(self, angles: MirrorAngles) -> None:
        self._hand.try_to(lambda: self._hand.move_to(angles))

    def _go(self, text: str) -> None:
        place, reach = _two_numbers(text), self._hand.reach
        if place is None or reach is None:
            self._hand.note(f"{text!r}: two numbers, x and y in metres")
            return
        self._hand.try_to(lambda: self._hand.move_to(reach.angles_of(*place)))

    def _mark_question(self) -> str:
        simulated = self._hand.bench.simulated
        ruler = None if simulated is None else simulated.spot_m(simulated.beam)
        said = "Enter alone: later" if ruler is None else f"the simulated ruler says {ruler[0]:+.3f} {ruler[1]:+.3f}"
        return f"the spot measured on the wall, x y in metres ({said})"

    def _mark(self, text: str) -> None:
        place = _two_numbers(text)
        if place is None and text.strip():
            self._hand.note(f"{text!r}: two numbers, x and y in metres; not marked")
            return
        try:
            self._marks.add(self._hand.angles, place)
        except OSError as error:
            self._hand.note(f"not marked: {self._marks.path} cannot be written ({error.strerror})")
            return
        self._hand.note(f"spot {self._marks.count} in {self._marks.path}")

    def _zoom(self) -> None:
        peak = self._hand.peak
        if self._zoomed or peak is None:
            self._zoomed = False
            self._hand.look_at(None)
            return
        self._zoomed = self._hand.try_to(lambda: self._hand.look_at(peak.time_s - _ZOOM_S, peak.time_s + _ZOOM_S))

    def _ask(self, question: str, answered: Callable[[str], None]) -> None:
        self._question, self._typed, self._answered = question, "", answered
        self._hand.typing = True

    def _type(self, key: str) -> None:
        if key in ("enter", "escape"):
            self._question, self._hand.typing = "", False
            if key == "enter":
                self._answered(self._typed)
        elif key == "backspace":
            self._typed = self._typed[:-1]
        elif key == "space" or len(key) == 1:
            self._typed = (self._typed + (" " if key == "space" else key))[:60]


def _two_numbers(text: str) -> tuple[float, float] | None:
    try:
        x, y = (float(each) for each in text.replace(",", " ").split())
    except ValueError:
        return None
    return (x, y) if math.isfinite(x) and math.isfinite(y) else None
