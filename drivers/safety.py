"""The shutter as everybody uses it: the watchdog armed before it opens, trips latched, every change reported.

This asks for the light to be shut off and checks that it was. The hard-wired interlock is the safety device.
"""

import threading
from collections.abc import Callable

from nlos.drivers.arming import Arming
from nlos.drivers.clock import Clock
from nlos.drivers.counted_lately import CountedLately
from nlos.drivers.errors import BenchClosed, DeviceError, SafetyTrip, ShutterHeld
from nlos.drivers.events import EventLog
from nlos.drivers.safety_settings import SafetySettings
from nlos.drivers.shutter import LaserShutter, NoShutter, ShutterState
from nlos.drivers.silence import Silence
from nlos.drivers.tcspc.counter import CountRates, Histogram, HistogramCounter
from nlos.drivers.trip_latch import TripLatch, tripped

_SHUTTER_MOVES_S = 0.1
_OPENING_S = 2.0
"""So long another thread is given to end an opening that it has begun."""


class GuardedShutter:
    """A `LaserShutter` around the bench's own one."""

    def __init__(
        self,
        shutter: LaserShutter,
        counter: HistogramCounter | None,
        settings: SafetySettings,
        events: EventLog,
        latch: TripLatch | None = None,
        arming: Arming | None = None,
    ) -> None:
        self._shutter, self._counter, self._settings, self._events = shutter, counter, settings, events
        self._there = not isinstance(shutter, NoShutter)
        self._watching = False
        self._open = False
        self.confirmed_closed = False  # and not opened since
        self._latch = latch
        self._trip: str | None = None if latch is None else latch.standing()
        self._unnoted = self._unconfirmed = ""
        self._placed = False  # known where a trip is written down
        self._lately = CountedLately(settings.trip_ms * 1e-3)
        self._held = ""
        self.when_held: Callable[[str], None] = lambda why: None
        """Told of every `hold`: a scan from Python drops its point and ends, whatever is made of the signal."""
        self.before_light: Callable[[], None] = lambda: None
        self._for_good = False
        self._opening = threading.RLock()
        self._arming = arming
        self._silence: Silence | None = None

    def listen(self, silence: Silence | None) -> None:
        """From now on light is shut off in this one's silence, where no instrument's watchdog does so."""
        if silence is not None and self._there and self._settings.watchdog_s > 0 and self._watchdog is None:
            self._silence, silence.shut = silence, self._left_alone
            self._events.cannot_wait = lambda: silence.is_speaking

    @property
    def on_counter(self) -> bool:
        """As the bench's own."""
        return self._shutter.on_counter

    @property
    def has_watchdog(self) -> bool:
        """Whether the shutter closes by itself when this computer falls silent."""
        return self._watchdog is not None

    @property
    def _watchdog(self) -> HistogramCounter | None:
        watches = self._shutter.on_counter and self._settings.watchdog_s > 0
        return self._counter if watches and self._counter is not None and self._counter.has_watchdog else None

    @property
    def may_be_open(self) -> bool:
        """Whether it was told to open and is not confirmed closed since."""
        return self._open

    def is_held(self) -> str:
        """By what: a signal that shut the light off, where nobody has released the shutter since; else empty."""
        return self._held

    def agree(self) -> None:
        """Whether a trip could be written down, this terminal may have light and somebody says so, asked at a moment
        when a question does not disturb; `open` asks otherwise. Raises `LimitError`."""
        if self._latch is not None and not self._placed and not self._settings.dry_run:
            self._latch.check_place()
            self._placed = True
        if self._arming is not None and not self._settings.dry_run:
            self._arming.agree()

    def arm(self, broken_off: Callable[[], bool] = lambda: False) -> None:
        """`agree`, and the warning time, for light that is asked for anew once it is over; else it is `open`'s, which
        is when light comes. It ends once it is `broken_off`, with nothing armed."""
        self.agree()
        if self._arming is not None and not self._settings.dry_run:
            self._arming.warn(lambda: self._for_good or self._held or broken_off())

    def is_armed(self) -> bool:
        """Whether nothing has to happen any more before light."""
        return self._arming is None or self._arming.armed or self._settings.dry_run

    def open(self) -> None:
        """Raises `SafetyTrip` after a trip, until `clear_trip`, and where the interlock is open, `ShutterHeld` after
        `hold`, until `release`, `LimitError` where this terminal may have no light. In a dry run nothing opens."""
        self.check_trip()
        self.arm()
        with self._opening:
            self._open_now()

    def _open_now(self) -> None:
        if self._for_good:
            raise BenchClosed("shutter", "stays closed: the bench is being closed.")
        if self.is_held():
            raise ShutterHeld("shutter", f"stays closed after {self._held}.")
        if not self.is_armed():
            raise ShutterHeld("shutter", "stays closed: the warning time before light was broken off.")
        if self._settings.dry_run:
            if self._there:
                self._events.report("shutter", "asked to open: stays closed in a dry run")
            return
        self._check_heard()
        self.before_light()
        if (watchdog := self._watchdog) is not None:
            watchdog.arm_watchdog(self._settings.watchdog_s)
            self._watching = True
        if self._silence is not None:
            self._silence.lit()
        was_open = self._open
        # From here on the light may be on, whatever the instrument's answer will be.
        self._open, self.confirmed_closed, self._unconfirmed = True, False, ""
        try:
            self._shutter.open()
        except DeviceError as error:
            meanwhile = self._closed_meanwhile()
            try:
                self.close("its opening was not confirmed")
            finally:
                if isinstance(error, SafetyTrip):
                    self._events.report("trip", f"the shutter refused to open: {error}")
            if meanwhile and not isinstance(error, SafetyTrip):  # what it was told to, so it is no fault
                raise ShutterHeld("shutter", f"was closed again after {meanwhile}.") from error
            raise
        if meanwhile := self._closed_meanwhile():
            self._open, self.confirmed_closed = True, False  # what was on its way came after the command to close
            self.close(meanwhile)
            raise ShutterHeld("shutter", f"was closed again after {meanwhile}.")
        if not was_open and self._there:
            self._lately.forget()
            self._events.report("shutter", "opened")

    def _closed_meanwhile(self) -> str:
        """What closed the shutter while it was being opened: a signal, a timer's or one that ends the program."""
        return self._held or ("" if self._open else "its time")

    def check_trip(self) -> None:
        """Raises `SafetyTrip` while a trip stands, of this program or one before it."""
        if self._trip is not None:
            raise tripped(self._trip, self._there)

    def is_tripped(self) -> bool:
        """Whether a trip keeps it closed until `clear_trip`."""
        return self._trip is not None

    def hold(self, why: str) -> None:
        """Closes, and keeps closed what somebody may be about to open: within a signal handler."""
        self._held = why
        self.when_held(why)
        self.close(why)

    def close_for_good(self, why: str = "") -> None:
        """`close`, and whatever another thread is about to: it opens no more. The bench is being closed."""
        self._for_good = True
        if self._opening.acquire(timeout=_OPENING_S):
            self._opening.release()
        self.close(why)

    def release(self) -> None:
        """A scan begins, or resumes: it may open again."""
        self._held = ""
        if self._silence is not None:
            self._silence.broken_off = ""

    def close(self, why: str = "") -> None:
        """As `LaserShutter.close`; then the watchdog, which has nothing left to watch, is turned off."""
        was_open = self._open
        try:
            self._shutter.close()
        except DeviceError as error:
            if str(error) != self._unconfirmed:  # the next attempt may fail in the same words
                self._unconfirmed = str(error)
                self._events.report("shutter", f"NOT CONFIRMED CLOSED: {error}")
            raise
        self._open, self.confirmed_closed, self._unconfirmed = False, True, ""
        if self._silence is not None:
            self._silence.dark()
        if was_open and self._there:
            self._events.report("shutter", f"closed{': ' + why if why else ''}")
        if self._watching and self._counter is not None:
            self._watching = False
            try:
                self._counter.arm_watchdog(0.0)
            except DeviceError as error:
                self._events.report("watchdog", f"could not be turned off: {error}")

    def outlast_watchdog(self, clock: Clock) -> bool:
        """Where the shutter's cable is gone: keeps silent until the instrument's watchdog has closed it by itself.
        False where no watchdog is armed."""
        if not self._watching:
            return False
        clock.sleep(self._settings.watchdog_s + _SHUTTER_MOVES_S)
        self._events.report("watchdog", f"silent for {self._settings.watchdog_s:g} s: its time to close the shutter")
        return True

    def heard(self) -> None:
        """A sign of life of whoever asked for the light. Raises `SafetyTrip` where it comes too late: the light is off,
        or is to be shut off."""
        if self._silence is not None:
            self._silence.heard()
            self._check_heard()

    def _check_heard(self) -> None:
        if self._silence is not None and self._silence.broken_off:
            raise SafetyTrip(
                "shutter",
                f"closed by itself: {self._silence.broken_off}.",
                "Find what held it up: a disk or network share that hangs, a driver, a computer that slept.",
            )

    def _left_alone(self) -> None:
        """Within a thread of its own: the program hangs somewhere."""
        if self._silence is not None:
            self.close(self._silence.broken_off)

    def no_longer_watched(self) -> None:
        """Everything was done to shut the light: who hangs from now on hangs in the dark, or nothing here helps."""
        if self._silence is not None:
            self._silence.end()

    def state(self) -> ShutterState:
        """What the guarded shutter's contact says."""
        return self._shutter.state()

    def watch(self, histogram: Histogram) -> None:
        """Checks the rate of the last `trip_ms` of counting against the limit, of one histogram or of as many as it
        takes: the trip of benches whose counter has none of its own.

        Raises `SafetyTrip` with the shutter closed and the trip latched. A sign of life, as `heard` is.
        """
        self.heard()
        rate_cps = self._lately.rate_cps(histogram.live_time_s, histogram.total_count)
        if rate_cps is not None and rate_cps > self._settings.trip_cps:
            self.trip(f"{rate_cps:.3g} counts/s, above {self._settings.trip_cps:.3g}")

    def watch_rates(self, rates: CountRates) -> None:
        """The same for the counter's rate meter, in the middle of a long dwell."""
        if rates.detector_hz > self._settings.trip_cps:
            self.trip(f"{rates.detector_hz:.3g} counts/s, above {self._settings.trip_cps:.3g}")

    def trip(self, why: str) -> None:
        """Closes the shutter and keeps it closed until `clear_trip`. Raises `SafetyTrip`."""
        self.latch(why)
        if not self._there:
            raise SafetyTrip(
                "shutter",
                f"there is none to close: {why}.{self._unnoted}",
                "Block the laser by hand; find the cause before clearing it.",
            )
        raise SafetyTrip("shutter", f"closed by a trip: {why}.{self._unnoted}", "Find the cause before clearing it.")

    def latch(self, why: str) -> None:
        """Closes the shutter, tells why, and keeps it closed until `clear_trip`."""
        first, self._trip = self._trip is None, why
        try:
            self.close("trip")
        finally:
            if first:
                self._outlast(why)
            self._events.report("trip", why)

    def clear_trip(self, who: str) -> None:
        """A person's decision to continue after a trip, here and in the instrument; logged with that person's name."""
        if self._latch is not None:
            self._latch.clear(who)
        if self._counter is not None:
            self._counter.clear_trip()
        self._events.report("override", f"{who} cleared the trip: {self._trip or 'the instrument had it'}")
        self._trip = None

    def _outlast(self, why: str) -> None:
        if self._latch is not None:
            try:
                self._latch.trip(why)
            except OSError as error:
                said = f"the trip could not be noted in {self._latch.path} ({error})"
                self._unnoted = f" And {said}: nothing keeps the next command from light. Block the laser."
                self._events.report("warning", said)
