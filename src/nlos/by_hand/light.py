"""Light that somebody asked for: on for no longer than that, at the duty that the bench allows for alignment."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from nlos.by_hand.stops import Stops
from nlos.drivers.alignment_settings import SHORTEST_S, AlignmentSettings
from nlos.drivers.clock import Clock
from nlos.drivers.errors import DeviceError, LimitError, SafetyTrip, ShutterHeld
from nlos.drivers.safety import GuardedShutter

SPARE_S = 0.06
"""So much earlier than its time the light is told to go off: the command takes a while, and so may a busy computer."""
_ALARM_EARLY_S = 0.03
_ALARM_AGAIN_S = 0.05
_LATE_S = 0.5
"""A computer that is busy shuts it within that; later, its program was stopped, or it slept itself."""


class LightOnRequest:
    """`ask` says for how long; `tick`, called every 10 ms, opens and closes. A timer's signal closes where the program
    itself waits for something else. The instrument's watchdog closes where the program is gone."""

    def __init__(
        self, shutter: GuardedShutter | None, clock: Clock, alignment: AlignmentSettings, stops: Stops
    ) -> None:
        self._shutter, self._clock, self._alignment, self._stops = shutter, clock, alignment, stops
        self._began_s, self._until_s = 0.0, float("-inf")
        self._timed = False
        self._opened_s: float | None = None
        self._off_s, self._late_s = float("inf"), 0.0
        self._not_closed: DeviceError | None = None  # what the shutter said, where the timer could not close it
        self._closed_after_s = 0.0
        self.broken_off: Callable[[], bool] = lambda: False
        """Asked in the warning time before light: whether somebody wants none any more."""
        self.openings = 0
        """How often it came on: between two looks it may have come and gone."""

    @property
    def on_s(self) -> float:
        """How long it was on so far, in all."""
        lit_s = 0.0 if self._opened_s is None else self._clock.now() - self._opened_s
        return self._closed_after_s + lit_s

    @property
    def lit(self) -> bool:
        """Whether the shutter may be open now."""
        return self._shutter is not None and self._shutter.may_be_open

    @property
    def wanted(self) -> bool:
        """Whether what was asked for is not over yet."""
        return self.left_s > 0

    @property
    def left_s(self) -> float:
        return max(0.0, self._until_s - self._clock.now())

    def check(self, seconds: float) -> None:
        """Raises `LimitError` for a time that cannot be had."""
        if self._shutter is None:
            raise LimitError("shutter", "what drives it does not answer: no light.", "Plug it in, or stay in the dark.")
        if not SHORTEST_S <= seconds <= self._alignment.longest_s:
            raise LimitError(
                "shutter",
                f"light for {seconds:g} s is outside {SHORTEST_S:g} to {self._alignment.longest_s:g} s.",
                "Ask for less, or change alignment.longest_s in the bench file.",
            )

    def ask(self, seconds: float) -> bool:
        """Light for so long from now on; False, and none, where it was broken off in the warning time before it, be it
        at its very end. Raises `LimitError` where there is none to be had."""
        self.check(seconds)
        assert self._shutter is not None
        if not self.wanted:
            self._shutter.release()  # somebody asks again, after whatever shut the light
        warns = not self._shutter.is_armed()
        self.arm(self._shutter)
        if warns and self.broken_off():
            return False
        now_s = self._clock.now()
        if self._until_s <= now_s:
            self._began_s = now_s
        self._until_s = max(self._until_s, now_s + seconds)
        self.tick()
        return True

    def arm(self, shutter: GuardedShutter) -> None:
        """What has to happen before light; Ctrl-Z in its warning time stops the program, and the warning comes anew.
        Raises `LimitError`."""
        with self._stops.at_once():
            shutter.arm(self.broken_off)

    def tick(self) -> None:
        """Opens or closes as it is time to. Raises what the shutter raises."""
        if self._shutter is None:
            return
        self.answer()
        now_s, alignment = self._clock.now(), self._alignment
        phase_s = (now_s - self._began_s) % alignment.period_s
        off_s = min(self._until_s, now_s - phase_s + alignment.duty * alignment.period_s)
        if alignment.duty == 1.0:
            off_s = self._until_s
        wanted = now_s < off_s - SPARE_S
        if wanted:
            self._off_s = off_s
        if wanted and not self._shutter.may_be_open:
            self._set_timer(off_s - now_s - _ALARM_EARLY_S)
            self._opened_s = self._clock.now()
            self.openings += 1
            self._not_closed = None
            try:
                self._shutter.open()
            except ShutterHeld:  # its time was over before it was open
                if self._shutter.is_held():
                    raise
        elif not wanted and self._shutter.may_be_open:
            self._shut()
            self._set_timer(0.0)
        elif wanted:
            self._set_timer(off_s - now_s - _ALARM_EARLY_S)
        self._account()

    def answer(self) -> None:
        """Raises `SafetyTrip` where light that is off by now was on for longer than it was to be, or than anybody
        looked after it: the timer of a program that was stopped rings when it goes on."""
        if self._shutter is not None:
            self._shutter.heard()
        late_s, self._late_s = self._late_s, 0.0
        if late_s > _LATE_S:
            why, late = self._not_closed, f"closed {late_s:.1f} s after its time"
            if why is not None:
                raise SafetyTrip("shutter", f"{late}, because at first it did not close: {why.what}", why.remedy)
            raise SafetyTrip(
                "shutter",
                f"{late}: the program was stopped meanwhile, or the computer slept.",
                "Find what held it up; light is shut by Ctrl-Z or Ctrl-C, not by `kill -STOP`.",
            )

    def end(self, why: str) -> None:
        """Off, whatever was asked for."""
        self._until_s = float("-inf")
        self._set_timer(0.0)
        if self.lit and self._shutter is not None:
            self._shutter.close(why)
        self._account()

    def _shut(self) -> None:
        """Its time is over, perhaps for long. Raises what the shutter raises."""
        assert self._shutter is not None
        self._shutter.close("its time is over")
        self._late_s = max(self._late_s, self._clock.now() - self._off_s)

    def _account(self) -> None:
        """Its time, where it is off by now, whoever closed it."""
        if self._opened_s is not None and not self.lit:
            self._closed_after_s, self._opened_s = self.on_s, None

    @contextmanager
    def timed(self) -> Iterator[None]:
        """While the block runs a timer stands behind `tick`: in the main thread of a POSIX system."""
        if not hasattr(signal, "setitimer") or threading.current_thread() is not threading.main_thread():
            yield
            return
        previous = signal.signal(signal.SIGALRM, self._on_alarm)
        self._timed = True
        try:
            yield
        finally:
            self._set_timer(0.0)
            self._timed = False
            signal.signal(signal.SIGALRM, previous)

    def _set_timer(self, seconds: float) -> None:
        if self._timed:
            signal.setitimer(signal.ITIMER_REAL, max(seconds, 1e-3) if seconds else 0.0)

    def _on_alarm(self, number: int, frame: FrameType | None) -> None:
        if not self.lit or self._shutter is None:
            return
        try:
            self._shut()
        except DeviceError as error:  # the program may wait for something else: `tick` may not come to try again
            self._not_closed = error
            self._set_timer(_ALARM_AGAIN_S)
