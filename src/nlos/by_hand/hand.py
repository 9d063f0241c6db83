"""What is in one's hands: the beam, the light, and what the counter sees, updated more than ten times a second."""

import math
from collections import deque
from collections.abc import Callable, Iterator

from nlos.acquisition.direct_peak import DirectPeak
from nlos.acquisition.planning.aim import Aiming
from nlos.by_hand.keys import Keys
from nlos.by_hand.light import LightOnRequest
from nlos.by_hand.reach import Reach
from nlos.by_hand.stops import BY_CTRL_Z, Stops
from nlos.by_hand.watching import DWELL_S, Reading, Watch
from nlos.drivers.errors import DeviceError, LimitError
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.partial_bench import PartialBench
from nlos.drivers.tcspc.axes import part_of_period, whole_period

FIRST_HOLD_S = 0.8
"""A key that is held down is first repeated after so long at most, as keyboards are set."""
HOLD_S = 0.3
"""And then at least so often: the light outlasts the last repeat by no more."""
_BROKEN_OFF = "no light: another key was pressed in its warning time"
_TICK_S = 0.01
_LONGEST_AXIS_DWELL_S = 0.06
_ZOOMED_BINS = 1024


def refused_light(there_is_a_shutter: bool, why: str, remedy: str) -> LimitError:
    """For whoever asks for light that is not to be had."""
    if not there_is_a_shutter:
        return LimitError("shutter", why, "Switch the laser by hand.")
    return LimitError("shutter", f"stays closed: {why}", remedy)


class Hand:
    """One bench, as far as it is there. `update` takes one gate, or waits as long where there is no counter."""

    def __init__(self, bench: PartialBench, aim: Aiming, keys: Keys, stops: Stops) -> None:
        self.bench, self.keys, self.stops = bench, keys, stops
        self.light = LightOnRequest(bench.shutter, bench.clock, bench.settings.alignment, stops)
        self.light.broken_off = self._something_else_is_wanted
        self.reach = None if bench.mirror is None else Reach(bench.settings, bench.mirror, aim)
        self.angles = MirrorAngles(0.0, 0.0)
        self.lit_here = False
        """Whether there was light since the beam came where it is."""
        self.no_light = ""
        """Why there is none to be had; empty where there is."""
        self.light_is_known = bench.settings.shutter_on != "nothing"
        """Whether anything here switches it on and off."""
        self.notes: deque[str] = deque(maxlen=3)
        self.reading: Reading | None = None
        self.peak: DirectPeak | None = None
        self.watch: Watch | None = None
        self._pressed: deque[str] = deque()  # in order; nobody has looked at them
        self._waiting: deque[str] = deque()
        self._held_s = -math.inf
        self.typing = False
        """Whether keys are text: a space is no wish for light then."""
        self.begin_text: frozenset[str] = frozenset()
        """Keys after which text follows."""
        if bench.counter is not None:
            axis = whole_period(bench.counter, bench.settings.laser.repetition_hz, _LONGEST_AXIS_DWELL_S)
            self.watch = Watch(bench, self.light, axis)
            bench.counter.meanwhile(self._meanwhile)

    def note(self, text: str) -> None:
        """Something to be read by who looks at the screen."""
        self.notes.append(text)

    def pressed(self) -> list[str]:
        """The keys that wait, but for those that are held for light."""
        self._look_at_keys()
        found = list(self._waiting)
        self._waiting.clear()
        return found

    def each_pressed(self) -> Iterator[str]:
        """The same, one after the other: while one of them is answered, whoever asks whether something else is wanted
        than light finds the others still waiting."""
        self._look_at_keys()
        for _ in range(len(self._waiting)):
            yield self._waiting.popleft()

    def update(self) -> None:
        """One gate, and the direct peak in the last second's. Raises `DeviceError` with the light as it is."""
        self._meanwhile()
        if self.stops.wanted:
            self.light.end(BY_CTRL_Z)  # it may have come since, or a key with it
            self.stops.stop()
            self._meanwhile()
        if self.watch is None:
            until_s = self.bench.clock.now() + DWELL_S
            while self.bench.clock.now() < until_s:
                self.bench.clock.sleep(_TICK_S)
                self._meanwhile()
            return
        self.reading = self.watch.look()
        self.peak = self.watch.peak()

    def move_to(self, angles: MirrorAngles) -> None:
        """Raises `LimitError` where the beam may not go, with nothing moved."""
        if self.reach is None or self.bench.mirror is None:
            raise LimitError("mirror", "it does not answer: nothing can be moved.", "Plug it in, then start again.")
        self.reach.check(angles)
        self.bench.mirror.begin_move(angles)
        self.angles, self.lit_here = angles, False
        self._wait(self.bench.mirror.wait_settled)
        if self.watch is not None:
            self.watch.forget()

    def try_to(self, act: Callable[[], object]) -> bool:
        """Does it, or notes what is in the way: the person decides what is next."""
        try:
            act()
        except LimitError as error:
            self.note(f"{error.what} {error.remedy}")
            return False
        return True

    def look_at(self, start_s: float | None, end_s: float | None = None) -> None:
        """The histogram over a part of the period; over all of it without."""
        if self.watch is None:
            return
        counter, repetition_hz = self.watch.counter, self.bench.settings.laser.repetition_hz
        if start_s is None or end_s is None:
            self.watch.set_axis(whole_period(counter, repetition_hz, _LONGEST_AXIS_DWELL_S))
        else:
            self.watch.set_axis(part_of_period(counter, max(start_s, 0.0), end_s, _LONGEST_AXIS_DWELL_S, _ZOOMED_BINS))

    def ask_for_light(self, seconds: float) -> bool:
        """Whether there is some, or another key in the warning time before it wanted none. Raises `LimitError` where
        there is none to be had, or the beam is where it may not be."""
        if self.no_light:
            raise refused_light(self.light_is_known, self.no_light, "Start again where there may be light.")
        if self.reach is not None:
            self.reach.check(self.angles)
        given = self.light.ask(seconds)
        if not given:
            self.note(_BROKEN_OFF)
        return given

    def _hold(self) -> bool:
        """Light for who holds the key; False where what was pressed with it is of before a warning time."""
        now_s = self.bench.clock.now()
        repeats = now_s - self._held_s < FIRST_HOLD_S
        self._held_s = now_s
        shutter = self.bench.shutter
        if shutter is not None and not shutter.is_armed():  # who pressed may have let go while the warning time passed
            shutter.release()  # somebody asks again, after whatever shut the light
            if self.try_to(lambda: self.light.arm(shutter)) and shutter.is_armed():
                self._take_keys()
                self._pressed = deque(key for key in self._pressed if key != "space")
                self.note("armed: SPACE gives light from now on")
            elif self._something_else_is_wanted():
                self.note(_BROKEN_OFF)
            return False
        seconds = min(HOLD_S if repeats else FIRST_HOLD_S, self.bench.settings.alignment.longest_s)
        self.try_to(lambda: self.ask_for_light(seconds))
        return True

    def _look_at_keys(self) -> None:
        held = True
        self._take_keys()
        while self._pressed:
            key = self._pressed.popleft()
            if key == "space" and not (self.typing or self.begin_text.intersection(self._waiting)):
                held = held and self._hold()
            else:
                self._waiting.append(key)

    def _take_keys(self) -> None:
        self._pressed.extend(self.keys.pressed())

    def _something_else_is_wanted(self) -> bool:
        """Whether a key waits that is no wish for light, `q` before all: what it means is done in the dark."""
        self._take_keys()
        return not self.typing and (bool(self._waiting) or any(key != "space" for key in self._pressed))

    def _meanwhile(self) -> None:
        """Every 10 ms, whatever is waited for."""
        if self.bench.mirror is not None:
            self.bench.mirror.look()
        if self.stops.wanted:
            self.light.end(BY_CTRL_Z)
            self.keys.pressed()  # what is held while it goes off is no wish for light
        self._look_at_keys()
        self.light.tick()
        self.lit_here |= self.light.wanted

    def _wait(self, settled: Callable[[], None]) -> None:
        try:
            settled()
        except DeviceError:
            self.light.end("the mirror did not settle")
            raise
        self.light.tick()
