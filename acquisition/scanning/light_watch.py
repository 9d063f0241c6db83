"""Judges light while it is on: every sample as it arrives, and the counter's rate meter where none arrives for long."""

from collections.abc import Callable, Sequence

from nlos.acquisition.sample import Sample
from nlos.acquisition.scanning.alarms import Alarms, Trouble
from nlos.drivers.bench import Bench
from nlos.drivers.errors import SafetyTrip

LOOK_S = 0.1
"""Without a sample for so long, the counter's own rate meter is asked: it counts for as long."""
SHUT_WITHIN_S = 0.2
"""From the first photon too many until the shutter is told to close: two looks, or a block of a clocked scan and a
look (`clocked.BLOCK_S`)."""


class LightOff(Exception):
    """The light was shut off while points were waited for. Whatever arrived before is as good as it was."""


class LightWatch:
    """`trip`, or `trouble` at point `number`, says why the light was shut off; the engine decides what follows."""

    def __init__(
        self, bench: Bench, alarms: Alarms | None, is_spoilt: Callable[[Sample], bool], trial: bool = False
    ) -> None:
        self._bench, self._alarms, self._is_spoilt = bench, alarms, is_spoilt
        self._judge = None if alarms is None else alarms.judge_trial if trial else alarms.judge
        self._looked_s = bench.clock.now()
        self._asking = False
        self._awaited: int | None = None
        self.trip: SafetyTrip | None = None
        self.trouble: Trouble | None = None
        self.number: int | None = None

    def inspect(self, samples: Sequence[Sample]) -> None:
        """Judges samples as they arrive, whether or not they can be handed on yet. A sample that is taken again counts
        for trips only. Raises `LightOff` with the shutter closed."""
        self._looked_s = self._bench.clock.now()
        for sample in samples:
            self.number = sample.point.number
            self._guarded(lambda: self._bench.shutter.watch(sample.histogram))  # noqa: B023 - called at once
            if self._judge is not None and not self._is_spoilt(sample):
                self._shut_for(self._judge(sample))

    def awaits(self, number: int) -> None:
        """The light from now on is this point's, until another one is awaited."""
        self._awaited = number

    def look(self) -> None:
        """Called every 10 ms while points are waited for. Raises `LightOff` with the shutter closed."""
        now_s = self._bench.clock.now()
        if self._asking or not self._bench.shutter.may_be_open or now_s - self._looked_s < LOOK_S:
            return
        self._looked_s, self._asking, self.number = now_s, True, self._awaited
        try:
            rates = self._bench.counter.rates()
        finally:
            self._asking = False
        self._guarded(lambda: self._bench.shutter.watch_rates(rates))
        if self._alarms is not None:
            self._shut_for(self._alarms.judge_rates(rates))

    def _guarded(self, judge: Callable[[], None]) -> None:
        try:
            judge()
        except SafetyTrip as trip:
            self.trip = trip
            raise LightOff from trip

    def _shut_for(self, trouble: Trouble | None) -> None:
        if trouble is not None:
            self.trouble = trouble
            self._bench.shutter.close(f"alarm: {trouble.name}")
            raise LightOff
