"""What the keys of `nlos jog` do, and what its screen says."""

import math
import textwrap
from collections.abc import Callable

import numpy as np

from nlos.beam_seen import keep_beam_seen
from nlos.by_hand import lines
from nlos.by_hand.hand import Hand
from nlos.by_hand.marks import Mark, Marks
from nlos.calibration.errors import InvalidData
from nlos.calibration.geometry_fit import Spots
from nlos.calibration.spots_sense import check_sense, span_the_wall
from nlos.drivers.galvo.mirror import MirrorAngles

STEPS_DEG = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0)
"""Optical."""
_ZOOM_S = 2e-9
_WAYS = {"up": (0, 1), "down": (0, -1), "right": (1, 0), "left": (-1, 0)}
_HELP = (
    "arrows move   + - step size   g go to a place   0 centre   SPACE held: light",
    "m mark a spot   z zoom on the peak and back   l log or linear   q ends",
)
_AGAIN = "TAB: light for another {seconds:g} s, also while the ruler's value is asked for"
_OFF_M, _OFF_PART = 0.02, 0.02
"""A spot so far from where the bench file puts it, in metres and in wall distances, is said at once: rulers do not."""
_ENOUGH_MARKS = 9
"""With a ruler's value each: they tell where the scanner stands."""


class Jog:
    """State between two keys. `ended`: somebody wants to leave."""

    def __init__(self, hand: Hand, marks: Marks, page_url: str = "", light_s: float | None = None) -> None:
        self._hand, self._marks, self._page_url = hand, marks, page_url
        self._step = STEPS_DEG.index(0.1)
        self._logarithmic, self._zoomed = True, False
        self._question, self._typed = "", ""
        self._answered: Callable[[str], str] = lambda text: ""
        self._light_s = light_s
        self._seen: list[tuple[float, float, float, float]] = []
        """Commanded angles and the ruler's place, of this session's marks that nobody took out of the table."""
        self._offered: tuple[float, float] | None = None
        self.ended = False
        hand.begin_text = frozenset("gm")

    def press(self, key: str) -> None:
        """Does what a key means; what may not be is noted, and nothing moves."""
        again_s = self._light_s
        if key == "tab" and again_s is not None:
            self._hand.try_to(lambda: self._hand.ask_for_light(again_s))
        elif self._question:
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
            self._ask("go to x y on the wall, metres:", self._go)
        elif key == "m":
            self._offered = self._ruler()
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
            f"step        {STEPS_DEG[self._step]:g} deg      marks {self._marked()}",
            lines.light(hand),
            *lines.counts(hand),
        ]  # fmt: skip
        again = [] if self._light_s is None else [_AGAIN.format(seconds=self._light_s)]
        asked = [*textwrap.wrap(self._question, max(columns - 1, 20)), f"> {self._typed}_"] if self._question else [""]
        below = [*lines.notes(hand, columns), *asked, *_HELP, *again]
        room = rows - len(shown) - len(below) - 4
        return [*shown, *lines.histogram(hand, columns - 1, min(room, 12), self._logarithmic), *below]

    def _move(self, angles: MirrorAngles) -> None:
        self._hand.try_to(lambda: self._hand.move_to(angles))

    def _marked(self) -> str:
        left = self._marks.unmeasured
        return f"{self._marks.count}" + (f", {left} of them without a ruler's value" if left else "")

    def _go(self, text: str) -> str:
        place, reach = _two_numbers(text), self._hand.reach
        if place is None or reach is None:
            return f"{text!r}: two numbers, x and y in metres, such as 0.25 -0.1"
        self._hand.try_to(lambda: self._hand.move_to(reach.angles_of(*place)))
        return ""

    def _ruler(self) -> tuple[float, float] | None:
        """Where the spot is, on a simulated table."""
        simulated = self._hand.bench.simulated
        seen = None if simulated is None else simulated.spot_m(simulated.beam)
        return None if seen is None else (round(seen[0], 3) + 0.0, round(seen[1], 3) + 0.0)

    def _mark_question(self) -> str:
        ruler = self._offered
        said = "Enter alone: to be filled in later"
        if ruler is not None:
            said = f"the simulated ruler says {ruler[0]:+.3f} {ruler[1]:+.3f}, Enter takes that"
        return f"the spot on the wall, x y in metres ({said}):"

    def _mark(self, text: str) -> str:
        place = _two_numbers(text)
        if place is None and text.strip():
            return f"{text!r}: two numbers, x and y in metres, such as 0.25 -0.1"
        if place is None and self._offered is not None:
            place = self._offered
        try:
            mark = self._marks.add(self._hand.angles, place)
        except OSError as error:
            self._hand.note(f"not marked: {self._marks.path} cannot be written ({error.strerror})")
            return ""
        except UnicodeDecodeError:
            self._hand.note(f"not marked: {self._marks.path} is no text, so no table of spots")
            return ""
        except InvalidData as error:
            self._hand.note(f"not marked: {error}")
            return ""
        bench = self._hand.bench
        if bench.shutter is not None and bench.settings.shutter_on != "nothing" and not self._hand.lit_here:
            self._hand.note("marked with the light off since the beam came here: SPACE, held, shows the spot")
        where = f"spot {self._marks.count} in {self._marks.path}"
        if place is None:
            self._hand.note(f"{where}, without a ruler's value: write x_m and y_m into the file")
        else:
            self._seen = [each for each in self._seen if self._marks.holds(MirrorAngles(*each[:2]), each[2:])]
            at = self._hand.angles
            self._seen.append((at.x_rad, at.y_rad, *place))
            self._hand.note(
                where + (self._turned() or self._contradicted(mark) or self._enough() or self._far_off(place))
            )
        return ""

    def _turned(self) -> str:
        """What three marks tell, which scans of this bench are told from now on."""
        spots = Spots(*np.array(self._seen).T)
        if not span_the_wall(spots):
            return ""
        keep_beam_seen(self._hand.bench.settings, "jog", spots)
        try:
            check_sense(spots)
        except InvalidData as error:
            return f": {str(error).partition(';')[0]}"
        return ""

    def _contradicted(self, new: Mark) -> str:
        older = self._marks.contradicted_by(new, self._hand.bench.settings.geometry.wall_distance_m)
        if not older:
            return ""
        others = f" (and {len(older) - 1} more)" if len(older) > 1 else ""
        return (
            f": {new} contradicts line {older[0].line}, {older[0]}{others}: one was misread, or something moved. "
            "Delete the wrong line, or begin a new table"
        )

    def _enough(self) -> str:
        if self._marks.count - self._marks.unmeasured < _ENOUGH_MARKS:
            return ""
        return f": enough: q, then nlos calibrate --spots {self._marks.path}"

    def _far_off(self, place: tuple[float, float]) -> str:
        """What the first spots tell already: the beam is not where the bench file puts it."""
        if self._hand.reach is None:
            return ""
        x_m, y_m = self._hand.reach.place_of(self._hand.angles)
        off_x_m, off_y_m = place[0] - x_m, place[1] - y_m
        allowed_m = max(_OFF_M, _OFF_PART * self._hand.bench.settings.geometry.wall_distance_m)
        if math.hypot(off_x_m, off_y_m) <= allowed_m:
            return ""
        return (
            f": {off_x_m:+.3f}, {off_y_m:+.3f} m from where the bench file puts it. Nine spots and `nlos calibrate "
            "--spots` tell why: scanner's place, wall distance, or an axis that is reversed or swapped"
        )

    def _zoom(self) -> None:
        peak = self._hand.peak
        if self._zoomed or peak is None:
            self._zoomed = False
            self._hand.look_at(None)
            return
        self._zoomed = self._hand.try_to(lambda: self._hand.look_at(peak.time_s - _ZOOM_S, peak.time_s + _ZOOM_S))

    def _ask(self, question: str, answered: Callable[[str], str]) -> None:
        """`answered` returns what is wrong with an answer, which is then asked for again; empty where nothing is."""
        self._question, self._typed, self._answered = question, "", answered
        self._hand.typing = True

    def _type(self, key: str) -> None:
        if key in ("enter", "escape"):
            wrong = self._answered(self._typed) if key == "enter" else ""
            if wrong:
                self._hand.note(wrong)
                self._typed = ""
            else:
                self._question, self._hand.typing = "", False
        elif key == "backspace":
            self._typed = self._typed[:-1]
        elif key == "space" or len(key) == 1:
            self._typed = (self._typed + (" " if key == "space" else key))[:60]


def _two_numbers(text: str) -> tuple[float, float] | None:
    """Two numbers with a space or a comma between them; between two words, a comma is a decimal one."""
    words = text.split()
    words = [each.strip(",").replace(",", ".") for each in words] if len(words) == 2 else text.split(",")
    try:
        x, y = (float(each) for each in words)
    except ValueError:
        return None
    return (x, y) if math.isfinite(x) and math.isfinite(y) else None
